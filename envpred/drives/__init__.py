"""Where scans come from: one data layout is one file here, and is found by itself.

A module of this package that defines `find(root) -> list[Drive]` is a reader; adding one is adding a file.  Readers of
other packages join by entry points (see `finding`).
"""

from envpred.drives.drive import Drive
from envpred.drives.finding import find_drives, one_drive, one_frame

__all__ = ["Drive", "find_drives", "one_drive", "one_frame"]

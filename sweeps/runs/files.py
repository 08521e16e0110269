"""Text files that are there whole or not at all, also where several processes write the same."""

import os
from pathlib import Path


def replace_text(file: Path, text: str) -> Path:
    """Replace `file` in one step; returns it."""
    part = file.with_name(f".{file.name}-{os.getpid()}")
    try:
        part.write_text(text)
        os.replace(part, file)
    finally:
        part.unlink(missing_ok=True)
    return file

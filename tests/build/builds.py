"""What tests of builds share: running `envpred grids` as a user does, and comparing what it leaves."""

import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from envpred.store import Store
from tests.drives.synthetic import write_drive


def command(source: Path, store: Path, *options: str) -> list[str]:
    """The command line that maps `source` into `store`."""
    return [sys.executable, "-m", "envpred", "grids", "--source", str(source), "--store", str(store), *options]


def start(source: Path, store: Path, *options: str) -> subprocess.Popen[str]:
    """A build in a process group of its own, as a shell starts it."""
    return subprocess.Popen(
        command(source, store, *options), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, process_group=0
    )


def run(source: Path, store: Path, *options: str) -> subprocess.CompletedProcess[str]:
    """A build to its end."""
    return subprocess.run(command(source, store, *options), capture_output=True, text=True, check=False, timeout=300)


def lines(stderr: str) -> list[str]:
    """What stays on the screen: standard error without the progress bar."""
    return [line for line in stderr.replace("\r", "\n").splitlines() if line.strip() and "frame/s" not in line]


def content(store: Path) -> dict[str, bytes]:
    """Every file of the store, hidden ones too."""
    return {str(file.relative_to(store)): file.read_bytes() for file in store.rglob("*") if file.is_file()}


def parts(store: Path) -> list[Path]:
    """Folders that a build is writing or has left."""
    return list(store.glob(".part-*"))


def wait_for(condition: Callable[[], object], process: subprocess.Popen[str], seconds: float = 120) -> bool:
    """Wait until `condition` holds; false if the process ends before."""
    end = time.monotonic() + seconds
    while not condition():
        if process.poll() is not None:
            return False
        assert time.monotonic() < end, "the build does not get there"
        time.sleep(0.005)
    return True


def workers_of(process: subprocess.Popen[str]) -> list[int]:
    """Process numbers of its workers (multiprocessing's resource tracker is none)."""
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text(encoding="utf-8").split()
    return [int(child) for child in children if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes()]


def runs(pid: int) -> bool:
    """Whether the process is there and more than an entry that waits for its parent."""
    try:
        return Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rsplit(")", 1)[1].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def is_writing(store: Path) -> bool:
    """Whether a frame has been written of a drive that is not finished."""
    return any(file.stat().st_size > 20_000 for part in parts(store) for file in part.glob("label.npy"))


def all_valid(store: Path) -> list[str]:
    """Names of the drives, every one verified."""
    drives = Store(store).drives
    for drive in drives.values():
        drive.verify()
    return list(drives)


def write_long_drive(root: Path, number: str, frames: int) -> Path:
    """A drive that costs no more to write than 10 frames: scans and packets are linked over and over."""
    drive = write_drive(root, number, frames=10, azimuths=180)
    for part, ending in (("velodyne_points", ".bin"), ("oxts", ".txt")):
        folder = drive / part / "data"
        for k in range(10, frames):
            (folder / f"{k:010d}{ending}").symlink_to(folder / f"{k % 10:010d}{ending}")
    return drive


def count_forever(drive: Any, on_frame: Callable[[], None]) -> str | None:
    """A job that does nothing but report frames."""
    while True:
        on_frame()

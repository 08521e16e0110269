"""What is being written is told from what a killed writer left by a lock, whatever processes are called."""

import contextlib
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from filelock import FileLock

from envpred.interrupts import raised
from envpred.store import DriveWriter, Store, sweep
from envpred.store import parts as module
from envpred.store.files import replaced, write_json
from envpred.store.parts import MARK, begin
from tests.store.small import label, write

NAMESPACE = ["unshare", "--user", "--map-root-user", "--pid", "--fork", "--kill-child", "--mount-proc"]
# Writes half a drive "b", says so, and goes on when it is told to; its number is that of a container's first process.
WRITER = """
import os, sys
os.getpid = lambda: 1
from pathlib import Path
from envpred.store.writing import ArrayWriter
from tests.store.small import write
append = ArrayWriter.append
def wait(writer, frame):
    append(writer, frame)
    if writer.written == 2 and writer.file.name == "label.npy":
        writer._handle.flush()
        print("half", flush=True)
        sys.stdin.readline()
ArrayWriter.append = wait
write(Path(sys.argv[1]), "b")
"""


@pytest.fixture
def store(tmp_path: Path) -> Path:
    write(tmp_path / "grids")
    return tmp_path / "grids"


@contextmanager
def another_writer(store: Path, start: list[str]) -> Iterator[subprocess.Popen[str]]:
    """A process that has written half of a drive; it is killed at the end."""
    pipe = subprocess.PIPE
    process = subprocess.Popen(
        [*start, sys.executable, "-c", WRITER, str(store)], stdin=pipe, stdout=pipe, text=True, process_group=0
    )
    assert process.stdout is not None
    try:
        assert process.stdout.readline() == "half\n"
        yield process
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def parts(store: Path) -> list[str]:
    return [part.name for part in store.glob(".part-*")]


@pytest.mark.parametrize("start", [NAMESPACE, []], ids=["namespace", "same number"])
def test_writers_whose_processes_do_not_see_each_other_leave_each_other_alone(
    store: Path, start: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    if start and (not shutil.which("unshare") or subprocess.run([*start, "true"], check=False).returncode):
        pytest.skip("no namespace of processes may be made here")
    monkeypatch.setattr(os, "getpid", lambda: 1)
    with another_writer(store, start) as other:
        assert len(parts(store)) == 1
        sweep(store)
        assert len(parts(store)) == 1
        write(store, "b")  # the same drive at the same time
        assert len(parts(store)) == 1
        other.communicate("\n")
        assert other.returncode == 0
    drive = Store(store).drives["b"]
    drive.verify()
    assert (drive.array("label") == label()).all()
    assert parts(store) == []


def test_what_a_killed_writer_left_goes(store: Path) -> None:
    with another_writer(store, []):
        pass
    assert len(parts(store)) == 1
    write(store, "c")  # of another drive
    assert len(parts(store)) == 1
    write(store, "b")
    assert parts(store) == []
    Store(store).drives["b"].verify()


def test_a_live_part_of_this_process_stays(store: Path) -> None:
    with DriveWriter(store, "b", "mapping", "k", {}):
        sweep(store)
        assert len(parts(store)) == 1


@pytest.mark.parametrize(
    ("place", "step", "left"),
    [(FileLock, "acquire", set()), (module, "_remove", {"store.json"})],
    ids=["begun", "discarded"],
)
def test_a_signal_while_a_part_comes_or_goes_leaves_none(
    place: object, step: str, left: set[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    original = getattr(place, step)

    def pressed(*arguments: object) -> object:
        signal.raise_signal(signal.SIGINT)
        return original(*arguments)

    monkeypatch.setattr(place, step, pressed)
    with pytest.raises(KeyboardInterrupt), raised():
        write_json(tmp_path / "store.json", {})
    assert {file.name for file in tmp_path.iterdir()} == left


def test_a_signal_while_a_drive_is_published_leaves_it_unmarked(store: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rename = os.rename

    def pressed(*arguments: Path) -> None:
        rename(*arguments)
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(os, "rename", pressed)
    with pytest.raises(KeyboardInterrupt), raised():
        write(store, "b")
    assert not list(store.glob(f"*/{MARK}"))
    Store(store).drives["b"].verify()


def test_sweep_removes_what_nobody_writes_any_more(store: Path) -> None:
    living = begin(store / "b")
    (forgotten := store / ".part-a-anothermachine-1").mkdir()
    (elsewhere := store / ".part-c-anothermachine-1").mkdir()
    (foreign := store / living.folder.name.replace("-b-", "-e-")).mkdir()  # of such a name, and not marked
    (foreign / "label.npy").touch()
    store.joinpath(living.folder.name.replace("-b-", "-f-")).mkdir()  # its writer was killed before it could mark it
    for part in (forgotten, elsewhere):
        (part / MARK).touch()
        (part / "label.npy").touch()
    for file in (forgotten, *forgotten.iterdir()):
        os.utime(file, (0, 0))
    (store / "a" / MARK).touch()  # its writer was killed when it had published it
    sweep(store)
    assert set(parts(store)) == {living.folder.name, elsewhere.name, foreign.name}
    assert (foreign / "label.npy").exists()
    assert (living.folder / MARK).exists()
    assert not (store / "a" / MARK).exists()
    assert list(Store(store).drives) == ["a"]


def test_the_next_writer_of_a_file_removes_what_a_killed_one_left(tmp_path: Path) -> None:
    write_json(tmp_path / "store.json", {"a": 1})
    code = "import os, signal, sys\nfrom pathlib import Path\nfrom envpred.store import files\n"
    code += "files.os.fsync = lambda _: os.kill(os.getpid(), signal.SIGKILL)\n"
    code += "files.write_json(Path(sys.argv[1]), {'a': 2})"
    for name in ("store.json", "other.json"):
        killed = subprocess.run([sys.executable, "-c", code, str(tmp_path / name)], check=False)
        assert killed.returncode == -signal.SIGKILL
    assert len(list(tmp_path.iterdir())) == 3
    with replaced(tmp_path / "store.json") as part:
        part.write_text("{}")
        write_json(tmp_path / "store.json", {"a": 3})  # while another is written, which stays
    write_json(tmp_path / "other.json", {})
    assert {file.name for file in tmp_path.iterdir()} == {"store.json", "other.json"}
    assert (tmp_path / "store.json").read_text() == "{}"

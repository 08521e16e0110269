"""Whatever happens to a file that is read back: one line or a right result, and no file outside its folder is touched.

$ENVPRED_FAULTS (`make faults N=20`) multiplies the mutations of the slow suite, 10,000 over all kinds of files,
and draws others in every run.
"""

import logging
import os
import shutil
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from fnmatch import fnmatch
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from envpred.errors import UserError
from tests.faults.kinds import KINDS, Kind
from tests.faults.mutations import FOLDER, mutated

TIMES = int(os.environ.get("ENVPRED_FAULTS", "1"))
FAST = 0.004  # of the mutations, in the fast suite
LINES, LONGEST = 2, 1000  # `verify` counts the damaged drives in a second line
WRITING = ("os.remove", "os.rename", "os.rmdir", "os.mkdir", "os.truncate", "os.link", "os.symlink", "shutil.rmtree")
World = Callable[[Kind], Path]


class Watch:
    """Notes what is written or removed below `root` where nothing is to be written, and read outside the folder."""

    current: "Watch | None" = None

    def __init__(self, root: Path, folder: Path, written: tuple[str, ...]) -> None:
        self.root, self.folder, self.written = str(root), folder, ("out", "out/*", *written)
        self.touched: list[str] = []

    def see(self, event: str, args: tuple[Any, ...]) -> None:
        """Note an event of `sys.audit`."""
        if event != "open" and event not in WRITING:
            return
        mode = args[1] if event == "open" else "w"
        writes = any(letter in mode for letter in "wax+") if isinstance(mode, str) else bool(args[2] & os.O_ACCMODE)
        for path in args[:1] if event == "open" else args:
            if isinstance(path, str | bytes | os.PathLike):
                full = os.path.abspath(os.fsdecode(path))
                name = os.path.relpath(full, self.folder)
                kept = name.startswith("..") or (writes and not any(fnmatch(name, glob) for glob in self.written))
                if full.startswith(self.root) and kept:
                    self.touched.append(f"{event} {name}")

    @contextmanager
    def on(self) -> Iterator[None]:
        """Watch what the block does."""
        Watch.current = self
        try:
            yield
        finally:
            Watch.current = None


def _see(event: str, args: tuple[Any, ...]) -> None:
    if Watch.current is not None:
        Watch.current.see(event, args)


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with files that no command is told of, beside those of the examples."""
    sys.addaudithook(_see)  # for ever: there is no way to take it off
    root = tmp_path_factory.mktemp("faults")
    (root / "outside").mkdir()
    np.save(root / "outside" / "secret.npy", np.zeros((5, 8, 8), np.float16))
    for name in ("secret.png", "secret.gif", "secret.json", "secret.ckpt"):
        (root / "outside" / name).write_bytes(b"{}")
    return root


@pytest.fixture(scope="module")
def world(root: Path) -> World:
    """Writes an example of a kind of file, once, and gives its folder."""

    @cache
    def write(how: Callable[[Path], object]) -> Path:
        folder = root / how.__name__.strip("_")
        (folder / "out").mkdir(parents=True)
        how(folder)
        return folder

    return lambda kind: write(kind.write)


@pytest.fixture(autouse=True)
def _quiet() -> Iterator[None]:
    loggers = [logging.getLogger(name) for name in ("lightning.pytorch", "lightning.fabric", "optuna")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.ERROR)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # NumPy's and Lightning's, which end no command
        yield
    for logger, level in zip(loggers, levels, strict=True):
        logger.setLevel(level)


def try_mutations(kind: Kind, root: Path, folder: Path, examples: int, same: bool = False) -> None:
    """Mutate files of a kind `examples` times, the `same` ways or others every time, and read each as commands do."""
    files = sorted(folder.glob(kind.files))
    assert files
    rights = {seed: kind.read(folder, Random(seed)) for seed in range(2)}  # what is compiled or cached is so now

    @settings(
        max_examples=examples,
        derandomize=same,
        database=None,
        deadline=None,
        suppress_health_check=list(HealthCheck),
        phases=(Phase.generate,),  # a smaller example of a fault is not worth minutes
    )
    @given(random=st.randoms(use_true_random=False), reading=st.integers(0, 10**6))
    def tried(random: Random, reading: int) -> None:
        if kind.exact and reading not in rights:
            rights[reading] = kind.read(folder, Random(reading))
        file = random.choice(files)
        content = file.read_bytes()
        up = "../" * len(file.relative_to(folder).parts)
        secrets = [path.relative_to(root) for path in (root / "outside", *(root / "outside").iterdir())]
        outside = [name for secret in secrets for name in (f"{up}{secret}", str(root / secret))]
        _replace(file, mutated(random, file.name, content, outside if kind.paths else ()))
        watch, said = Watch(root, folder, kind.written), None
        try:
            with watch.on():
                result = kind.read(folder, Random(reading))
            assert not kind.exact or result == rights[reading], "another result, and no word about it"
        except UserError as error:
            said = str(error)
        finally:
            _replace(file, content)
        assert watch.touched == []
        if said is not None:
            assert 1 <= len(said.splitlines()) <= LINES
            assert all(line.isprintable() for line in said.splitlines()), ascii(said)
            assert len(said) < LONGEST

    tried()


def _replace(file: Path, content: bytes | None) -> None:
    """Let `content` stand in the place of `file`: nothing for None, a folder for `FOLDER`."""
    if file.is_dir():
        shutil.rmtree(file)
    else:
        file.unlink(missing_ok=True)
    if content == FOLDER:
        file.mkdir()
    elif content is not None:
        file.write_bytes(content)


@pytest.mark.parametrize("name", [name for name, kind in KINDS.items() if not kind.slow])
def test_a_few_damaged_files(name: str, root: Path, world: World) -> None:
    kind = KINDS[name]
    try_mutations(kind, root, world(kind), max(2, round(FAST * kind.share)), same=True)


@pytest.mark.slow
@pytest.mark.parametrize("name", KINDS)
def test_damaged_and_edited_files(name: str, root: Path, world: World) -> None:
    kind = KINDS[name]
    # By default the same mutations in every run, so that a red suite means that the code changed; more are others.
    try_mutations(kind, root, world(kind), TIMES * kind.share, same="ENVPRED_FAULTS" not in os.environ)

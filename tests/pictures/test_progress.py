"""Animations tell on a terminal how far they are, and nothing elsewhere."""

import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tqdm import tqdm

from envpred.pictures import grids
from envpred.pictures.animations import scene_animation
from envpred.pictures.velocities import of_drive
from envpred.store import Store
from tests.pictures.test_animations import of_grids
from tests.store.stores import write_store

FRAMES = 7


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize("out", [Terminal(), io.StringIO()], ids=["terminal", "file"])
def test_every_animation_tells_how_far_it_is(out: io.StringIO, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """However fast it is drawn here: without the delay after which it is told."""

    def at_once(*args: object, **options: object) -> object:
        assert options.pop("delay") == 1
        return tqdm(*args, file=out, mininterval=0, **options)  # type: ignore[call-overload]

    monkeypatch.setattr(grids, "tqdm", at_once)
    drive = Store(write_store(tmp_path / "grids", {"a": list(range(FRAMES))}, dogma=True)).drives["a"]
    shown = np.zeros((FRAMES - 3, 32, 32))
    animations: list[Callable[[], bytes]] = [
        lambda: grids.drive_animation(drive.array("label"), drive.array("evidence"), drive.period),
        lambda: of_drive(drive),
        lambda: scene_animation(of_grids(shown[:3], shown, {"one": shown})),
    ]
    for draw in animations:
        out.seek(0)
        out.truncate()
        assert draw().startswith(b"GIF89a")
        assert (f"{FRAMES}/{FRAMES}" in out.getvalue()) == isinstance(out, Terminal)

"""Mixes of towns: which drive lies where and how fast, whatever else is asked for."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from envpred.cli import main
from envpred.errors import UserError
from envpred.simulate import run, scene
from envpred.simulate.layout import STYLES
from envpred.simulate.presets import FASTEST, MIXES, PRESETS, STANDING, mixed, pace, town, weights_of
from envpred.simulate.streets import TOWNS
from envpred.simulate.traffic import Recording
from tests.remedies import refusal

NAMES = [town.name for town in TOWNS]
NUMBERS = range(1, PRESETS["train"].drives + 1)


def test_the_default_mix_has_all_towns_and_each_has_a_style() -> None:
    assert list(MIXES["default"]) == list(STYLES) == NAMES
    assert set(MIXES["towns"]) < set(NAMES)
    assert weights_of("default", ["here", *NAMES])[0] == 1  # a recording's own town


@pytest.mark.parametrize("mix", [*MIXES, "rural", "rural=3,suburb=1,old_town=2.5"])
@pytest.mark.parametrize("seed", [0, 7])
def test_a_mix_spreads_evenly_over_towns_and_speeds(mix: str, seed: int) -> None:
    weights = weights_of(mix, NAMES)
    found = np.array([town(seed, number, weights) for number in NUMBERS])
    speeds = np.array([pace(seed, number) for number in NUMBERS])
    for k in range(len(NAMES)):
        share = weights.get(k, 0) / sum(weights.values())
        assert (found == k).sum() == pytest.approx(share * len(found), abs=2 if k in weights else 0)
        mine = np.sort(speeds[found == k])
        if len(mine) > 5:  # no town has slow egos alone, or fast ones
            gaps = np.diff([0.0, *mine, FASTEST])
            assert gaps.max() < 4 * FASTEST / len(mine)
    assert (speeds == 0).mean() == pytest.approx(STANDING, abs=1.5 / len(NUMBERS))
    assert ((speeds > 0) & (speeds < 2)).mean() == pytest.approx(2 / FASTEST, abs=0.03)
    assert np.diff([*np.sort(speeds), FASTEST]).max() < 3 * FASTEST / len(NUMBERS)


@pytest.mark.parametrize(
    ("mix", "words"),
    [
        ("village", "--mix village: no town 'village'; give towns (old_town, residential, "),
        ("rural,,suburb", "no town ''"),
        ("default,rural", "no town 'default'"),
        ("towns=2", "or one of the mixes default, towns"),
        ("rural=much", "the weight of rural is no number above 0"),
        ("rural=", "the weight of rural is no number above 0"),
        ("rural=0,suburb=1", "the weight of rural is no number above 0"),
        ("rural=-1", "the weight of rural is no number above 0"),
        ("rural=nan", "the weight of rural is no number above 0"),
        ("rural=inf", "the weight of rural is no number above 0"),
        ("rural=1,suburb=1,rural=2", "rural comes twice"),
        ("", "no town ''"),
    ],
)
def test_a_wrong_mix_is_one_line_and_leaves_nothing(mix: str, words: str, tmp_path: Path) -> None:
    assert words in refusal(["simulate", str(tmp_path / "out"), "--drives", "1", "--frames", "2", "--mix", mix])
    assert not (tmp_path / "out").exists()


def test_a_named_mix_needs_one_of_its_towns() -> None:
    with pytest.raises(UserError, match="--mix towns: none of its towns is in the recording; there are here, there"):
        weights_of("towns", ["here", "there"])


def test_the_mix_decides_the_drives_however_it_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run, "run_jobs", lambda *_: None)
    told: list[str] = []
    monkeypatch.setattr(run, "say", told.append)
    command = ["simulate", str(tmp_path / "out"), "--drives", "8", "--frames", "2"]
    main([*command, "--mix", "suburb,rural=3"])
    assert re.match(r"towns: rural \d, suburb \d; egos at about", told[1])
    assert json.loads((tmp_path / "out" / run.ASKED).read_text())["mix"] == "suburb=0.25,rural=0.75"
    main([*command, "--mix", "rural=6, suburb=2"])
    assert told[0] == told[-3]  # same hash
    refused = refusal([*command, "--mix", "rural"])
    assert "mix suburb=0.25,rural=0.75 there, rural=1 asked" in refused
    assert mixed(weights_of("suburb=0.25,rural=0.75", NAMES), NAMES) == "suburb=0.25,rural=0.75"


def test_a_drive_lies_in_the_same_town_whatever_the_number_of_drives(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[tuple[int, int]] = []

    def build(_: object, network: int, *__: object) -> None:
        made.append((len(made) + 1, network))
        raise UserError("enough")

    monkeypatch.setattr(scene, "build", build)
    monkeypatch.setattr(Recording, "motions", lambda *_: [])
    monkeypatch.setattr(run, "run_jobs", lambda job, todo, *_: [job(drive, lambda: None) for drive in todo])
    for drives in (3, 4):
        run.simulate(tmp_path / str(drives), drives=drives, frames=2, mix="queues,rural,crescents")
    assert made[:3] == [(number, network) for number, (_, network) in enumerate(made[3:6], 1)]
    assert len({network for _, network in made}) > 1

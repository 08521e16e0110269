"""What docs/planner.md shows is true: its configuration names what is exported, its program runs."""

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from envpred.horizons import SHOWN_S
from envpred.live.bag import MAXIMUM, topic_of
from tests.drives.synthetic import write_drive

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "planner.md").read_text()


def block(language: str) -> str:
    (found,) = re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)
    return str(found)


def test_the_costmap_reads_what_is_exported() -> None:
    costmap: dict[str, Any] = yaml.safe_load(block("yaml"))["local_costmap"]["local_costmap"]["ros__parameters"]
    assert costmap["trinary_costmap"] is False
    assert costmap["track_unknown_space"] is costmap["use_maximum"] is costmap["rolling_window"] is True
    layers = [costmap[name] for name in costmap["plugins"]]
    static = [layer for layer in layers if layer["plugin"] == "nav2_costmap_2d::StaticLayer"]
    assert [layer["map_topic"] for layer in static] == [topic_of(seconds) for seconds in SHOWN_S[1:]]
    assert all(layer["map_subscribe_transient_local"] for layer in static)
    assert f"`{topic_of(0.1)}`" in PAGE
    assert f"`{MAXIMUM}`" in PAGE


def test_the_program_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_drive(tmp_path, frames=6, azimuths=120)
    names: dict[str, Any] = {}
    exec(block("python").replace("KITTI_ROOT", str(tmp_path)), names)
    least, most, unknown = map(float, re.findall(r"[\d.]+", capsys.readouterr().out))
    assert 0 <= least <= most <= 1
    assert unknown <= 1
    assert len(names["grids"]) == 15

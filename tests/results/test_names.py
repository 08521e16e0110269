"""What methods are called."""

import doctest
from typing import Any

import pytest

from envpred.results import names
from envpred.results.names import method_name


def test_examples() -> None:
    assert doctest.testmod(names).failed == 0


@pytest.mark.parametrize(
    ("model", "role", "variant", "name"),
    [
        ({"name": "prednet", "hyperparameters": {"t1_epochs": 1, "t5_epochs": 2}}, "learned", "dst_dogma", "DST DOGMa"),
        (
            {"name": "prednet", "hyperparameters": {"t1_epochs": 3, "t5_epochs": 0}},
            "learned",
            "a_b",
            "a b, stage t+1 alone",
        ),
        ({"name": "prednet", "untrained": True}, "learned", "prob_static", "probability static, untrained"),
        (
            {"name": "prednet", "hyperparameters": {"fixed_frame": True}},
            "learned",
            "dst_static",
            "fixed frame, DST static",
        ),
    ],
)
def test_inputs_and_stages_of_prednet(model: dict[str, Any], role: str, variant: str, name: str) -> None:
    assert method_name(model, role, variant) == f"PredNet, {name}"


@pytest.mark.parametrize(
    ("name", "role", "called"),
    [
        ("fcn", "learned", "FCN, probability DOGMa"),
        ("corrected_rollout", "learned", "Corrected rollout"),
        ("last_frame", "static", "Static"),
        ("particle_forecast", "particle", "Particle filter"),
        ("moved_last_frame_oracle", "oracle", "Last frame, true motion"),
        ("my_own", "moved", "My own"),
    ],
)
def test_only_what_learned_is_called_by_its_input(name: str, role: str, called: str) -> None:
    assert method_name({"name": name}, role, "prob_dogma") == called


def test_a_rollout_says_whether_its_world_stands() -> None:
    told = [{"name": "rollout", "hyperparameters": {"movers": movers}} for movers in (True, False)]
    assert [method_name(model, "rollout", "dst_static") for model in told] == ["Rollout", "Rollout, standing world"]

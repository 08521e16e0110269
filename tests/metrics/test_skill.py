"""Skill against a reference."""

import pytest
import torch

from envpred.metrics.horizon_mse import HorizonMSE
from envpred.metrics.skill import StaticSkill, skill, skill_against


def test_by_hand() -> None:
    mse = torch.tensor([[1.0], [2.0], [3.0]])
    reference = torch.tensor([[2.0], [6.0], [4.0]])
    result = skill(mse, reference)
    assert result.value.item() == pytest.approx(0.5)
    # residuals 1 - 0.5*2 = 0, 2 - 3 = -1, 3 - 2 = 1: sqrt((0 + 1 + 1)/2/3)/4
    assert result.standard_error.item() == pytest.approx((1 / 3) ** 0.5 / 4)


def test_against_itself_is_nothing() -> None:
    mse = torch.rand(7, 3, generator=torch.Generator().manual_seed(0))
    result = skill(mse, mse)
    torch.testing.assert_close(result.value, torch.zeros(3, dtype=torch.float64))
    torch.testing.assert_close(result.standard_error, torch.zeros(3, dtype=torch.float64))


def test_static_skill_is_the_skill_against_the_last_grid() -> None:
    generator = torch.Generator().manual_seed(1)
    forecast, target = torch.rand(2, 4, 3, 5, 5, generator=generator)
    last = torch.rand(4, 5, 5, generator=generator)
    index = torch.arange(4)
    metric, own, static = StaticSkill(3), HorizonMSE(3), HorizonMSE(3)
    metric.update(forecast, target, last, index)
    metric.update(forecast[:1], target[:1], last[:1], index[:1])
    own.update(forecast, target, last, index)
    static.update(last[:, None].expand_as(target), target, last, index)
    found, expected = metric.compute(), skill_against(own.compute(), static.compute())
    torch.testing.assert_close(found.value, expected.value)
    torch.testing.assert_close(found.standard_error, expected.standard_error)
    assert found.as_json()["title"] == "Skill against the static baseline"


def test_other_windows_are_refused() -> None:
    target = torch.zeros(2, 1, 2, 2)
    one, two = HorizonMSE(1), HorizonMSE(1)
    one.update(target, target, index=torch.tensor([0, 1]))
    two.update(target, target, index=torch.tensor([0, 2]))
    with pytest.raises(ValueError, match="different"):
        skill_against(one.compute(), two.compute())
    with pytest.raises(ValueError, match="must both be"):
        skill(torch.zeros(2, 3), torch.zeros(2, 2))
    with pytest.raises(ValueError, match="StaticSkill needs `last`"):
        StaticSkill(1).update(target, target)

"""The state that all metrics share: duplicates, processes, refusals."""

import math
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor, distributed
from torch.multiprocessing.spawn import spawn

from envpred.metrics.about import About
from envpred.metrics.horizon_mse import HorizonMSE
from envpred.metrics.windows import HorizonMetric, PerHorizon, summarise

ABOUT = About("Error", "m", 2, 10.0, "lower")


def tensors(result: PerHorizon) -> dict[str, Tensor]:
    """What was measured."""
    return {name: value for name, value in vars(result).items() if isinstance(value, Tensor)}


def windows(count: int) -> tuple[Tensor, Tensor]:
    """`count` forecasts and targets (count, 3, 4, 5) whose errors differ by window and horizon."""
    generator = torch.Generator().manual_seed(3)
    forecast, target = torch.rand(2, count, 3, 4, 5, generator=generator)
    return forecast, target


# Windows that each of two processes sees: as a sampler pads them, and with a process that sees none.
SHARES = ([[0, 2, 4], [1, 3, 0]], [[4, 3, 2, 1, 0], []])


def rank_of_two(rank: int, folder: str) -> None:
    """Update with this process's share, compute over both processes and leave the result in `folder`."""
    distributed.init_process_group("gloo", init_method=f"file://{folder}/rendezvous", rank=rank, world_size=2)
    forecast, target = windows(5)
    for n, shares in enumerate(SHARES):
        metric = HorizonMSE(3)
        for index in shares[rank]:
            metric.update(forecast[[index]], target[[index]], index=torch.tensor([index]))
        torch.save(tensors(metric.compute()), f"{folder}/result{n}{rank}.pt")
        again = metric.rows()[0]  # after the computation the process has its own windows back
        assert again.tolist() == sorted(shares[rank])
    distributed.barrier()  # torch 2.6 may wait for ever to take a group apart that the other process is still using
    distributed.destroy_process_group()


@pytest.mark.slow
def test_two_processes_agree_with_one(tmp_path: Path) -> None:
    spawn(rank_of_two, args=(str(tmp_path),), nprocs=2)  # type: ignore[no-untyped-call]
    forecast, target = windows(5)
    alone = HorizonMSE(3)
    alone.update(forecast, target, index=torch.arange(5))
    for n in range(len(SHARES)):
        for rank in (0, 1):
            torch.testing.assert_close(torch.load(tmp_path / f"result{n}{rank}.pt"), tensors(alone.compute()))


def test_windows_come_back_in_order_and_once() -> None:
    forecast, target = windows(3)
    metric = HorizonMSE(3)
    metric.update(forecast[[2, 0]], target[[2, 0]], index=torch.tensor([12, 7]))
    metric.update(forecast[[1, 2]], target[[1, 2]], index=torch.tensor([9, 12]))
    result = metric.compute()
    assert result.index.tolist() == [7, 9, 12]
    expected = ((forecast - target) ** 2).mean((2, 3))
    torch.testing.assert_close(result.per_window.float(), expected)


def test_windows_without_index_are_all_counted() -> None:
    forecast, target = windows(2)
    metric = HorizonMSE(3)
    for _ in range(2):
        metric.update(forecast, target)
    assert metric.compute().per_window.shape == (4, 3)


def test_standard_error_by_hand() -> None:
    # 1, 2, 6: mean 3, sample variance (4 + 1 + 9)/2 = 7, standard error sqrt(7/3).
    result = summarise(torch.tensor([[1.0], [2.0], [6.0]]), torch.arange(3), ABOUT)
    assert result.mean.item() == pytest.approx(3)
    assert result.standard_error.item() == pytest.approx(math.sqrt(7 / 3))


def test_undefined_windows_are_skipped_only_where_the_metric_says_so() -> None:
    values = torch.tensor([[1.0, math.nan], [math.nan, math.nan], [3.0, 5.0]])
    skipped = summarise(values, torch.arange(3), ABOUT, skip_undefined=True)
    torch.testing.assert_close(skipped.mean, torch.tensor([2.0, 5.0], dtype=torch.float64))
    assert skipped.standard_error[0].item() == pytest.approx(1)
    assert skipped.standard_error[1].isnan()  # one window has no spread
    assert summarise(values, torch.arange(3), ABOUT).mean.isnan().all()


def test_reset_forgets_and_nothing_seen_is_nan() -> None:
    metric = HorizonMSE(3)
    forecast, target = windows(2)
    metric.update(forecast, target)
    metric.reset()
    with pytest.warns(UserWarning, match="before the ``update``"):
        result = metric.compute()
    assert result.mean.isnan().all()
    assert result.per_window.shape == (0, 3)


def test_wrong_shapes_are_refused() -> None:
    forecast, target = windows(2)
    with pytest.raises(ValueError, match=r"must both be \(B, 15, H, W\)"):
        HorizonMSE().update(forecast, target)
    with pytest.raises(ValueError, match="must both be"):
        HorizonMSE(3).update(forecast, target[:1])
    with pytest.raises(ValueError, match="last"):
        HorizonMSE(3).update(forecast, target, last=target)
    with pytest.raises(ValueError, match="index"):
        HorizonMSE(3).update(forecast, target, index=torch.tensor([0, 2**24]))
    with pytest.raises(ValueError, match=r"samples \(2, 3, 4, 5\) must be"):
        HorizonMSE(3).update(forecast, target, samples=forecast)
    with pytest.raises(ValueError, match="moving"):
        HorizonMSE(3).update(forecast, target, moving=target)
    with pytest.raises(ValueError, match=r"label \(2, 1, 4, 5\) of torch.uint8 must be uint8 \(2, 3, 4, 5\)"):
        HorizonMSE(3).update(forecast, target, label=target[:, :1].byte())
    with pytest.raises(ValueError, match="at least one horizon"):
        HorizonMSE(0)


def test_one_window_and_one_horizon_keep_their_axes() -> None:
    metric = HorizonMSE(1)
    metric.update(torch.zeros(1, 1, 2, 2), torch.ones(1, 1, 2, 2))
    result = metric.compute()
    assert (result.mean.shape, result.per_window.shape, result.index.shape) == ((1,), (1, 1), (1,))
    values = {"mean": [1.0], "standard_error": [None], "per_window": [[1.0]]}
    about: dict[str, Any] = {"title": "MSE", "unit": "× 10⁻³", "digits": 1, "factor": 1e3, "direction": "lower"}
    about["rewards"] = HorizonMSE.rewards
    assert result.as_json() == values | about


def test_how_a_result_is_written_stands_on_the_class() -> None:
    class FalseAlarms(HorizonMetric):
        unit, digits, factor, direction, higher_is_better = "%", 0, 100.0, "higher", True
        rewards = "Rewards crying wolf."

        def measure(self, forecast: Tensor, target: Tensor, last: Tensor) -> Tensor:
            return forecast.mean((-2, -1))

    class Loud(FalseAlarms):
        title = "Loud alarms"

    assert (FalseAlarms.name, Loud.name) == ("false_alarms", "loud")
    metric = FalseAlarms(1)
    metric.update(torch.ones(1, 1, 2, 2), torch.zeros(1, 1, 2, 2))
    assert metric.compute().about == About("False Alarms", "%", 0, 100.0, "higher", "Rewards crying wolf.")
    assert Loud(1).about == About("Loud alarms", "%", 0, 100.0, "higher", "Rewards crying wolf.")
    assert About.of(metric.compute().as_json()) == metric.about
    silent = {name: value for name, value in metric.about._asdict().items() if name != "rewards"}
    assert About.of(silent) == metric.about._replace(rewards="")
    assert summarise(torch.ones(1, 1), torch.arange(1), ABOUT).as_json()["unit"] == "m"


def test_a_direction_that_contradicts_torchmetrics_is_refused() -> None:
    with pytest.raises(TypeError, match="Wrong: direction 'higher' and higher_is_better False disagree"):
        type("Wrong", (HorizonMetric,), {"direction": "higher"})
    with pytest.raises(TypeError, match=r"direction 1\.0 and higher_is_better True"):
        type("Wrong", (HorizonMetric,), {"direction": 1.0, "higher_is_better": True})


def test_a_metric_that_measures_nothing_says_so() -> None:
    class Nothing(HorizonMetric):
        pass

    with pytest.raises(NotImplementedError, match="Nothing has neither a `measure` nor a `judge`"):
        Nothing(3).update(*windows(1))

"""What a forecaster sees of scans that were mapped here and now, without a store."""

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from envpred.datamodules.contract import Needs, Seen
from envpred.datamodules.variants import Variant
from envpred.datamodules.windows import CONTEXT, pose_of, widened
from envpred.errors import UserError
from envpred.mapping.evidence import pignistic
from envpred.mapping.geometry import heading_of
from envpred.mapping.mapper import Mapped, Mapper

# Stored arrays, and what the mapper calls them.
_DOGMA = {"velocity": "velocity", "velocity_cov": "covariance", "particle_forecast": "forecast"}


def seen_of(mapper: Mapper, mapped: Sequence[Mapped], variant: Variant, needs: Needs) -> Seen:
    """The frames `mapped`, the last of which is the present, as a batch of one window.

    Args:
        mapper: that has mapped them.
        mapped: as many frames as the forecaster is shown.
        variant: channels of the frames.
        needs: what the forecaster reads beside them.

    Raises:
        UserError: if something is needed that the mapper does not make.
    """
    if needs.context and mapper.context is None:
        raise UserError("the mapper maps no wide grid, which the forecaster needs; give Mapper(context=256)")
    judged = _arrays(mapped)
    missing = [name for name in (*variant.arrays, *needs.arrays) if name not in judged]
    if missing:
        remedy = "Mapper(context=256)" if missing == [f"{CONTEXT}evidence"] else "Mapper(velocities=...)"
        raise UserError(f"the mapper makes no {', '.join(missing)}; give {remedy} or another forecaster")
    origin = mapper.origin
    assert origin is not None  # it follows from the first scan
    pose = np.stack([frame.pose for frame in mapped])
    cells = mapper.grid.in_cells(pose[:, :2, 3], origin)
    time = np.array([frame.time for frame in mapped])
    body = mapper.body
    seen: Seen = {
        "frames": _batch(variant.make_frames(judged)),
        "occupancy": _batch(pignistic(judged["evidence"])),
        "label": _batch(np.stack([frame.label for frame in mapped])),
        "centre_cell": _batch(np.stack([frame.centre_cell for frame in mapped])),
        "pose": _batch(np.concatenate([cells, heading_of(pose)[:, None]], axis=1)),
        "time": _batch(time - time[-1]),
        "sensor": _batch(pose_of(mapper.sensor_to_body)),
        "body": _batch(np.array([body.rear, body.front, body.half_width])),
        "resolution": _batch(np.array(mapper.grid.resolution)),
        "period": _batch(np.array(mapper.period)),
        "arrays": {name: _batch(judged[name]) for name in needs.arrays},
    }
    if needs.context:
        wide = judged[f"{CONTEXT}evidence"]
        around = {name: widened(judged[name], wide.shape[-1]) for name in variant.arrays if name != "evidence"}
        seen["context"] = _batch(variant.make_frames({"evidence": wide, **around}))
        seen["context_label"] = _batch(np.stack([_given(frame.context_label) for frame in mapped]))
    return seen


def _arrays(mapped: Sequence[Mapped]) -> dict[str, NDArray[np.float32]]:
    """The arrays that a store would hold of the frames, by name."""
    found = {"evidence": _kept([frame.mass for frame in mapped])}
    if all(frame.context_mass is not None for frame in mapped):
        found[f"{CONTEXT}evidence"] = _kept([_given(frame.context_mass) for frame in mapped])
    dogmas = [frame.velocities for frame in mapped]
    if all(dogma is not None for dogma in dogmas):
        for name, field in _DOGMA.items():
            values = [getattr(dogma, field) for dogma in dogmas]
            if all(value is not None for value in values):
                found[name] = np.stack(values).astype(np.float32)
    return found


def _kept(mass: Sequence[NDArray[np.generic]]) -> NDArray[np.float32]:
    """Masses (T, 2, H, W) as the store keeps them."""
    stacked = torch.from_numpy(np.stack(mass).astype(np.float32, copy=False))
    kept: NDArray[np.float32] = stacked.half().float().numpy()  # NumPy takes ten times as long to round
    return kept


def _given(value: NDArray[np.generic] | None) -> NDArray[np.generic]:
    assert value is not None  # the mapper that has a wide grid maps it in every frame
    return value


def _batch(array: NDArray[np.generic]) -> torch.Tensor:
    """A tensor with the axis B of one window, in single precision at most."""
    return torch.from_numpy(np.array(array, np.float32 if array.dtype == np.float64 else array.dtype))[None]

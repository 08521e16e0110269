"""Scenes: single windows with what was seen, what came and what was forecast, as pictures show them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from envpred.errors import UserError
from envpred.gate import read_arrays
from envpred.gate.runs import SCENES
from envpred.horizons import SHOWN_S, shown_steps
from envpred.results.movers import Mover, movers
from envpred.store.files import replaced

Grids = NDArray[np.float32]
TOLERANCE = 2e-3  # between grids that were kept as halves


@dataclass(frozen=True)
class Scene:
    """One window of a drive.

    Args:
        drive: its name.
        frames: frame numbers shown; the last one is the present.
        seen: probability of occupied (S, H, W) in them; S may be 0 where the grids are not at hand.
        target: probability of occupied (n, H, W) in the frames that follow, as far as there are any.
        centre_cell: (S + n, 2), where those grids lie on the drive's lattice.
        forecasts: (N, H, W) by method.
        resolution: side of a cell in metres.
        period: seconds between frames.
        context: probability of occupied (H', W') of the wider grid around the last frame shown, where a method read it.
        oracles: methods among `forecasts` that read the future.
    """

    drive: str
    frames: tuple[int, ...]
    seen: Grids
    target: Grids
    centre_cell: NDArray[np.int64]
    forecasts: dict[str, Grids]
    resolution: float
    period: float
    context: Grids | None = None
    oracles: frozenset[str] = frozenset()

    @property
    def where(self) -> str:
        """Drive and frame, as pictures are titled."""
        return f"{self.drive}, frame {self.frames[-1]}"

    @property
    def static(self) -> Grids:
        """The static baseline's forecast: the last frame shown, for every horizon."""
        return np.repeat(self.seen[-1:], self.horizons, axis=0)

    @property
    def horizons(self) -> int:
        """Horizons that a forecast reaches."""
        return max(len(forecast) for forecast in self.forecasts.values())

    @property
    def shown(self) -> tuple[int, ...]:
        """The horizons that pictures show: the paper's, and the last if it lies beyond them."""
        steps = shown_steps(self.horizons, self.period)
        beyond = self.horizons * self.period > SHOWN_S[-1] and self.horizons not in steps
        return (*steps, self.horizons) if beyond else steps

    def named(self, method: str) -> "Scene":
        """The same with another name for its only method."""
        (grids,) = self.forecasts.values()
        return replace(self, forecasts={method: grids}, oracles=frozenset({method} if self.oracles else ()))

    def movers(self, horizon: int) -> list[Mover]:
        """What moves in the target `horizon` frames ahead; nothing where there is none."""
        if horizon > len(self.target) or not len(self.seen):
            return []
        grids, frame = np.concatenate([self.seen, self.target]), len(self.seen) - 1 + horizon
        return movers(grids, self.centre_cell, frame, self.resolution, self.period)


def together(scenes: Sequence[Scene]) -> Scene:
    """The forecasts of several scenes of one window in one.

    Raises:
        UserError: if they are not of the same window, or saw other grids.
    """
    first = scenes[0]
    for other in scenes[1:]:
        named = ", ".join(other.forecasts)
        if (other.drive, other.frames[-1]) != (first.drive, first.frames[-1]):
            raise UserError(f"{named} forecasts another window ({other.where}) than {first.where}; draw it apart")
        if not np.allclose((other.resolution, other.period), (first.resolution, first.period)):
            raise UserError(
                f"{named} forecasts cells of {other.resolution:.3g} m every {other.period:.3g} s, not of "
                f"{first.resolution:.3g} m every {first.period:.3g} s; draw it apart"
            )
        both = min(len(first.target), len(other.target))
        if first.target.shape[1:] != other.target.shape[1:] or not np.allclose(
            first.target[:both], other.target[:both], atol=TOLERANCE
        ):
            raise UserError(f"{named} was judged on other grids of {first.where}; forecast or test again on the same")
    longest = max(scenes, key=lambda scene: (len(scene.target), len(scene.seen)))
    return replace(
        longest,
        forecasts={name: grids for scene in scenes for name, grids in scene.forecasts.items()},
        context=next((scene.context for scene in scenes if scene.context is not None), None),
        oracles=frozenset().union(*(scene.oracles for scene in scenes)),
    )


def write_scenes(file: Path, scenes: Mapping[int, Scene]) -> None:
    """Keep scenes of one method, by their place among the test windows, in `file` (.npz, grids as halves).

    All have the same shapes, and all or none a context.
    """
    kept = list(scenes.values())
    arrays = {
        "index": np.array(list(scenes)),
        "drive": np.array([scene.drive for scene in kept]),
        "frames": np.array([scene.frames for scene in kept]),
        "seen": np.stack([scene.seen for scene in kept]).astype(np.float16),
        "target": np.stack([scene.target for scene in kept]).astype(np.float16),
        "centre_cell": np.stack([scene.centre_cell for scene in kept]),
        "forecast": np.stack([next(iter(scene.forecasts.values())) for scene in kept]).astype(np.float16),
        "resolution": np.array([scene.resolution for scene in kept]),
        "period": np.array([scene.period for scene in kept]),
    }
    contexts = [scene.context for scene in kept if scene.context is not None]
    if contexts:
        arrays["context"] = np.stack(contexts).astype(np.float16)
    with replaced(file) as part:
        np.savez_compressed(part, allow_pickle=False, **arrays)


def read_scenes(file: Path, method: str, oracle: bool = False) -> dict[int, Scene]:
    """What `write_scenes` kept; `method` names its forecasts, which read the future if it is an `oracle`.

    Raises:
        UserError: if the file is missing or damaged.
    """
    remedy = f"delete {file.parent} and run `envpred test` again"
    arrays = read_arrays(file, SCENES, remedy)
    if arrays["centre_cell"].shape[1] != arrays["seen"].shape[1] + arrays["target"].shape[1]:
        raise UserError(f"{file}: has cells for other frames than it holds; {remedy}")
    grids = {
        name: arrays[name].astype(np.float32) for name in ("seen", "target", "forecast", "context") if name in arrays
    }
    return {
        int(index): Scene(
            str(arrays["drive"][k]),
            tuple(arrays["frames"][k].tolist()),
            grids["seen"][k],
            grids["target"][k],
            arrays["centre_cell"][k],
            {method: grids["forecast"][k]},
            float(arrays["resolution"][k]),
            float(arrays["period"][k]),
            grids["context"][k] if "context" in grids else None,
            frozenset({method} if oracle else ()),
        )
        for k, index in enumerate(arrays["index"])
    }

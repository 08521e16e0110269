"""The method on one page: a scan and a pose in; label grid, evidence and, if asked for, velocities out (no files).

    mapper = Mapper(MappingParameters())
    for points, pose, time in scans:
        label, mass, *_ = mapper.step(points, pose, time)

Points are told from the ground (Postica et al. 2016), cast as rays into a label grid, and fused with what was seen
before (Nuss et al. 2015).  All grids are cut from one lattice, whose cells stay where they are in the world.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from envpred.mapping import evidence
from envpred.mapping.evidence import EvidenceParameters, Mass
from envpred.mapping.geometry import (
    PAPER_BODY,
    PAPER_SENSOR_HEIGHT,
    PAPER_SENSOR_OFFSET,
    Body,
    FloatArray,
    GridSpec,
    IntArray,
)
from envpred.mapping.ground import GroundSegmenter, MarkovRandomField
from envpred.mapping.label_grid import RayCasting
from envpred.mapping.period import PERIOD, is_gap

if TYPE_CHECKING:  # it brings torch along, which only velocities need
    from envpred.mapping.dogma import Dogma, DogmaParameters

Label = NDArray[np.uint8]


@dataclass(frozen=True)
class MappingParameters:
    """Everything that decides what the grids of a drive look like.

    Args:
        grid: cells and resolution.
        ground: how ground is told from obstacles.
        rays: how obstacles become a label grid.
        evidence: what labels say, and how fast it fades.
        sensor: where the sensor sits: the drive's `calibration`, or the `paper`'s fixed offset without rotation.
        every: map every so many scans of a drive alone.
    """

    grid: GridSpec = field(default_factory=GridSpec)
    ground: GroundSegmenter = field(default_factory=MarkovRandomField)
    rays: RayCasting = field(default_factory=RayCasting)
    evidence: EvidenceParameters = field(default_factory=EvidenceParameters)
    sensor: Literal["calibration", "paper"] = "calibration"
    every: int = 1

    def __post_init__(self) -> None:
        if self.every < 1:
            raise ValueError(f"every {self.every}: map every scan (1), every second one (2), and so on")

    def as_dict(self) -> dict[str, Any]:
        """Plain data that says it all, for the store's index and its hash."""
        return {**asdict(self), "ground": {"method": type(self.ground).__name__, **vars(self.ground)}}


class Mapped(NamedTuple):
    """What is known after a scan.

    Args:
        label: (H, W) uint8 label codes of this scan.
        mass: (2, H, W) float32 evidence (occupied, free) of all scans since the last gap.
        centre_cell: (2,) int32 lattice cell at the centre of the grids.
        velocities: of the cells, where the mapper was asked for them.
        context_label: (H', W') label codes of the wider grid with the same centre, where there is one.
        context_mass: (2, H', W') its evidence.
        obstacle: (N,) bool which of the scan's points are obstacles, out to where the wider grid ends.
        pose: (4, 4) of the body in the world, as it was given.
        time: of the scan in seconds, as it was given.
    """

    label: Label
    mass: Mass
    centre_cell: IntArray
    velocities: "Dogma | None"
    context_label: Label | None
    context_mass: Mass | None
    obstacle: NDArray[np.bool_]
    pose: FloatArray
    time: float


class _Evidence:
    """The evidence of one grid, carried from scan to scan."""

    def __init__(self, grid: GridSpec, parameters: EvidenceParameters) -> None:
        self.grid, self.parameters = grid, parameters
        self.reset()

    def reset(self) -> None:
        self.mass = np.zeros((2, self.grid.cells, self.grid.cells), np.float32)

    def step(self, label: Label, shift: IntArray) -> Mass:
        self.mass = evidence.step(self.mass, label, shift, self.parameters)
        return self.mass


class Mapper:
    """Maps scans one after the other; what was seen before is kept inside.

    Args:
        parameters: of the method.
        body: the ego vehicle's body in the sensor frame.
        sensor_to_body: (4, 4) from the sensor frame to the body frame that poses are of.
        origin: (2,) world position of lattice cell (0, 0) in metres; by default it follows from the first pose.
        period: nominal time between scans in seconds: what fades, fades with time.
        sensor_height: height of the sensor above the road, in metres.
        context: a wider grid of the same resolution that is mapped beside the judged one.
        velocities: makes velocities too, by the particle filter with these numbers.
        seed: of the particle filter.
        with_forecast: whether the particle filter also forecasts.
        device: where the particle filter runs.

    Attributes:
        on_stage: called with the name of each stage when it is done: ground, label, evidence, and velocities if made.

    Raises:
        UserError: if the wider grid does not go with the judged one.
    """

    def __init__(
        self,
        parameters: MappingParameters | None = None,
        body: Body = PAPER_BODY,
        sensor_to_body: FloatArray = PAPER_SENSOR_OFFSET,
        origin: FloatArray | None = None,
        period: float = PERIOD,
        *,
        sensor_height: float = PAPER_SENSOR_HEIGHT,
        context: int | None = None,
        velocities: "DogmaParameters | None" = None,
        seed: int = 0,
        with_forecast: bool = False,
        device: str = "cpu",
    ) -> None:
        self.parameters = parameters or MappingParameters()
        self.body, self.sensor_to_body, self.sensor_height = body, sensor_to_body, sensor_height
        self.origin, self.period = origin, period
        self.grid = self.parameters.grid
        self.context = None if context is None else self.grid.wider(context)
        fading = self.parameters.evidence.at(period)
        self._judged = _Evidence(self.grid, fading)
        self._wide = None if self.context is None else _Evidence(self.context, fading)
        self._filter = None
        if velocities is not None:
            from envpred.mapping.dogma import VelocityFilter

            self._filter = VelocityFilter(velocities, self.grid, period, seed, with_forecast, device)
        self.on_stage: Callable[[str], object] = _nobody_looks
        self._before: tuple[IntArray, float] | None = None  # centre cell and time of the last scan

    def reset(self) -> None:
        """Forget what was seen, as after a gap; the lattice stays."""
        self._before = None
        self._judged.reset()
        if self._wide is not None:
            self._wide.reset()
        if self._filter is not None:
            self._filter.reset()

    def step(self, points: NDArray[np.float32], pose: FloatArray, time: float) -> Mapped:
        """What is known after one more scan.  After a gap in time it starts anew.

        Args:
            points: (N, >=3) in the sensor frame, metres.
            pose: (4, 4) of the body in the world.
            time: of the scan, in seconds.

        Raises:
            ValueError: if `time` is not later than that of the scan before.
        """
        if self.origin is None:
            self.origin = self.grid.lattice_origin(pose[None, :3, 3])
        centre_cell = self.grid.cell_of(pose[:3, 3], self.origin)
        shift = self._shift(centre_cell, time)

        reach, context_reach = self.grid.reach, None if self.context is None else self.context.reach
        obstacle = self.parameters.ground.obstacles(points, reach, self.sensor_height, context_reach)
        self.on_stage("ground")
        where = pose @ self.sensor_to_body, centre_cell, self.origin, self.grid
        context_label = context_mass = None
        if self.context is None:
            label = self.parameters.rays.label(points, obstacle, *where, self.body)
        else:
            label, context_label = self.parameters.rays.labels(points, obstacle, *where, self.context, self.body)
        self.on_stage("label")
        if self._wide is not None and context_label is not None:
            context_mass = self._wide.step(context_label, shift)
        mass = self._judged.step(label, shift)
        self.on_stage("evidence")

        velocities = None
        if self._filter is not None:
            measured = evidence.measured(label, self.parameters.evidence)
            velocities = self._filter.step(measured, centre_cell, pose[:2, 3])
            self.on_stage("velocities")
        return Mapped(label, mass, centre_cell, velocities, context_label, context_mass, obstacle, pose, time)

    def _shift(self, centre_cell: IntArray, time: float) -> IntArray:
        """How far (2,) the grids have moved since the scan before, in cells; resets after a gap."""
        if self._before is not None:
            step = time - self._before[1]
            if step <= 0:
                raise ValueError(f"a scan at {time} s does not follow one at {self._before[1]} s")
            if is_gap(step, self.period):
                self.reset()
        before = centre_cell if self._before is None else self._before[0]
        self._before = centre_cell, time
        return centre_cell - before


def _nobody_looks(stage: str) -> None:
    """What is called of a stage that nobody waits for."""

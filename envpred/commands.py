"""Our own commands, as functions: their arguments are the command line's."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

from envpred.build import MappingParameters, build
from envpred.mapping.evidence import EvidenceParameters
from envpred.mapping.geometry import GridSpec
from envpred.mapping.ground import GroundSegmenter, MarkovRandomField
from envpred.mapping.label_grid import RayCasting
from envpred.store import Store


def grids(
    source: Path,
    store: Path,
    drives: list[str] | None = None,
    grid: GridSpec = GridSpec(),
    ground: GroundSegmenter = MarkovRandomField(),
    rays: RayCasting = RayCasting(),
    evidence: EvidenceParameters = EvidenceParameters(),
    sensor: Literal["calibration", "paper"] = "calibration",
    workers: int | None = None,
    cluster: str | None = None,
    force: bool = False,
) -> None:
    """Turn LiDAR drives into label grids and evidence on disk.

    Args:
        source: folder with drives in KITTI raw's or KITTI odometry's layout.
        store: folder for the grids; finished drives in it are kept.
        drives: names of the drives to map; by default all.
        grid: cells and resolution.
        ground: how ground is told from obstacles: MarkovRandomField or RansacPlane.
        rays: how obstacles become a label grid.
        evidence: what labels say, and how fast it fades.
        sensor: where the sensor sits: by the day's calibration, or as the paper's code takes it.
        workers: local processes; by default one a core.
        cluster: address of a Dask scheduler that works instead of local processes.
        force: build again what is there, also with other parameters.
    """
    parameters = MappingParameters(grid, ground, rays, evidence, sensor)
    build(source, store, parameters, drives, workers, cluster, force)


def verify(store: Path) -> None:
    """Read a store's grids and compare their checksums.

    Args:
        store: folder that `envpred grids` wrote.
    """
    drives = Store(store).drives
    for name, drive in drives.items():
        drive.verify()
        print(f"{name}: {len(drive.frames)} frames, good")


COMMANDS: dict[str, Callable[..., Any]] = {"grids": grids, "verify": verify}

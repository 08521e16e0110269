"""Our own commands, as functions: their arguments are the command line's."""

from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from envpred.build.grids import build
from envpred.drives import one_drive, one_frame
from envpred.errors import UserError
from envpred.interrupts import ends_at_once
from envpred.mapping.evidence import EvidenceParameters
from envpred.mapping.geometry import GridSpec
from envpred.mapping.ground import GroundSegmenter, MarkovRandomField, RansacPlane
from envpred.mapping.label_grid import RayCasting
from envpred.mapping.mapper import MappingParameters
from envpred.store import MANIFEST, Store, StoredDrive

if TYPE_CHECKING:  # it brings torch along, which only some commands need
    from envpred.mapping.dogma import DogmaParameters


def grids(
    store: Path,
    source: Path | None = None,
    drives: list[str] | None = None,
    grid: GridSpec = GridSpec(),
    ground: GroundSegmenter = MarkovRandomField(),
    rays: RayCasting = RayCasting(),
    evidence: EvidenceParameters = EvidenceParameters(),
    sensor: Literal["calibration", "paper"] = "calibration",
    every: int = 1,
    context: int | None = None,
    reader: str | None = None,
    tracklets: bool = True,
    workers: int | None = None,
    cluster: str | None = None,
    force: bool = False,
    dogma: bool = False,
    particles: "DogmaParameters | None" = None,
    particle_forecast: list[str] | None = None,
    device: str = "cpu",
) -> None:
    """Turn LiDAR drives into label grids, evidence and, with --dogma, velocities on disk.

    Args:
        store: folder for the grids; finished drives in it are kept.
        source: folder with drives in KITTI raw's or KITTI odometry's layout, or with an envpred.yaml that says what
            they are; left out, velocities are made for the drives that the store holds.
        drives: names of the drives to map; by default all.
        grid: cells and resolution.
        ground: how ground is told from obstacles: MarkovRandomField or RansacPlane.
        rays: how obstacles become a label grid.
        evidence: what labels say, and how fast it fades.
        sensor: where the sensor sits: by the day's calibration, or as the paper's code takes it.
        every: map every so many scans alone: 2 makes 10 Hz of a drive of 20 Hz.
        context: cells of a wider grid that is mapped beside the one that is judged, and added to drives that lack it.
        reader: module.function of a reader of your own, in a file in the current folder; by default all are asked.
        tracklets: say which cells move, too, of drives with boxes of tracked objects (tracklet_labels.xml).
        workers: local processes; by default one a core.
        cluster: address of a Dask scheduler that works instead of local processes.
        force: build again what is there, also with other parameters.
        dogma: add velocities by the particle filter, also to drives that were mapped before.
        particles: numbers of the particle filter and thresholds on its velocities.
        particle_forecast: names of the drives that get the particle forecast too, or all; implies --dogma.
        device: where the particle filter runs, cpu or cuda.
    """
    if every < 1:
        raise UserError(f"--every {every}: give 1 for every scan, 2 for every second one, and so on")
    dogma = dogma or bool(particle_forecast)
    if dogma:
        with ends_at_once():
            from envpred.build.dogma import build_dogma, check_device
        if cluster is None:
            check_device(device)
    if source is not None:
        parameters = MappingParameters(grid, ground, rays, evidence, sensor, every)
        build(source, store, parameters, drives, workers, cluster, force, context, reader, tracklets)
    elif not dogma or context is not None:
        raise UserError("give the folder with the drives as --source; velocities alone (--dogma) need none")
    if dogma:
        build_dogma(store, particles, drives, particle_forecast, workers, cluster, force, device)


def verify(store: Path) -> None:
    """Read a store's grids and compare their checksums.

    Args:
        store: folder that `envpred grids` wrote.

    Raises:
        UserError: naming every damaged drive.
    """
    found = Store(store)
    failures = []
    for name, drive in found.drives.items():
        try:
            drive.verify()
            print(f"{name}: {len(drive.frames)} frames, good")
            for line in drive.warnings:
                print(f"warning: {line}")
        except UserError as error:
            failures.append(str(error))
    for name in found.unfinished():
        print(f"{name}: no drive of this store, as it has no {MANIFEST}")
    if failures:
        raise UserError("\n".join([*failures, f"{len(failures)} of {len(found.drives)} drives are damaged"]))
    print(f"{len(found.drives)} drives, all good")


def ground(source: Path, out: Path, drive: str | None = None, frame: int | None = None) -> None:
    """Draw one scan with the obstacles of both ground segmentations, and where they differ.

    Args:
        source: folder with drives.
        out: picture to write; its ending decides the format.
        drive: name of the drive; by default the first.
        frame: frame number; by default the drive's first.
    """
    from envpred.pictures import grids as pictures

    pictures.check_picture(out)
    chosen = one_drive(source, drive)
    points = chosen.scan(one_frame(chosen, frame))
    methods: dict[str, GroundSegmenter] = {"MRF": MarkovRandomField(), "RANSAC": RansacPlane()}
    reach, height = GridSpec().reach, chosen.sensor_height
    verdicts = {name: method.obstacles(points, reach, height) for name, method in methods.items()}
    print(pictures.save(pictures.ground_comparison(points, verdicts), out))


def show(store: Path, out: Path, drive: str | None = None, frame: int = 0, context: bool = False) -> None:
    """Draw a mapped drive: a label grid, its masses and probability as a picture, or the whole drive as a .gif.

    Args:
        store: folder that `envpred grids` wrote.
        out: picture (.png, .pdf) of one frame, or animation (.gif) of all.
        drive: name of the drive; by default the first.
        frame: position of the frame in the drive.
        context: draw the wider grid instead of the one that is judged.
    """
    from envpred.pictures import grids as pictures

    pictures.check_picture(out, or_animation=True)
    chosen = _stored_drive(store, drive, frame)
    labels, mass = (chosen.array(f"context_{name}" if context else name) for name in ("label", "evidence"))
    if out.suffix == ".gif":
        print(pictures.save(pictures.drive_animation(labels, mass, chosen.period), out))
    else:
        resolution, masses = chosen.manifest["lattice"]["resolution"], np.array(mass[frame], np.float32)
        print(pictures.save(pictures.mapping_overview(np.array(labels[frame]), masses, resolution), out))


def velocity(store: Path, out: Path, drive: str | None = None, frame: int = 0) -> None:
    """Draw the velocities of a drive over its label grids: one frame as a picture, or the whole drive as a .gif.

    Args:
        store: folder that `envpred grids --dogma` wrote.
        out: picture (.png, .pdf) of one frame, or animation (.gif) of all.
        drive: name of the drive; by default the first.
        frame: position of the frame in the drive.
    """
    from envpred.pictures import grids as pictures
    from envpred.pictures import velocities

    pictures.check_picture(out, or_animation=True)
    chosen = _stored_drive(store, drive, frame)
    if out.suffix == ".gif":
        print(pictures.save(velocities.of_drive(chosen), out))
    else:
        print(pictures.save(velocities.of_frame(chosen, frame), out))


def report(
    runs: list[Path],
    out: Path,
    source: Path | None = None,
    label: list[str] = [],  # noqa: B006 - read only, and the command line shows it
    circles: bool = True,
) -> None:
    """Compare test runs: tables, curves and one HTML page, from their results alone.

    Args:
        runs: result files, or folders that hold some, all of the same test windows; folders without any are skipped.
        out: folder for the report.
        source: folder with the drives, for the pictures of their camera.
        label: RUN=NAME calls the method of a run (its folder or file) NAME; may be given several times.
        circles: circle the ego and what moves in strips; false for none.
    """
    from envpred.cli.draw import camera_of
    from envpred.report import report as write_report

    print(write_report(runs, out, camera=lambda drive: camera_of(drive, source), labels=label, circles=circles))


def _stored_drive(store: Path, drive: str | None, frame: int) -> StoredDrive:
    """The drive of that name, by default the first, which must have a frame at that position."""
    drives = Store(store).drives
    if not drives or (drive is not None and drive not in drives):
        raise UserError(f"{store}: holds no drive {drive or ''}; it has {', '.join(drives) or 'none'}")
    chosen = drives[drive or next(iter(drives))]
    if not 0 <= frame < len(chosen.frames):
        raise UserError(f"--frame {frame}: {chosen.name} has {len(chosen.frames)} frames, counted from 0")
    return chosen


def draw(
    predictions: list[Path],
    out: Path,
    window: int = 0,
    store: Path | None = None,
    source: Path | None = None,
    horizons: list[float] | None = None,
    circles: bool = True,
) -> None:
    """Draw one window of predictions or test runs, several methods beside each other, as a strip or a .gif.

    Args:
        predictions: folders that `envpred predict` wrote, or of test runs, whose drawn windows are taken; others are
            skipped.
        out: picture (.png, .pdf) at some horizons, or animation (.gif) of all.
        window: place of the window among those of the first folder.
        store: folder of the grids that were forecast from: adds what was shown, and the targets where there are any.
        source: folder with the drives, for pictures of their camera.
        horizons: of the strip, in seconds; by default those of the paper, and the last.
        circles: circle the ego and what moves in a strip; false for none.
    """
    from envpred.cli.draw import draw as draw_window

    print(draw_window(predictions, out, window, store, source, horizons, circles))


def export_weights(run: Path, name: str, out: Path = Path("weights"), results: list[Path] | None = None) -> None:
    """Make weights that load by their folder from a run of `envpred fit`, with a card that tells of them.

    Args:
        run: folder that `envpred fit` wrote; its best checkpoint is taken.
        name: of the weights, and of their folder.
        out: folder of the weights' folder.
        results: test runs of these weights (`envpred test --weights OUT/NAME`) and of methods beside them, on any
            stores, for the card.
    """
    from envpred.cli.export import export as write_weights

    print("\n".join(write_weights(run, name, out, results or [])))

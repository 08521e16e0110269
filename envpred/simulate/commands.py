"""The simulator's commands, as functions: their arguments are the command line's."""

from pathlib import Path
from typing import Literal

from envpred.errors import UserError


def simulate(
    out: Path,
    drives: int | None = None,
    frames: int | None = None,
    preset: Literal["look", "train"] = "look",
    seed: int = 0,
    workers: int | None = None,
    recording: Path | None = None,
    beams: int = 64,
    mix: str = "default",
    swept: bool = False,
) -> None:
    """Write simulated drives with known truth in KITTI raw's layout.

    Args:
        out: folder that is not there yet, or is empty.
        drives: how many; by default the preset's.
        frames: scans of each, ten a second; by default the preset's.
        preset: look: 10 drives of 150 scans; train: 60 of 170, for weights that are to hold elsewhere.
        seed: of egos, times, scenery and noise; same seed, same drives.
        workers: local processes; by default one a core.
        recording: traffic recorded with SUMO; by default the one that comes with envpred.
        beams: of the scanner: 16, 32, 64 (KITTI's) or 128.
        mix: towns that drives lie in: default (all), towns (without open country), or a list such as rural=2,suburb=1.
        swept: whether the ego moves on while the sensor turns, as in scans that nobody has corrected.
    """
    from envpred.simulate.presets import PRESETS
    from envpred.simulate.run import simulate as write_drives

    named = PRESETS[preset]
    drives = named.drives if drives is None else drives
    write_drives(out, drives, named.frames if frames is None else frames, seed, workers, recording, beams, mix, swept)


def record(out: Path, seconds: float = 300.0, seed: int = 1) -> None:
    """Record traffic in SUMO for --recording of simulate (extra `sim`).

    Args:
        out: recording to write (.npz).
        seconds: of traffic in each town.
        seed: of streets and trips.
    """
    from envpred.simulate.record import record as run_sumo
    from envpred.store.files import check_place

    if out.exists():
        raise UserError(f"{out} is there already: give another name, or remove it")
    check_place(out)
    run_sumo(out, seconds, seed)
    print(out)


def realism(simulated: Path, real: Path) -> None:
    """Print what the mapping makes of simulated drives beside real ones.

    Args:
        simulated: folder with simulated drives.
        real: folder with real drives.
    """
    from envpred.simulate.realism import realism as table

    print(table(simulated, real))


def scan(source: Path, out: Path, drive: str | None = None, frame: int | None = None) -> None:
    """Draw a scan of a simulated drive, coloured by the true class of every point.

    Args:
        source: folder with simulated drives.
        out: picture to write; its ending decides the format.
        drive: name of the drive; by default the first.
        frame: frame number; by default the drive's first.
    """
    from envpred.drives import one_drive, one_frame
    from envpred.drives.kitti import KittiDrive
    from envpred.pictures import grids as pictures
    from envpred.simulate.pictures import scan_picture

    pictures.check_picture(out)
    chosen = one_drive(source, drive)
    if not isinstance(chosen, KittiDrive):
        raise UserError(f"{chosen.name}: no simulated drive; give a folder that `envpred simulate` wrote")
    print(pictures.save(scan_picture(chosen.folder, one_frame(chosen, frame)), out))


def traffic(out: Path, town: int = 0, second: float = 60.0, recording: Path | None = None) -> None:
    """Draw the recorded traffic of a town from above.

    Args:
        out: picture to write; its ending decides the format.
        town: number of the town in the recording, counted from 0.
        second: moment of the recording.
        recording: traffic recorded with SUMO; by default the one that comes with envpred.
    """
    from envpred.pictures import grids as pictures
    from envpred.simulate.pictures import traffic_picture
    from envpred.simulate.run import builtin_recording
    from envpred.simulate.traffic import Recording

    pictures.check_picture(out)
    found = Recording.load(recording or builtin_recording())
    if not 0 <= town < len(found.networks):
        raise UserError(f"--town {town}: the recording has {len(found.networks)} towns, counted from 0")
    if not 0 <= second <= found.seconds:
        raise UserError(f"--second {second:g}: the recording lasts {found.seconds:g} s")
    print(pictures.save(traffic_picture(found, town, second), out))

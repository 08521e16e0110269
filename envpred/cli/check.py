"""`envpred check`: what looks wrong about recordings, with a picture of each, and what mends it."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from envpred.build.check import Checked
from envpred.build.check import check as look_at
from envpred.build.check_motion import Driven
from envpred.drives import Drive, find_drives
from envpred.errors import UserError
from envpred.mapping.geometry import FloatArray
from envpred.pictures import grids as pictures
from envpred.pictures.check import check_picture


def check(source: Path, out: Path = Path("check"), drives: list[str] | None = None, reader: str | None = None) -> None:
    """Say what looks wrong about drives, draw a picture of each, and name what mends it; exit code 1 if anything does.

    Args:
        source: folder with drives.
        out: folder for the pictures, one a drive.
        drives: names of the drives to look at; by default all.
        reader: module.function of a reader of your own, in a file in the current folder; by default all are asked.

    Raises:
        UserError: if a drive is not there, or anything looks wrong.
    """
    found = {drive.name: drive for drive in find_drives(source, reader)}
    missing = [name for name in drives or () if name not in found]
    if missing:
        raise UserError(f"--drives: {source} has no drive {missing[0]}; it has {', '.join(found)}")
    chosen = [found[name] for name in drives or found]
    wrong = 0
    for drive in chosen:
        checked = look_at(drive)
        for finding in checked.findings:
            print(f"{drive.name}: {finding}")
        for note in checked.notes:
            print(f"{drive.name}: note: {note}")
        if not checked.findings:
            print(f"{drive.name}: {len(drive.frames)} frames, nothing looks wrong")
        if checked.points is not None:
            print(pictures.save(_picture(drive, checked), out / f"{drive.name}.png"))
        wrong += bool(checked.findings)
    if wrong:
        raise UserError(f"{wrong} of {len(chosen)} drives look wrong; what mends them is said above")


def _picture(drive: Drive, checked: Checked) -> Figure:
    assert checked.points is not None
    assert checked.ground is not None
    title = "\n".join([drive.name, *(finding.what for finding in checked.findings)])
    paths = None if checked.driven is None else _paths(checked.driven)
    return check_picture(checked.points, checked.ground.plane, drive.sensor_height, paths, title)


def _paths(seen: Driven) -> tuple[FloatArray, FloatArray]:
    """Places of the ego by scans and by poses, from above, in the frame of the first scan."""
    place, heading, places = np.zeros(2), 0.0, [np.zeros(2)]
    for x, y, yaw in seen.matched:
        c, s = np.cos(heading), np.sin(heading)
        place = place + np.array([c * x - s * y, s * x + c * y])
        heading += yaw
        places.append(place)
    first = np.linalg.inv(seen.poses[0])
    posed = (seen.poses[:, :3, 3] @ first[:3, :3].T + first[:3, 3]) @ seen.level.T
    return np.array(places), posed[:, :2]

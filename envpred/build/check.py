"""What looks wrong about a recording, and what mends it: found by its scans and poses alone, without any truth."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from envpred.build.check_bends import find_bends
from envpred.build.check_clock import find_clock
from envpred.build.check_ground import GroundFound, ground_of
from envpred.build.check_motion import Driven, compare_poses, driven, mend_axes, scans_and_poses
from envpred.build.findings import Finding, Settings
from envpred.drives import Drive
from envpred.drives.plausible import oddities
from envpred.errors import UserError

LOOKS = 8  # scans in which the ground is looked for


class Checked(NamedTuple):
    """What a look at a drive found.

    Args:
        findings: what looks wrong, each with its remedy.
        notes: what could not be looked at, and what nothing mends.
        points: (N, 4) of one scan for a picture, if any could be read.
        ground: the road in it.
        driven: a part of the path by scans and by poses, if both could be had.
    """

    findings: list[Finding]
    notes: list[str]
    points: NDArray[np.float32] | None = None
    ground: GroundFound | None = None
    driven: Driven | None = None


def check(drive: Drive) -> Checked:
    """Look at a drive: its ground, its axes, units, frames and clock, gaps, and the motion within its sweeps."""
    settings = Settings.of(drive)
    try:
        frames = drive.frames
        if not frames:
            raise UserError(f"{drive.name}: no frame has both a scan and a pose; check names, times and clocks of both")
        looked = frames[:: -(-len(frames) // LOOKS)]
        scans = [drive.scan(k) for k in looked]
        stretches, poses = drive.stretches(), drive.poses
    except UserError as error:
        return Checked([Finding("cannot be read", str(error), "")], [])
    ground, findings = ground_of(scans, drive.sensor_height, settings)
    notes = []
    seen = driven(drive, poses, ground)
    if seen is None:
        notes.append("the ego hardly moves, or too little stands around it: poses were not compared with scans")
    else:
        if not np.allclose(ground.level, np.eye(3)):
            findings = [findings[0]._replace(mend=mend_axes(*scans_and_poses(seen), settings))]
        clock, told = find_clock(seen, settings)
        findings += [*compare_poses(seen, settings, clocks_differ=bool(clock)), *clock]
        notes += told
        if not seen.turns:
            notes.append("the ego goes straight on: poses whose y and z point the other way would look the same")
        if findings:
            notes.append("motion within the sweep is looked for when the rest is mended")
        else:
            findings, told = find_bends(seen, drive, settings)
            notes += told
    findings += _gaps(drive, stretches)
    try:
        oddities(drive, drive.sensor_to_body())
    except UserError as error:
        if not findings:  # which say better what it comes from
            findings.append(Finding("cannot be", str(error), ""))
    return Checked(findings, notes, scans[ground.scan], ground, seen)


def _gaps(drive: Drive, stretches: list[tuple[int, int]]) -> list[Finding]:
    if len(stretches) < 2:
        return []
    breaks = [first for first, _ in stretches[1:]]
    times, frames = drive.times, drive.frames
    longest = max(breaks, key=lambda t: float(times[t] - times[t - 1]))
    return [
        Finding(
            "gaps",
            f"{len(breaks)} in {len(frames)} frames, the longest {times[longest] - times[longest - 1]:.3g} s after "
            f"frame {frames[longest - 1]}, where frames are {drive.period:.3g} s apart; grids start anew there",
            "copy the scans and poses that are missing, or mend their times; nothing else is needed",
        )
    ]

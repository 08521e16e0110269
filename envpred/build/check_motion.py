"""Poses against scans: what neighbouring scans say of the ego's motion is compared with what the poses say."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from envpred.build.check_ground import SQUARE, GroundFound
from envpred.build.findings import Finding, Settings
from envpred.drives import Drive
from envpred.drives.axes import WORLD, names_of
from envpred.mapping.geometry import FloatArray, GridSpec
from envpred.mapping.ground import MarkovRandomField
from envpred.mapping.scan_matching import anywhere, flat, match, target
from envpred.mapping.trajectory import motions

STEPS = 60  # scans in a row that are matched
REACH = GridSpec().reach
FEWEST_POINTS, FEWEST_STEPS = 100, 10
WORST_COST = 0.5  # metres of a match that is worth something
LEAST_STEP = 0.15  # metres between scans, below which a step says nothing
LEAST_TURN = 0.05  # radians between the headings farthest apart, below which turns say nothing
SCALES = (1.25, 0.8)  # by which poses may move more, or less, than scans say
USUAL_SCALES = (1000.0, 100.0, 10.0, 0.3048, 0.1, 0.01, 0.001)
CLEARER, SLIGHTLY = 0.2, 0.05  # of the best score there can be, by which another frame must fit better
DEGREE = 111_320.0  # metres, of a meridian
DEGREES = (0.9 / DEGREE, 2.9 / DEGREE)  # of longitude or latitude that a metre is, up to 70 degrees north
NED = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]], np.float64)  # its axes seen from east, north and up
FRAMES = (  # what poses are of where they are not of the scans' frame: forward, right, down; a camera
    np.diag([1.0, -1.0, -1.0]),
    np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], np.float64),
)


WRONG_AXES = "wrong axes"
OTHER_UNITS = "poses in other units"


class Driven(NamedTuple):
    """A part of a drive, by its scans and by its poses.

    Args:
        first: place of the first frame among the drive's.
        matched: (n, 3) steps x, y (metres) and yaw (radians) by the scans, in the levelled sensor frame.
        points: of each frame (N, 2) from above, as they were matched.
        times: (n + 1,) seconds of the frames.
        poses: (n + 1, 4, 4) of the sensor.
        path: times and sensor poses of the whole drive.
        level: (3, 3) from the sensor frame to the levelled one.
    """

    first: int
    matched: FloatArray
    points: list[FloatArray]
    times: FloatArray
    poses: FloatArray
    path: tuple[FloatArray, FloatArray]
    level: FloatArray

    @property
    def moving(self) -> NDArray[np.bool_]:
        """Which steps (n,) are long enough to say something."""
        return np.hypot(self.matched[:, 0], self.matched[:, 1]) > LEAST_STEP

    @property
    def turns(self) -> bool:
        """Whether the ego turns enough to tell left from right, and up from down, in its poses."""
        return float(np.ptp(np.cumsum(self.matched[:, 2]))) > LEAST_TURN


class Fit(NamedTuple):
    """How poses are best read.

    Args:
        turned: (3, 3) from their frame to that of the car.
        inverse: whether they lead from the world to the car.
        scale: metres of one of their units.
        score: of the agreement, of 2 at most, or 1 where the ego does not turn.
    """

    turned: FloatArray
    inverse: bool
    scale: float
    score: float


def driven(drive: Drive, poses: FloatArray, ground: GroundFound) -> Driven | None:
    """The liveliest part of a drive, matched scan by scan; None where the ego stands or too little is seen."""
    sensor = poses @ drive.sensor_to_body()
    first, length = _liveliest(sensor, drive.stretches())
    frames = drive.frames[first : first + length]
    points = [_standing_up(drive.scan(k), ground) for k in frames]
    if length < FEWEST_STEPS or min(map(len, points)) < FEWEST_POINTS:
        return None
    matched, costs, last = [], [], None
    posed = motions(sensor[first : first + length])
    for n in range(length - 1):
        onto = target(points[n])
        guess = np.array([*(ground.level @ posed[n, :3, 3])[:2], 0.0])
        last = anywhere(points[n + 1], onto) if last is None else last
        starts = [last, *([guess] if np.hypot(*guess[:2]) < 5 else [])]
        last, cost = match(points[n + 1], onto, np.array(starts))
        matched.append(last)
        costs.append(cost)
    part = slice(first, first + length)
    found = Driven(
        first, np.array(matched), points, drive.times[part], sensor[part], (drive.times, sensor), ground.level
    )
    return found if np.median(costs) < WORST_COST and found.moving.sum() >= FEWEST_STEPS else None


def _liveliest(poses: FloatArray, stretches: list[tuple[int, int]]) -> tuple[int, int]:
    """First frame and number of the at most `STEPS` frames in a row in which speed and heading change most."""
    best = (-1.0, 0, 1)
    for start, count in stretches:
        steps = motions(poses[start : start + count])
        lively = np.zeros(count)
        if count > 2:
            change = np.abs(np.diff(steps[:, :3, 3], axis=0)).sum(axis=1)
            turn = np.abs(np.diff(steps[:, :3, :3], axis=0)).sum(axis=(1, 2))
            size = max(float(np.abs(steps[:, :3, 3]).max()), 1e-9)
            lively[1:-1] = change / size + turn
        summed = np.concatenate([[0.0], np.cumsum(lively)])
        length = min(count, STEPS)
        for first in range(count - length + 1):
            best = max(best, (float(summed[first + length] - summed[first]) + length / STEPS, start + first, length))
    return best[1], best[2]


def _standing_up(points: NDArray[np.float32], ground: GroundFound) -> FloatArray:
    level = points.copy()
    level[:, :3] = points[:, :3] @ ground.level.T
    return flat(level[MarkovRandomField().obstacles(level, REACH, ground.height)].astype(np.float64))


def compare_poses(seen: Driven, settings: Settings, clocks_differ: bool) -> list[Finding]:
    """Axes of scans, frame and unit of poses: what looks wrong about them."""
    if _in_degrees(seen):
        how = "they move by as few units as degrees of longitude and latitude are in a metre"
        mend = "write them in metres, or give KITTI's packets with `poses: {format: oxts}`"
        return [Finding(OTHER_UNITS, how, mend)]
    to_car, heading = _to_car(seen)
    of_scans = to_car @ seen.level
    fit = fit_poses(seen, to_car, of_scans)
    findings = []
    if heading:
        side = ("", "y: x points to its right", "-x: x points backwards", "-y: x points to its left")[heading]
        how = f"neighbouring scans say that the car drives along {side}"
        findings.append(Finding(WRONG_AXES, how, mend_axes(of_scans, fit, settings)))
    if fit.inverse or not _own_frame(fit, of_scans) or _world_of(seen, fit) is not None:
        findings.append(_other_frame(seen, fit, settings))
    if not (is_usual(fit.scale) or (clocks_differ and may_be_clock(fit.scale))):
        how = f"they move {1 / fit.scale:.3g} times as far as neighbouring scans say"
        now = settings.folder.track.said.scale if settings.folder else 1.0
        mend = settings.write(f"poses: {{scale: {now * _rounded(fit.scale):.4g}}}")
        findings.append(Finding(OTHER_UNITS, how, mend))
    return findings


def mend_axes(of_scans: FloatArray, fit: Fit | None, settings: Settings) -> str:
    """The remedy for scans that are to be turned by `of_scans` (3, 3), and what it means for their poses."""
    text = f"scans: {{{settings.axes('scans', of_scans)}}}"
    if fit is not None and np.allclose(fit.turned, np.eye(3)) and not np.allclose(of_scans, np.eye(3)):
        text += f", poses: {{{settings.axes('poses', np.eye(3))}}}"
    return settings.write(text)


def scans_and_poses(seen: Driven) -> tuple[FloatArray, Fit]:
    """How scans are to be turned (3, 3), and how poses are best read."""
    of_scans = _to_car(seen)[0] @ seen.level
    return of_scans, fit_poses(seen, _to_car(seen)[0], of_scans)


def is_usual(scale: float) -> bool:
    """Whether poses of that many metres a unit may be in metres."""
    return 1 / SCALES[0] <= scale <= 1 / SCALES[1]


def may_be_clock(scale: float) -> bool:
    """Whether poses of that many metres a unit may be in metres, but of other moments than the scans."""
    return 0.5 < scale < 2


def _in_degrees(seen: Driven) -> bool:
    """Whether the places of poses are longitudes and latitudes, whatever their heights are in."""
    moved = np.linalg.norm(np.diff(seen.poses[:, :2, 3], axis=0), axis=1).sum()
    return bool(DEGREES[0] < moved / np.hypot(*seen.matched[:, :2].T).sum() < DEGREES[1])


def _rounded(scale: float) -> float:
    """The usual unit that is meant, or else what was found."""
    usual = min(USUAL_SCALES, key=lambda unit: abs(np.log(unit / scale)))
    return usual if abs(np.log(usual / scale)) < 0.1 else scale


def _is_unit(scale: float) -> bool:
    return _rounded(scale) in USUAL_SCALES


def _to_car(seen: Driven) -> tuple[FloatArray, int]:
    """The turn by right angles (3, 3) that makes the car drive forward in the levelled frame, and how many."""
    ahead = seen.matched[seen.moving, :2].sum(axis=0)
    heading = round(float(np.arctan2(ahead[1], ahead[0])) / (np.pi / 2)) % 4
    c, s = (1, 0, -1, 0)[heading], (0, 1, 0, -1)[heading]
    return np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]], np.float64), heading


def _own_frame(fit: Fit, of_scans: FloatArray) -> bool:
    """Whether poses are in the axes of the scans, or in those of the car."""
    return np.allclose(fit.turned, of_scans) or np.allclose(fit.turned, np.eye(3))


def fit_poses(seen: Driven, to_car: FloatArray, of_scans: FloatArray) -> Fit:
    """The frame and unit of poses in which they agree best with scans, of all by right angles, inverse or not.

    Args:
        seen: the part of the drive.
        to_car: (3, 3) from the levelled frame to the car's.
        of_scans: (3, 3) from the sensor frame to the car's; it is taken unless another is clearly better.
    """
    moving = seen.moving
    steps = np.column_stack([seen.matched[:, :2], np.zeros(len(seen.matched))])[moving] @ to_car.T
    turns = np.column_stack([np.zeros((len(seen.matched), 2)), seen.matched[:, 2]])
    found = []
    for inverse in (False, True):
        posed = motions(np.asarray(np.linalg.inv(seen.poses) if inverse else seen.poses, np.float64))
        shift, spin = posed[moving, :3, 3], spins(posed)
        length = np.linalg.norm(shift, axis=1)
        scale = float(np.linalg.norm(steps, axis=1).sum() / max(length.sum(), 1e-9))
        for turned in (of_scans, np.eye(3), *FRAMES, *SQUARE):
            both = ((scale * shift) ** 2).sum(axis=1) + (steps**2).sum(axis=1)
            alike = 2 * scale * (steps * (shift @ turned.T)).sum(axis=1) / np.maximum(both, 1e-9)  # 1 if they are equal
            score = float(np.median(alike))
            if seen.turns:
                size = np.sqrt((turns**2).sum() * (spin**2).sum())
                score += float((turns * (spin @ turned.T)).sum() / max(size, 1e-9))
            found.append(Fit(turned, inverse, scale, score))
    best = max(found, key=lambda fit: round(fit.score, 2))  # the first, which is the likeliest, of those alike
    likeliest = max(found[:2], key=lambda fit: fit.score)
    # A path in a unit that nobody uses is likelier read the wrong way.
    clearer = (
        CLEARER if is_usual(likeliest.scale) or not is_usual(best.scale) or _is_unit(likeliest.scale) else SLIGHTLY
    )
    return best if best.score > likeliest.score + clearer * (2 if seen.turns else 1) else likeliest


def spins(posed: FloatArray) -> FloatArray:
    """Small rotations (n, 3) of motions (n, 4, 4), as vectors in radians."""
    skew = (posed[:, :3, :3] - posed[:, :3, :3].transpose(0, 2, 1)) / 2
    return np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)


def _other_frame(seen: Driven, fit: Fit, settings: Settings) -> Finding:
    text = []
    if not _own_frame(fit, _to_car(seen)[0] @ seen.level):
        text.append(settings.axes("poses", fit.turned))
    world = _world_of(seen, fit)
    if world is not None:
        text.append(world)
    if fit.inverse:
        text.append("inverse: true")
    what = "they move and turn along other axes than the scans" if text[0].startswith("axes") else "its z is not up"
    if fit.inverse:
        what = "they lead from the world to the car"
    return Finding("poses in another frame", what, settings.write(f"poses: {{{', '.join(text)}}}"))


def _world_of(seen: Driven, fit: Fit) -> str | None:
    """How the settings name the axes of the poses' world, unless its z points up."""
    poses = np.linalg.inv(seen.poses) if fit.inverse else seen.poses
    up = (poses[:, :3, :3] @ fit.turned.T @ [0, 0, 1]).mean(axis=0)
    k = int(np.argmax(np.abs(up)))
    if k == 2 and up[2] > 0:
        return None
    able = [turned for turned in (NED, fit.turned, *SQUARE) if (turned @ up)[2] > 0.7 * np.linalg.norm(up)]
    return f"world: {names_of(able[0], WORLD)}"

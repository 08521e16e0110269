"""One drive's world: what stands, who moves, and the vehicle whose eyes we see it with."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from embreex.rtcore import EmbreeDevice

from envpred.simulate import classes, models
from envpred.simulate.clutter import Clutter
from envpred.simulate.ego import EgoMotion, drive_over
from envpred.simulate.layout import STYLES, Layout, Parked, Style
from envpred.simulate.mesh import FloatArray, Mesh, join
from envpred.simulate.rays import Target
from envpred.simulate.terrain import Terrain
from envpred.simulate.traffic import KINDS, Motion, Recording

STILL = 0.3  # m/s: what is slower is labelled as standing
_RANGE = 85.0  # metres around the ego within which others are put into the scene
_TRIES = 48  # stretches of traffic to choose an ego from
_STRIDE = 0.75  # metres a walker moves in half a stride


@dataclass(frozen=True)
class Actor:
    """A road user: `instance` is its number in the labels, `offset` the drive's first frame in its motion."""

    motion: Motion
    offset: int
    instance: int
    light: bool

    def at(self, frame: int) -> int | None:
        """Index into the motion at a frame of the drive; None while it is not there."""
        k = frame + self.offset
        return k if 0 <= k < len(self.motion.heading) else None


@dataclass(frozen=True)
class Box:
    """A labelled object at one moment: its instance, class, size (length, width, height) and place on the ground."""

    instance: int
    label: int
    size: tuple[float, float, float]
    place: FloatArray  # (3,) world, metres
    heading: float


@dataclass(frozen=True)
class Scene:
    """Everything a drive's scans are cast into."""

    town: str
    frames: int
    ego: EgoMotion
    terrain: Terrain
    still: Mesh
    parked: list[Parked]  # instances 1, 2, ...
    actors: list[Actor]
    clutter: Clutter

    def targets(self) -> tuple[Target, EmbreeDevice]:
        """The standing part, ready for rays, and the device for the moving part."""
        device = EmbreeDevice()
        return Target(self.still, device), device

    def near(self, frame: int) -> list[tuple[Actor, int]]:
        """Actors in reach of the sensor at a frame, with the index into their motions."""
        eye = self.ego.pose[frame, :2, 3]
        found = []
        for actor in self.actors:
            k = actor.at(frame)
            if k is not None and np.abs(actor.motion.centre[k] - eye).max() < _RANGE:
                found.append((actor, k))
        return found

    def moving(self, frame: int) -> Mesh | None:
        """All actors in reach at a frame as one mesh; None if there are none."""
        parts = []
        for actor, k in self.near(frame):
            motion = actor.motion
            walked = int(motion.speed[: k + 1].sum() / 10 / _STRIDE)
            body = models.road_user(motion.kind, motion.length, motion.width, actor.light, walked)
            body = body.labelled(models.class_of(motion.kind, bool(motion.speed[k] > STILL)))
            x, y = motion.centre[k]
            parts.append(body.at(x, y, self._footing(motion.centre[k]), motion.heading[k], actor.instance))
        return join(parts) if parts else None

    def boxes(self, frame: int) -> list[Box]:
        """The boxes of all objects in reach at a frame, parked ones too."""
        boxes, places = self._parked_boxes
        away = np.hypot(*(places - self.ego.pose[frame, :2, 3]).T)
        boxes = [boxes[k] for k in np.flatnonzero(away < _RANGE)]
        for actor, k in self.near(frame):
            m = actor.motion
            place = np.array([*m.centre[k], self._footing(m.centre[k])])
            label = models.class_of(m.kind, bool(m.speed[k] > STILL))
            boxes.append(Box(actor.instance, label, models.size_of(m.kind, m.length, m.width), place, m.heading[k]))
        return boxes

    @cached_property
    def _parked_boxes(self) -> tuple[list[Box], FloatArray]:
        places = np.array([thing.place for thing in self.parked]).reshape(-1, 2)
        boxes = []
        for number, (thing, place) in enumerate(zip(self.parked, places, strict=True), 1):
            label, size = _parked_box(thing)
            boxes.append(Box(number, label, size, np.array([*place, self._footing(place)]), thing.heading))
        return boxes, places

    def _footing(self, place: FloatArray) -> float:
        return float(self.terrain.height(place))


def build(
    recording: Recording, network: int, motions: list[Motion], frames: int, pace: float, rng: np.random.Generator
) -> Scene:
    """A drive of `frames` scans through a network at a mean speed near `pace` (m/s), and a town built around it.

    Raises:
        ValueError: if no car of the recording is there for so many frames (see `Network.longest`).
    """
    town = recording.networks[network].name
    ego_track, first = _choose(motions, frames, pace, rng, town)
    motion = motions[ego_track]
    path = motion.centre[first : first + frames]
    slope = float(rng.uniform(0.005, 0.05))
    terrain = Terrain(recording.networks[network], path, slope, rng)
    layout = Layout(terrain, STYLES.get(town, Style()), rng)
    layout.furnish(recording.networks[network])
    ego = drive_over(motion, terrain, first, frames, rng)

    parts = [terrain.mesh(), *layout.things]
    for number, thing in enumerate(layout.parked, 1):
        z = float(terrain.height(np.array(thing.place)))
        parts.append(thing.model().at(*thing.place, z, thing.heading, number))
    start = motion.first + first
    others = [
        m
        for k, m in enumerate(motions)
        if k != ego_track and m.first < start + frames and m.first + len(m.speed) > start
    ]
    light = rng.random(len(others)) < 0.5
    actors = [
        Actor(m, start - m.first, len(layout.parked) + 1 + k, bool(light[k]))
        for k, m in enumerate(others)
        if _reaches(m, path)
    ]
    return Scene(town, frames, ego, terrain, join(parts), layout.parked, actors, Clutter.draw(rng))


def _choose(motions: list[Motion], frames: int, pace: float, rng: np.random.Generator, town: str) -> tuple[int, int]:
    """A car and the frame it becomes the ego at.

    Of some stretches drawn at random the one is taken whose mean speed is next to `pace`: drives are to be slow and
    fast alike, although most of SUMO's cars move at the limit or wait at a light.
    """
    room = np.array([len(m.speed) - frames if KINDS[m.kind] == "car" else -1 for m in motions])
    able = np.flatnonzero(room >= 0)
    if not len(able):
        raise ValueError(f"no car of {town} drives for {frames} frames")
    best = (np.inf, 0, 0)
    for track in rng.choice(able, _TRIES, p=(room[able] + 1) / (room[able] + 1).sum()):
        first = int(rng.integers(0, room[track] + 1))
        speed = float(motions[track].speed[first : first + frames].mean())
        best = min(best, (abs(speed - pace), int(track), first))
    return best[1], best[2]


def _reaches(motion: Motion, path: FloatArray) -> bool:
    low, high = path.min(axis=0) - _RANGE, path.max(axis=0) + _RANGE
    return bool(((motion.centre > low) & (motion.centre < high)).all(axis=1).any())


def _parked_box(thing: Parked) -> tuple[int, tuple[float, float, float]]:
    if thing.kind == "parked_bicycle":
        return classes.BICYCLE, (1.75, 0.56, 1.04)
    kind = KINDS.index(thing.kind)
    return models.class_of(kind, False), models.size_of(kind, thing.length, thing.width)

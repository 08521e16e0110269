"""What a user writes about a recording of their own: `envpred.yaml` in a drive's folder."""

from typing import Annotated, Literal

from msgspec import Meta, Struct, field

from envpred.gate.stores import CarBody
from envpred.gate.types import Cells, Key, Length, Line, Number, Place, Positive

Direction = Literal["forward", "backward", "left", "right", "up", "down"]
WorldDirection = Literal["east", "west", "north", "south", "up", "down"]
Unit = Literal["s", "ms", "us", "ns"]
Vector = tuple[Number, Number, Number]


class Scans(Struct, forbid_unknown_fields=True):
    """Where scans lie, and what their columns and axes are.

    Args:
        folder: with one `.bin`, `.npy`, `.pcd` or `.ply` file a scan, seen from that of the YAML.
        columns: names of the columns of `.bin` and `.npy`; without it x, y, z and intensity.
        intensity: name of the column with reflectances; without it the usual names are looked for.
        time: name of the column with the points' times; without it the usual names are looked for.
        axes: where x, y and z point, seen from the car.
        scale: metres of one unit.
    """

    folder: Place = "scans"
    columns: Annotated[list[Key], Meta(min_length=3, max_length=64)] | None = None
    intensity: Line | None = None
    time: Line | None = None
    axes: tuple[Direction, Direction, Direction] = ("forward", "left", "up")
    scale: Positive = 1.0

    def __post_init__(self) -> None:
        if self.columns is not None:
            if lacking := [axis for axis in "xyz" if axis not in self.columns]:
                raise ValueError(f"columns name no {lacking[0]}")
            if len(set(self.columns)) < len(self.columns):
                raise ValueError("columns name one twice")


class Times(Struct, forbid_unknown_fields=True):
    """When scans were taken: one of a file, their names, or a period.

    Args:
        file: with a line a scan: a number, or a date and time.
        names: whether the names of the scans are their times.
        period: seconds between two scans.
        unit: of numbers in the file or the names.
    """

    file: Place | None = None
    names: bool = False
    period: Length | None = None
    unit: Unit = "s"

    def __post_init__(self) -> None:
        if (self.file is not None) + self.names + (self.period is not None) != 1:
            raise ValueError("give one of file, names: true and period")


class Poses(Struct, forbid_unknown_fields=True):
    """Where the car was.

    Args:
        format: `kitti` (12 numbers a line), `matrix` (16), `tum` (time, place, quaternion), `oxts` (a folder of KITTI's
            packets), or `kiss-icp`, which estimates them from the scans.
        file: of the poses, or their folder.
        of: whose poses they are.
        axes: where x, y and z of what they are of point, seen from the car; without it as those of the scans.
        world: where x, y and z of the world point.
        scale: metres of one unit.
        times: file with the time of each line, where poses and scans are not taken together.
        unit: of the numbers in `times`, and of TUM's.
        clock: seconds to add to the poses' times to have those of the scans' clock.
        inverse: whether they lead from the world to the car.
    """

    format: Literal["kitti", "matrix", "tum", "oxts", "kiss-icp"]
    file: Place | None = None
    of: Literal["sensor", "body"] | None = None
    axes: tuple[Direction, Direction, Direction] | None = None
    world: tuple[WorldDirection, WorldDirection, WorldDirection] = ("east", "north", "up")
    scale: Positive = 1.0
    times: Place | None = None
    unit: Unit = "s"
    clock: Annotated[float, Meta(ge=-1e10, le=1e10)] = 0.0
    inverse: bool = False

    def __post_init__(self) -> None:
        if (self.file is None) != (self.format == "kiss-icp"):
            raise ValueError("poses that are read need their file, and those that are estimated (kiss-icp) have none")


class Sensor(Struct, forbid_unknown_fields=True):
    """Where the sensor sits.

    Args:
        height: above the road, metres.
        place: x (forward), y (left) and z (up) in the frame of the body that poses are of, metres.
        angles: roll, pitch and yaw of the mounting in degrees: Rz(yaw) Ry(pitch) Rx(roll).
    """

    height: Annotated[float, Meta(gt=0, le=10)]
    place: Vector = (0.0, 0.0, 0.0)
    angles: tuple[Number, Number, Number] = (0.0, 0.0, 0.0)


class Grid(Struct, forbid_unknown_fields=True):
    """The grid to map on: cells along a side, and the side of a cell in metres."""

    cells: Cells = 128
    resolution: Length = 1 / 3


class Deskew(Struct, forbid_unknown_fields=True):
    """How the ego's motion within a sweep is taken out.

    Args:
        by: the points' `time`, or their `azimuth`.
        unit: of the points' times.
        turn: the way that the scanner turns, seen from above; for `azimuth`.
        start: azimuth at which a sweep begins, degrees counter-clockwise from ahead; for `azimuth`.
        stamp: the moment of a sweep that the scan's time and pose are of.
    """

    by: Literal["time", "azimuth"]
    unit: Unit = "s"
    turn: Literal["clockwise", "counterclockwise"] = "clockwise"
    start: Annotated[float, Meta(ge=-360, le=360)] = 180.0
    stamp: Literal["start", "middle", "end"] = "start"


class Recording(Struct, forbid_unknown_fields=True):
    """`envpred.yaml`: one drive."""

    sensor: Sensor
    scans: Scans = field(default_factory=Scans)
    poses: Poses | None = None
    times: Times | None = None
    body: CarBody | None = None
    grid: Grid | None = None
    context: Cells | None = None
    deskew: Deskew | None = None

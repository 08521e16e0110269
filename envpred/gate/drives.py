"""What comes with recordings beside scans and poses."""

from typing import Annotated

from msgspec import Meta, Struct, field

from envpred.gate.types import Count, Line

Coordinate = Annotated[float, Meta(ge=-1000, le=1000)]  # metres from the sensor, which also keeps out what is none
Side = Annotated[float, Meta(gt=0, le=100)]  # of a box, metres
Angle = Annotated[float, Meta(ge=-10, le=10)]  # radians


class BoxPose(Struct):
    """Where the middle of a box's base is, which way the box looks, and how much of it is hidden."""

    x: Coordinate = field(name="tx")
    y: Coordinate = field(name="ty")
    z: Coordinate = field(name="tz")
    heading: Angle = field(name="rz")
    occlusion: int = -1


class BoxTrack(Struct):
    """An object: class and size of its box, and poses from its first frame on."""

    kind: Line = field(name="objectType")
    height: Side = field(name="h")
    width: Side = field(name="w")
    length: Side = field(name="l")
    first_frame: Count
    poses: list[BoxPose]


class BoxTracks(Struct):
    """`tracklet_labels.xml`."""

    count: Count
    items: list[BoxTrack]

    def __post_init__(self) -> None:
        if self.count != len(self.items):
            raise ValueError(f"holds {len(self.items)} objects where {self.count} are counted")

"""KITTI's boxes of tracked objects: `tracklet_labels.xml`, a Boost archive of one list of poses an object.

pykitti reads none.  KITTI's people drew boxes where the camera looks, not all around (Geiger et al. 2013).
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from envpred.gate import conform, read_xml
from envpred.gate.drives import BoxTracks

TRACKLETS = "tracklet_labels.xml"
VISIBLE, HIDDEN = 0, 2  # states of occlusion: -1 is not told, 1 partly
_AGAIN = "unpack it again, or delete it to go without boxes"


@dataclass
class Tracklet:
    """One object's box: its class, its size, and from frame number `first` on a pose a frame.

    Args:
        kind: KITTI's name of its class: Car, Van, Truck, Pedestrian, Person (sitting), Cyclist, Tram, Misc.
        size: length, width, height in metres.
        first: number of its first frame.
        poses: x, y, z of the middle of its base in metres, and its heading in radians, in the sensor frame.
        occlusion: how much of it is hidden in each frame: VISIBLE, 1 partly, HIDDEN, -1 where that is not told.
    """

    kind: str
    size: tuple[float, float, float]
    first: int
    poses: list[tuple[float, float, float, float]] = field(default_factory=list)
    occlusion: list[int] = field(default_factory=list)

    @property
    def frames(self) -> range:
        """Numbers of its frames."""
        return range(self.first, self.first + len(self.poses))

    def contains(self, frame: int, points: NDArray[np.floating], margin: float = 0.0) -> NDArray[np.bool_]:
        """Which of the `points` (N, >=3) of a frame lie in the box made `margin` metres larger on all sides."""
        x, y, z, yaw = self.poses[frame - self.first]
        away = points[:, :3] - np.array([x, y, z])
        c, s = np.cos(yaw), np.sin(yaw)
        along, across = c * away[:, 0] + s * away[:, 1], c * away[:, 1] - s * away[:, 0]
        length, width, height = self.size
        inside: NDArray[np.bool_] = (np.abs(along) < length / 2 + margin) & (np.abs(across) < width / 2 + margin)
        inside &= (away[:, 2] > -margin) & (away[:, 2] < height + margin)
        return inside


def read_tracklets(file: Path) -> list[Tracklet]:
    """The tracklets of a drive.

    Raises:
        UserError: if the file is no XML, or a box has no class, size, first frame or poses that can be those of one.
    """
    archive = read_xml(file, _AGAIN).find("tracklets")
    told = {} if archive is None else _texts(archive) | {"items": [_plain(item) for item in archive.iterfind("item")]}
    return [
        Tracklet(
            track.kind,
            (track.length, track.width, track.height),
            track.first_frame,
            [(pose.x, pose.y, pose.z, pose.heading) for pose in track.poses],
            [pose.occlusion for pose in track.poses],
        )
        for track in conform(told, BoxTracks, file, _AGAIN, strict=False).items
    ]


def _plain(item: Element) -> dict[str, Any]:
    """An object as texts by the names of its fields, and likewise each of its poses."""
    return _texts(item) | {"poses": [_texts(pose) for pose in item.iterfind("poses/item")]}


def _texts(element: Element) -> dict[str, Any]:
    return {child.tag: (child.text or "").strip() for child in element}

"""Writes and reads `tracklet_labels.xml`, KITTI's boxes of objects in the sensor frame, one list of poses an object."""

from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from envpred.simulate import classes

FloatArray = NDArray[np.float64]

_TYPE = {
    classes.CAR: "Car",
    classes.TRUCK: "Truck",
    classes.PERSON: "Pedestrian",
    classes.BICYCLIST: "Cyclist",
    classes.BICYCLE: "Misc",
}
_TYPE |= {moving: _TYPE[still] for still, moving in classes.MOVING_OF.items() if still in _TYPE}


@dataclass
class Tracklet:
    """One object's size, and from frame `first` on its poses x, y, z (of the base), yaw in the sensor frame; metres."""

    kind: str
    size: tuple[float, float, float]  # length, width, height
    first: int
    poses: list[tuple[float, float, float, float]] = field(default_factory=list)
    points: list[int] = field(default_factory=list)  # returns from it, frame by frame

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


def kind_of(label: int) -> str:
    """KITTI's name of an object of a SemanticKITTI class."""
    return _TYPE[label]


def trim(tracklet: Tracklet) -> Tracklet | None:
    """A tracklet without the frames before its first and after its last return; None if it has no return at all."""
    seen = np.flatnonzero(tracklet.points)
    if not len(seen):
        return None
    a, b = int(seen[0]), int(seen[-1]) + 1
    return Tracklet(tracklet.kind, tracklet.size, tracklet.first + a, tracklet.poses[a:b], tracklet.points[a:b])


_HEAD = """<?xml version="1.0" encoding="UTF-8" standalone="yes" ?>
<!DOCTYPE boost_serialization>
<boost_serialization signature="serialization::archive" version="9">
<tracklets class_id="0" tracking_level="0" version="0">
\t<count>{}</count>
\t<item_version>1</item_version>
"""
_TAIL = "</tracklets>\n</boost_serialization>\n"
_OBJECT = """\t<item{}>
\t\t<objectType>{}</objectType>
\t\t<h>{:.3f}</h>
\t\t<w>{:.3f}</w>
\t\t<l>{:.3f}</l>
\t\t<first_frame>{}</first_frame>
\t\t<poses{}>
\t\t\t<count>{}</count>
\t\t\t<item_version>2</item_version>
"""
_POSE = """\t\t\t<item{}>
\t\t\t\t<tx>{:.4f}</tx>
\t\t\t\t<ty>{:.4f}</ty>
\t\t\t\t<tz>{:.4f}</tz>
\t\t\t\t<rx>0</rx>
\t\t\t\t<ry>0</ry>
\t\t\t\t<rz>{:.5f}</rz>
\t\t\t\t<state>2</state>
\t\t\t\t<occlusion>{}</occlusion>
\t\t\t\t<occlusion_kf>0</occlusion_kf>
\t\t\t\t<truncation>-1</truncation>
\t\t\t\t<amt_occlusion>-1</amt_occlusion>
\t\t\t\t<amt_occlusion_kf>-1</amt_occlusion_kf>
\t\t\t\t<amt_border_l>-1</amt_border_l>
\t\t\t\t<amt_border_r>-1</amt_border_r>
\t\t\t\t<amt_border_kf>-1</amt_border_kf>
\t\t\t</item>
"""


def write(path: Path, tracklets: list[Tracklet]) -> None:
    """Writes the boost archive that KITTI's tools parse; a box without a return is "fully occluded" (2)."""
    with path.open("w", encoding="utf-8") as out:
        out.write(_HEAD.format(len(tracklets)))
        for k, t in enumerate(tracklets):
            archive = [
                f' class_id="{n}" tracking_level="0" version="{v}"' if k == 0 else "" for n, v in ((1, 1), (2, 0))
            ]
            length, width, height = t.size
            out.write(_OBJECT.format(archive[0], t.kind, height, width, length, t.first, archive[1], len(t.poses)))
            for j, (pose, returns) in enumerate(zip(t.poses, t.points, strict=True)):
                once = ' class_id="3" tracking_level="0" version="2"' if k == j == 0 else ""
                out.write(_POSE.format(once, *pose, 0 if returns else 2))
            out.write("\t\t</poses>\n\t\t<finished>1</finished>\n\t</item>\n")
        out.write(_TAIL)


def read(path: Path) -> list[Tracklet]:
    """The tracklets of a drive, KITTI's or ours (`points` then says 1 where a box is not marked as hidden)."""
    tracklets = []
    for item in ET.parse(path).getroot().iterfind("tracklets/item"):
        size = tuple(float(item.findtext(tag, "nan")) for tag in "lwh")
        poses, points = [], []
        for pose in item.iterfind("poses/item"):
            x, y, z, yaw = (float(pose.findtext(tag, "nan")) for tag in ("tx", "ty", "tz", "rz"))
            poses.append((x, y, z, yaw))
            points.append(int(pose.findtext("occlusion", "-1") != "2"))
        tracklets.append(
            Tracklet(
                item.findtext("objectType", ""),
                (size[0], size[1], size[2]),
                int(item.findtext("first_frame", "0")),
                poses,
                points,
            )
        )
    return tracklets

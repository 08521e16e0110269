"""Writes `tracklet_labels.xml`, KITTI's boxes of objects in the sensor frame, one list of poses an object."""

from pathlib import Path

import numpy as np

from envpred.drives.tracklets import HIDDEN, Tracklet
from envpred.simulate import classes

_TYPE = {
    classes.CAR: "Car",
    classes.TRUCK: "Truck",
    classes.PERSON: "Pedestrian",
    classes.BICYCLIST: "Cyclist",
    classes.BICYCLE: "Misc",
}
_TYPE |= {moving: _TYPE[still] for still, moving in classes.MOVING_OF.items() if still in _TYPE}


def kind_of(label: int) -> str:
    """KITTI's name of an object of a SemanticKITTI class."""
    return _TYPE[label]


def trim(tracklet: Tracklet) -> Tracklet | None:
    """A tracklet without the frames before its first and after its last return; None if it has no return at all."""
    seen = np.flatnonzero(np.array(tracklet.occlusion) != HIDDEN)
    if not len(seen):
        return None
    a, b = int(seen[0]), int(seen[-1]) + 1
    return Tracklet(tracklet.kind, tracklet.size, tracklet.first + a, tracklet.poses[a:b], tracklet.occlusion[a:b])


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
    """Writes the boost archive that KITTI's tools parse."""
    with path.open("w", encoding="utf-8") as out:
        out.write(_HEAD.format(len(tracklets)))
        for k, t in enumerate(tracklets):
            archive = [
                f' class_id="{n}" tracking_level="0" version="{v}"' if k == 0 else "" for n, v in ((1, 1), (2, 0))
            ]
            length, width, height = t.size
            out.write(_OBJECT.format(archive[0], t.kind, height, width, length, t.first, archive[1], len(t.poses)))
            for j, (pose, occlusion) in enumerate(zip(t.poses, t.occlusion, strict=True)):
                once = ' class_id="3" tracking_level="0" version="2"' if k == j == 0 else ""
                out.write(_POSE.format(once, *pose, occlusion))
            out.write("\t\t</poses>\n\t\t<finished>1</finished>\n\t</item>\n")
        out.write(_TAIL)

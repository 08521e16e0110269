"""KITTI's boxes of tracked objects: read as they were written, or refused in a line."""

from pathlib import Path

import numpy as np
import pytest

from envpred.build.every import thinned
from envpred.drives import find_drives
from envpred.drives.tracklets import HIDDEN, TRACKLETS, VISIBLE, Tracklet, read_tracklets
from envpred.errors import UserError
from envpred.simulate.tracklets import trim, write
from tests.drives.synthetic import write_drive

CAR = Tracklet("Car", (4.2, 1.7, 1.5), 3, [(10.0, -2.0, -1.7, 0.5), (10.5, -2.0, -1.7, 0.25)], [VISIBLE, HIDDEN])
PERSON = Tracklet("Pedestrian", (0.5, 0.6, 1.8), 0, [(-4.0, 1.0, -1.7, -3.125)], [VISIBLE])
# An object as KITTI's own files have it.
KITTI = """<?xml version="1.0" encoding="UTF-8" standalone="yes" ?>
<!DOCTYPE boost_serialization>
<boost_serialization signature="serialization::archive" version="9">
<tracklets class_id="0" tracking_level="0" version="0">
	<count>1</count>
	<item_version>1</item_version>
	<item class_id="1" tracking_level="0" version="1">
		<objectType>Van</objectType>
		<h>2.0e+0</h>
		<w>1.5</w>
		<l>4.5</l>
		<first_frame>7</first_frame>
		<poses class_id="2" tracking_level="0" version="0">
			<count>1</count>
			<item_version>2</item_version>
			<item class_id="3" tracking_level="0" version="2">
				<tx>9.25</tx><ty>-3</ty><tz>-1.5</tz>
				<rx>0</rx><ry>0</ry><rz>1.5</rz>
				<state>2</state>
				<occlusion>-1</occlusion><occlusion_kf>0</occlusion_kf>
				<truncation>-1</truncation>
			</item>
		</poses>
		<finished>1</finished>
	</item>
</tracklets>
</boost_serialization>
"""
BOMB = KITTI.replace(
    "<!DOCTYPE boost_serialization>",
    '<!DOCTYPE b [<!ENTITY a0 "Van">' + "".join(f'<!ENTITY a{n} "{f"&a{n - 1};" * 10}">' for n in range(1, 10)) + "]>",
).replace(">Van<", ">&a9;<")


def test_what_is_written_is_read(tmp_path: Path) -> None:
    write(tmp_path / "a.xml", [CAR, PERSON])
    assert read_tracklets(tmp_path / "a.xml") == [CAR, PERSON]
    write(tmp_path / "a.xml", [])
    assert read_tracklets(tmp_path / "a.xml") == []


def test_a_file_of_kitti_is_read(tmp_path: Path) -> None:
    (tmp_path / "a.xml").write_text(KITTI)
    (van,) = read_tracklets(tmp_path / "a.xml")
    assert van == Tracklet("Van", (4.5, 1.5, 2.0), 7, [(9.25, -3.0, -1.5, 1.5)], [-1])
    assert list(van.frames) == [7]


def test_what_is_hidden_before_and_after_is_left_out() -> None:
    poses = [(float(k), 0.0, 0.0, 0.0) for k in range(5)]
    kept = trim(Tracklet("Car", (4.0, 2.0, 1.5), 10, poses, [HIDDEN, VISIBLE, HIDDEN, VISIBLE, HIDDEN]))
    assert kept == Tracklet("Car", (4.0, 2.0, 1.5), 11, poses[1:4], [VISIBLE, HIDDEN, VISIBLE])
    assert trim(Tracklet("Car", (4.0, 2.0, 1.5), 10, poses, [HIDDEN] * 5)) is None


def test_points_in_a_box_that_is_turned() -> None:
    """A box of 4 by 2 by 1 metres around (10, 0), turned by a right angle."""
    box = Tracklet("Car", (4.0, 2.0, 1.0), 0, [(10.0, 0.0, -1.0, np.pi / 2)], [VISIBLE])
    points = np.array(
        [[10, 1.9, -0.5], [10, 2.1, -0.5], [11.1, 0, -0.5], [10, 0, 0.1], [10, 0, -1.1], [9.1, -1.9, -0.9]]
    )
    assert box.contains(0, points).tolist() == [True, False, False, False, False, True]
    assert box.contains(0, points, margin=0.2).all()


def test_a_drive_has_them_or_not(tmp_path: Path) -> None:
    folder = write_drive(tmp_path, frames=4, azimuths=8)
    (drive,) = find_drives(tmp_path)
    for same in (drive, thinned(drive, 2)):
        assert not same.has_tracklets
        assert same.tracklets() == []
    write(folder / TRACKLETS, [CAR])
    for same in (drive, thinned(drive, 2)):
        assert same.has_tracklets
        assert same.tracklets() == [CAR]


DAMAGED = {
    "": "cannot be read as XML",
    KITTI[:-30]: "cannot be read as XML",
    BOMB: r"cannot be read as XML \(limit on input amplification factor",
    KITTI.replace("UTF-8", "none-such"): "cannot be read as XML",
    KITTI.replace("-3", "&outside;"): "cannot be read as XML",
    "<a/>": "Object missing required field count",
    KITTI.replace("<count>1<", "<count>2<", 1): "holds 1 objects where 2 are counted",
    KITTI.replace("<l>4.5</l>", ""): r"items\[0\]: .*missing required field l",
    KITTI.replace("4.5", "-4.5"): r"items\[0\]\.l: ",
    KITTI.replace("9.25", "far"): r"items\[0\]\.poses\[0\]\.tx: ",
    KITTI.replace("9.25", "nan"): r"items\[0\]\.poses\[0\]\.tx: ",
    KITTI.replace("9.25", "1e999"): r"items\[0\]\.poses\[0\]\.tx: ",
    KITTI.replace(">7<", ">-7<"): r"items\[0\]\.first_frame: ",
}


@pytest.mark.parametrize("text", DAMAGED, ids=list(DAMAGED.values()))
def test_damage_is_one_line(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.xml").write_text(text)
    with pytest.raises(UserError, match=rf"a\.xml: {DAMAGED[text]}.*; unpack it again, or delete it") as refusal:
        read_tracklets(tmp_path / "a.xml")
    assert str(refusal.value).isprintable()

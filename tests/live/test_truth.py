"""Boxes beside scans come with recordings of any reader, not with KITTI's alone."""

from pathlib import Path

import numpy as np
import pytest

from envpred.cli import main
from envpred.drives import Drive, find_drives, one_drive
from envpred.drives.folder import FolderDrive
from envpred.drives.tracklets import Tracklet
from envpred.live.truth import Truth
from tests.drives import own, synthetic
from tests.live.recordings import messages_in

FRAMES = 4
CAR = Tracklet("Car", (4.0, 2.0, 1.5), 1, [(10.0, 1.0, -1.7, 0.0)] * 2, [0] * 2)


class WithBoxes(FolderDrive):
    """A recording of somebody's whose reader knows boxes."""

    @property
    def has_tracklets(self) -> bool:
        return True

    def tracklets(self) -> list[Tracklet]:
        return [CAR]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    body = synthetic.motion(FRAMES)
    scans = synthetic.scans(body, azimuths=60)
    since = [np.zeros(len(points)) for points in scans]
    return own.write(tmp_path / "mine", own.Recorded(scans, since, body, np.arange(FRAMES) * np.float64(own.PERIOD)))


def test_boxes_of_any_reader_are_in_a_recording(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def found(root: Path) -> list[Drive]:
        return [WithBoxes(root)]

    monkeypatch.setattr("envpred.live.bag.find_drives", found)
    main(["bag", f"--out={folder / 'drive.mcap'}", f"--source={folder}"])
    markers = [message.content.markers for message in messages_in(folder / "drive.mcap")["/truth/boxes"]]
    assert [len(boxes) - 1 for boxes in markers] == [0, 1, 1, 0]
    assert markers[1][1].scale.x == 4.0


def test_recordings_without_boxes_have_none(folder: Path) -> None:
    (drive,) = find_drives(folder)
    assert not Truth.of(drive).tracklets
    assert not Truth.of(one_drive(synthetic.write_drive(folder / "kitti", frames=2, azimuths=30))).tracklets

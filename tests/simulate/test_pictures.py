"""The pictures show what they say: points in their class's colour, everybody of a moment on the street."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.collections import PathCollection
from matplotlib.patches import Polygon

from envpred.errors import UserError
from envpred.simulate import classes
from envpred.simulate.pictures import scan_picture, traffic_picture
from envpred.simulate.traffic import LANES, Network, Recording, Track


@pytest.fixture(autouse=True)
def _close() -> object:
    yield None
    plt.close("all")


def test_a_scan_is_drawn_in_the_colours_of_its_classes(tmp_path: Path) -> None:
    """Three points ahead, drawn from far to near, and one out of reach that is not drawn."""
    points = np.array([[5, 1, -1, 0], [20, 0, 0, 0], [10, -2, -1.7, 0], [70, 0, 0, 0]], np.float32)
    words = np.array([classes.MOVING_CAR | 7 << 16, classes.BUILDING, classes.ROAD, classes.ROAD], np.uint32)
    for place, array in ((tmp_path / "velodyne_points" / "data", points), (tmp_path / "labels", words)):
        place.mkdir(parents=True)
        array.tofile(place / ("0000000003.bin" if array is points else "0000000003.label"))
    axes = scan_picture(tmp_path, 3).axes[0]
    words[:3].tofile(tmp_path / "labels" / "0000000003.label")
    with pytest.raises(UserError, match=r"0000000003\.label: 3 labels of 4 points; copy it again"):
        scan_picture(tmp_path, 3)
    drawn = axes.collections[0]
    assert [t.get_text() for t in axes.get_legend().get_texts()] == ["road", "building", "car"]  # type: ignore[union-attr]
    assert isinstance(drawn, PathCollection)
    colours = np.asarray(drawn.get_facecolor())[:, :3]
    wanted = [classes.COLOURS[c] for c in (classes.BUILDING, classes.ROAD, classes.CAR)]
    np.testing.assert_allclose(colours, np.array(wanted) / 255)
    offsets = np.asarray(drawn.get_offsets())
    assert offsets[1, 0] > offsets[0, 0] > offsets[2, 0]  # y points left, pictures point right


def test_the_traffic_of_a_moment_is_drawn_where_it_is() -> None:
    lane = (LANES.index("driving"), 3.0, np.array([[0.0, 0.0], [100.0, 0.0]]))
    times = np.arange(21) * 0.5
    tracks = [
        Track(0, 4.5, 1.8, 0, 0.0, np.column_stack([5.0 * times, 0 * times])),
        Track(4, 0.5, 0.6, 18, 0.0, np.column_stack([50 + 0 * times, 5 + 0 * times])),  # there only from 9 s on
    ]
    axes = traffic_picture(Recording(0.5, 20.0, [Network("lane", [lane], [], tracks)]), 0, 6.0, reach=50).axes[0]
    boxes = [p for p in axes.patches if isinstance(p, Polygon) and p.get_label() == "car"]
    assert len(boxes) == 1
    corners = np.asarray(boxes[0].get_xy())
    np.testing.assert_allclose([corners[:, 0].min(), corners[:, 0].max()], [25.5, 30.0], atol=0.05)
    np.testing.assert_allclose([corners[:, 1].min(), corners[:, 1].max()], [-0.9, 0.9], atol=0.01)
    assert [t.get_text() for t in axes.get_legend().get_texts()] == ["car"]  # type: ignore[union-attr]
    np.testing.assert_allclose(axes.get_xlim(), [27.75 - 50, 27.75 + 50], atol=0.05)

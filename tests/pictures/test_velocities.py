"""Pictures of velocities: colours by hand, and where things are drawn."""

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from envpred.mapping.geometry import EGO, FREE, OCCUPIED
from envpred.pictures.velocities import (
    FASTEST,
    colour_of,
    of_drive,
    of_frame,
    over_labels,
    over_occupancy,
    velocity_strip,
)
from envpred.store import Store
from tests.store.stores import write_store


def one(east: float, north: float) -> np.ndarray:
    return np.asarray(colour_of(np.array([east, north]).reshape(2, 1, 1))[0, 0])


@pytest.mark.parametrize(
    ("east", "north", "colour"),
    [(1, 0, (1, 0, 0)), (0, 1, (0.5, 1, 0)), (-1, 0, (0, 1, 1)), (0, -1, (0.5, 0, 1)), (0, 0, (0, 0, 0))],
)
def test_hue_is_the_direction(east: float, north: float, colour: tuple[float, float, float]) -> None:
    np.testing.assert_allclose(one(FASTEST * east, FASTEST * north), colour, atol=1e-6)


def test_brightness_is_the_speed() -> None:
    brightness = [one(speed, 0)[0] for speed in (0.1, FASTEST / 2, FASTEST, 3 * FASTEST)]
    np.testing.assert_allclose(brightness, [0.35, 0.675, 1, 1], atol=0.01)


def test_only_occupied_cells_are_coloured() -> None:
    labels = np.array([[0, OCCUPIED], [FREE, EGO]], np.uint8)
    velocity = np.zeros((2, 2, 2))
    velocity[0] = FASTEST
    picture = over_labels(labels, velocity)
    np.testing.assert_allclose(picture[0, 1], (1, 0, 0), atol=1e-6)
    np.testing.assert_allclose(picture[1, 0], (1, 1, 1))
    assert (picture[0, 0] == picture[0, 0, 0]).all()  # grey
    assert (picture[1, 1] == picture[1, 1, 0]).all()
    standing = over_labels(labels, 0 * velocity)
    assert standing[0, 1].tolist() == [0, 0, 0]


def test_occupancy_fades_to_white() -> None:
    velocity = np.zeros((2, 1, 3))
    velocity[0] = FASTEST
    picture = over_occupancy(np.array([[0.0, 0.5, 1.0]]), velocity)
    np.testing.assert_allclose(picture[0], [(1, 1, 1), (1, 0.5, 0.5), (1, 0, 0)], atol=1e-6)


def test_pictures_of_a_stored_drive(tmp_path: Path) -> None:
    drive = Store(write_store(tmp_path / "grids", {"a": list(range(5))}, dogma=True)).drives["a"]
    (image,) = (image for image in of_frame(drive, 2).axes[0].images)
    shown = np.asarray(image.get_array())  # rows are north, columns east
    labels = np.array(drive.array("label")[2])
    moving = (shown.min(-1) < 0.1) & (shown.max(-1) > 0.3)
    np.testing.assert_array_equal(moving.T, labels == OCCUPIED)
    animation = Image.open(io.BytesIO(of_drive(drive)))
    assert animation.n_frames == 5  # type: ignore[attr-defined]


def test_strip_has_a_row_for_the_forecast_if_there_is_one() -> None:
    window = np.zeros((15, 8, 8)), np.zeros((15, 2, 8, 8))
    last = window[0][0], window[1][0]
    assert len(velocity_strip(last, window, None, 1 / 3, 0.1).axes) == 5
    assert len(velocity_strip(last, window, window, 1 / 3, 0.1).axes) == 10


def test_strip_shows_the_datas_own_metres_and_seconds() -> None:
    window = np.zeros((30, 8, 8)), np.zeros((30, 2, 8, 8))
    fig = velocity_strip((window[0][0], window[1][0]), window, window, 0.5, 0.05)
    assert [ax.get_title() for ax in fig.axes if ax.get_title()] == [
        "last frame shown",
        "0.1 s",
        "0.5 s",
        "1.0 s",
        "1.5 s",
    ]
    extents = [tuple(image.get_extent()) for ax in fig.axes for image in ax.images]
    assert extents == [(-2.25, 1.75, -2.25, 1.75)] * 9

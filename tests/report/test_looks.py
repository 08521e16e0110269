"""Lines that a grey print and people without one kind of cone tell apart."""

import itertools

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from numpy.typing import NDArray

from envpred.report.looks import COLOUR_OF, OTHERS, looks

Array = NDArray[np.float64]
XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)
# Machado, Oliveira, Fernandes 2009, of full severity, in linear RGB.
VISION = {
    "all cones": np.eye(3),
    "protanopia": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "deuteranopia": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "tritanopia": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]]
    ),
}


def seen(colour: str, vision: Array) -> Array:
    """CIE L*a*b* of a colour as somebody sees it."""
    linear = np.array([c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in to_rgb(colour)])
    relative = XYZ @ np.clip(vision @ linear, 0, 1) / XYZ.sum(axis=1)
    x, y, z = np.where(relative > (6 / 29) ** 3, np.cbrt(relative), relative / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


def test_kinds_differ_in_lightness_and_stand_out_from_paper() -> None:
    lightness = [seen(colour, VISION["all cones"])[0] for colour in COLOUR_OF.values()]
    assert lightness == sorted(lightness)
    assert min(np.diff(lightness)) > 8
    assert max(lightness) < 80


@pytest.mark.parametrize("vision", VISION)
def test_colours_differ_whoever_looks(vision: str) -> None:
    ours = [seen(colour, VISION[vision]) for colour in COLOUR_OF.values()]
    assert min(np.linalg.norm(a - b) for a, b in itertools.combinations(ours, 2)) > 15
    others = [seen(colour, VISION[vision]) for colour in OTHERS]
    assert min(np.linalg.norm(a - b) for a, b in itertools.combinations(ours + others, 2)) > 8


def test_colours_tell_the_method_and_styles_its_variant() -> None:
    kind_of = {"a": "prednet", "b": "prednet", "c": "static", "d": "mine", "e": "mine", "f": "yours", "g": "oracle"}
    found = looks(kind_of)
    colours = {label: look.colour for label, look in found.items()}
    assert colours["a"] == colours["b"]
    assert colours["d"] == colours["e"]
    assert len(set(colours.values())) == 5
    assert len({(look.colour, look.style) for look in found.values()}) == len(found)
    assert len({look.marker for look in found.values()}) == len(found)  # and without any colour

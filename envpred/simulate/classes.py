"""Class numbers and colours of SemanticKITTI (Behley et al. 2019), as far as the simulation uses them."""

import numpy as np
from numpy.typing import NDArray

CAR, BICYCLE, TRUCK, OTHER_VEHICLE, PERSON, BICYCLIST = 10, 11, 18, 20, 30, 31
ROAD, PARKING, SIDEWALK, OTHER_GROUND = 40, 44, 48, 49
BUILDING, FENCE, OTHER_STRUCTURE = 50, 51, 52
VEGETATION, TRUNK, TERRAIN = 70, 71, 72
POLE, TRAFFIC_SIGN, OTHER_OBJECT = 80, 81, 99
MOVING_CAR, MOVING_BICYCLIST, MOVING_PERSON, MOVING_TRUCK, MOVING_OTHER = 252, 253, 254, 258, 259

GROUND = (ROAD, PARKING, SIDEWALK, OTHER_GROUND, TERRAIN)
MOVING = (MOVING_CAR, MOVING_BICYCLIST, MOVING_PERSON, MOVING_TRUCK, MOVING_OTHER)
MOVING_OF = {
    CAR: MOVING_CAR,
    BICYCLIST: MOVING_BICYCLIST,
    PERSON: MOVING_PERSON,
    TRUCK: MOVING_TRUCK,
    OTHER_VEHICLE: MOVING_OTHER,
}

# SemanticKITTI's colours, red, green, blue.
COLOURS = {
    CAR: (100, 150, 245),
    BICYCLE: (100, 230, 245),
    TRUCK: (80, 30, 180),
    OTHER_VEHICLE: (0, 0, 255),
    PERSON: (255, 30, 30),
    BICYCLIST: (255, 40, 200),
    ROAD: (255, 0, 255),
    PARKING: (255, 150, 255),
    SIDEWALK: (75, 0, 75),
    OTHER_GROUND: (175, 0, 75),
    BUILDING: (255, 200, 0),
    FENCE: (255, 120, 50),
    OTHER_STRUCTURE: (255, 150, 0),
    VEGETATION: (0, 175, 0),
    TRUNK: (135, 60, 0),
    TERRAIN: (150, 240, 80),
    POLE: (255, 240, 150),
    TRAFFIC_SIGN: (255, 0, 0),
    OTHER_OBJECT: (50, 255, 255),
}
COLOURS |= {moving: COLOURS[still] for still, moving in MOVING_OF.items()}


def semantic(labels: NDArray[np.uint32]) -> NDArray[np.uint16]:
    """Class numbers (...,) of `.label` words, whose upper half is the instance."""
    return (labels & 0xFFFF).astype(np.uint16)


def instance(labels: NDArray[np.uint32]) -> NDArray[np.uint16]:
    """Instance numbers (...,) of `.label` words; 0 is none."""
    return (labels >> 16).astype(np.uint16)

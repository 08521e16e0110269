"""How a metric is written: title, unit, digits, factor, direction and what it rewards, as results carry them."""

from collections.abc import Mapping
from typing import Any, Literal, NamedTuple

Direction = Literal["lower", "higher"] | float


class About(NamedTuple):
    """How a metric is written: what a table needs to know of one that it has never heard of.

    Args:
        title: what it measures, in words.
        unit: that of the value times `factor`, empty for a bare number.
        digits: decimals.
        factor: by which values are multiplied before they are written.
        direction: whether `lower` or `higher` is better, or the number that is best.
        rewards: what a forecast has to do to look good by it, in one sentence; empty where nobody says.
    """

    title: str
    unit: str
    digits: int
    factor: float
    direction: Direction
    rewards: str = ""

    @classmethod
    def of(cls, value: Mapping[str, Any]) -> "About":
        """What the value of a metric in a result file says of itself.

        Raises:
            KeyError, TypeError, ValueError: if it does not.
        """
        way = value["direction"]
        direction: Direction = way if way in ("lower", "higher") else float(way)
        return cls(
            str(value["title"]),
            str(value["unit"]),
            int(value["digits"]),
            float(value["factor"]),
            direction,
            str(value.get("rewards", "")),
        )

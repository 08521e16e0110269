"""Files that ship with envpred, found in a checkout and in an installed package alike."""

from pathlib import Path

import envpred

PACKAGE = Path(envpred.__file__).parent


def shipped(name: str, beside: Path | None = None) -> Path:
    """The file `name`: as it stands, beside the file that names it, or among those that ship.

    What is nowhere comes back as it is, for whoever reads it to say so.
    """
    places = [Path(), *([beside.parent] if beside else []), PACKAGE, PACKAGE.parent]
    return next((place / name for place in places if (place / name).is_file()), Path(name))

"""LiDAR drives as evidential occupancy grids, and their forecasts: what a program of yours imports.

Each name is loaded when it is first used, so that `import envpred` costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from envpred.caches import give_folders

if TYPE_CHECKING:
    from envpred import drives as drives
    from envpred.live.stream import Stream as Stream
    from envpred.mapping.mapper import Mapper as Mapper
    from envpred.models.loading import load_forecaster as load_forecaster
    from envpred.store import Store as Store

    __version__: str

__all__ = ["Mapper", "Store", "Stream", "drives", "load_forecaster"]

FALLBACK_VERSION = "0.1.0"  # of a tree that is not installed

_FACE = {
    "Mapper": "envpred.mapping.mapper",
    "Store": "envpred.store",
    "Stream": "envpred.live.stream",
    "load_forecaster": "envpred.models.loading",
}

give_folders()  # before any library looks for its own


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return _version()
    if name == "drives":
        return import_module("envpred.drives")
    if name in _FACE:
        return getattr(import_module(_FACE[name]), name)
    raise AttributeError(f"module 'envpred' has no attribute {name!r}")


def _version() -> str:
    """What the build has read from the tags of git."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("envpred")
    except PackageNotFoundError:
        return FALLBACK_VERSION

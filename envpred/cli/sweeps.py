"""The sweeps: part of an installed envpred, and beside the package in a checkout."""

import sys
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

from envpred.cli.shipped import PACKAGE
from envpred.errors import UserError

NAME = "sweeps"


def module(name: str) -> ModuleType:
    """The module `name` of the sweeps that came with this envpred, `tune` say.

    Whatever else is called sweeps on the way that Python searches, is not looked at.

    Raises:
        UserError: if envpred came without them, or another package of their name is loaded already.
    """
    if (PACKAGE / NAME / "__init__.py").is_file():
        return import_module(f"{PACKAGE.name}.{NAME}.{name}")
    ours = PACKAGE.parent / NAME / "__init__.py"
    if not ours.is_file():
        raise UserError(f"{PACKAGE}: came without its sweeps; install envpred again, or work in a whole checkout of it")
    if NAME not in sys.modules:
        _load(ours)
    loaded = sys.modules[NAME].__file__
    if loaded is None or not Path(loaded).samefile(ours):
        raise UserError(f"{loaded}: a package of the name {NAME} hides that of envpred; rename it")
    return import_module(f"{NAME}.{name}")


def _load(file: Path) -> None:
    """Load the package whose `__init__.py` is `file`."""
    spec = spec_from_file_location(NAME, file, submodule_search_locations=[str(file.parent)])
    assert spec is not None
    assert spec.loader is not None
    sys.modules[NAME] = module_from_spec(spec)
    spec.loader.exec_module(sys.modules[NAME])

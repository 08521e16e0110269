"""Files that ship with envpred: configurations, presets and search spaces, found by short names in a checkout and in an
installed package alike."""

import re
from collections.abc import Sequence
from pathlib import Path

import envpred
from envpred.errors import UserError, nearest, printable
from envpred.gate.weights import read_config
from envpred.gate.weights import shipped as shipped_weights

PACKAGE = Path(envpred.__file__).parent
# What ships, by its kind: where it lies beside or in the package, and which commands take it.
FOLDERS = {
    "model": "configs/model",
    "data": "configs/data",
    "grids": "configs/grids",
    "preset": "sweeps/presets",
    "space": "sweeps/spaces",
}
COMPLETE = ("model", "data", "preset")  # configurations of fit, validate, test and predict


def shipped(name: str, beside: Path | None = None) -> Path:
    """The file `name`: as it stands, beside the file that names it, or among those that ship.

    What is nowhere comes back as it is, for whoever reads it to say so.
    """
    places = [Path(), *([beside.parent] if beside else []), PACKAGE, PACKAGE.parent]
    return next((place / name for place in places if (place / name).is_file()), Path(name))


def names(kind: str) -> dict[str, Path]:
    """What ships of a kind, by its short name."""
    folders = (place / FOLDERS[kind] for place in (PACKAGE, PACKAGE.parent))
    return next(({f.stem: f for f in sorted(folder.glob("*.yaml"))} for folder in folders if folder.is_dir()), {})


def find(name: str, kinds: Sequence[str], option: str = "--config", beside: Path | None = None) -> Path:
    """The file that a short name of one of the `kinds`, or a path, stands for.

    Raises:
        UserError: naming the nearest, if there is none.
    """
    file = shipped(name, beside)
    if file.is_file():
        return file
    known = {short: path for kind in reversed(kinds) for short, path in names(kind).items()}
    if name in known:
        return known[name]
    near = nearest(Path(name).stem, known)
    hint = f"did you mean {near}?" if near else f"there are {', '.join(known)}"
    raise UserError(
        f"{option} {printable(name)}: no such file, and none of this name ships; {hint} (`envpred configs` lists all)"
    )


def configs() -> None:
    """List the configurations, presets, search spaces and weights that ship, by the names that options take."""
    for kind, folder in FOLDERS.items():
        found = names(kind)
        width = max(map(len, found), default=0) + 2
        print(f"{folder} ({'--space' if kind == 'space' else '--config'}):")
        for name, file in found.items():
            print(f"  {name:{width}}{about(file)}")
    weights = {name: read_config(folder) for name, folder in shipped_weights().items()}
    width = max(map(len, weights), default=0) + 2
    print("weights (--weights, --model.init_from):")
    for name, config in weights.items():
        trained = len(config["training"]["data"]["drives"])
        print(f"  {name:{width}}{config['forecaster']}, {config['variant']}, trained on {trained} drives")


def is_name(text: str) -> bool:
    """Whether the value of an option names a file, rather than being its content."""
    return re.fullmatch(r"[\w./~ -]+", text) is not None


def about(file: Path) -> str:
    """What a configuration is for: the first sentence of the comment that it begins with."""
    lines = []
    for line in file.read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            break
        lines.append(line.lstrip("# ").strip())
    return re.split(r"(?<=\.)\s", " ".join(lines), maxsplit=1)[0]

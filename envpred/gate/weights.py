"""Weights that ship, or lie in a folder laid out alike: `config.json`, `model.safetensors`, and a card, `README.md`.

Nothing of them is loaded here, so that whoever lists them is quick.
"""

from pathlib import Path
from typing import Annotated, Any, Literal

from msgspec import Meta, Struct

from envpred.errors import UserError, nearest, printable
from envpred.gate.plain import read_json
from envpred.gate.types import Cells, Count, Key, Length, Line, Number, Positive, Values

FORMAT = 1
CONFIG, TENSORS, CARD = "config.json", "model.safetensors", "README.md"
FOLDER = Path(__file__).parents[1] / "weights"
AGAIN = "install envpred again, or get the folder from where it was made"

Sha256 = Annotated[str, Meta(pattern=r"\A[0-9a-f]{64}\Z")]


class Grids(Struct):
    """The kind of grids that weights were trained on: cells of the wide grid only where it is read."""

    period: Length
    resolution: Length
    cells: Cells
    context: Cells | None


class TrainingData(Grids):
    """The drives that weights were trained on; a data module says more of them (`GridDataModule.describe`)."""

    store: Line
    store_hash: Line
    drives: Annotated[list[Line], Meta(min_length=1)]


class Training(Struct):
    """How weights came about."""

    data: TrainingData
    hyperparameters: dict[str, Any]
    command: Line
    revision: Line
    seconds: Number
    threads: Count
    epoch: Count
    val_mse: Number
    static_mse: Number
    seed: int | None = None


class Measured(Struct):
    """Mean squared errors of a method on the windows of a drive, at the config's `horizon_s`; `first`: of the first."""

    store: Line
    store_hash: Line
    drive: Line
    windows: Annotated[int, Meta(ge=1)]
    method: Key
    mse: Values
    first: Values


class Config(Struct):
    """`config.json`."""

    name: Key
    about: Line
    forecaster: Key
    init_args: dict[str, Any]
    variant: Literal["dst_static", "prob_static", "dst_dogma", "prob_dogma"]
    given: Annotated[int, Meta(ge=1, le=1000)]
    parameters: Count
    sha256: Sha256
    training: Training
    horizon_s: list[Positive] = []
    measured: list[Measured] = []

    def __post_init__(self) -> None:
        if any(len(row.mse) != len(self.horizon_s) or len(row.first) != len(self.horizon_s) for row in self.measured):
            raise ValueError("measured has other horizons than horizon_s")


def shipped() -> dict[str, Path]:
    """The folders of the weights that ship, by name."""
    return {file.parent.name: file.parent for file in sorted(FOLDER.glob(f"*/{CONFIG}"))}


def find(name: str) -> Path | None:
    """The folder of the weights that ship under a name, or lie in the folder of that path; None if there are none."""
    if (Path(name) / CONFIG).is_file():
        return Path(name)
    return shipped().get(name)


def found(name: str, option: str) -> Path:
    """As `find`.

    Raises:
        UserError: naming the weights that there are.
    """
    folder = find(name)
    if folder is not None:
        return folder
    names = shipped()
    near = nearest(name, names)
    hint = f"did you mean {near}?" if near else f"there are {', '.join(names) or 'none'}"
    raise UserError(
        f"{option} {printable(name)}: no weights of this name ship, and no folder holds such; {hint} "
        "(`envpred configs` lists them)"
    )


def read_config(folder: Path) -> dict[str, Any]:
    """What `config.json` of weights says.

    Raises:
        UserError: if it cannot be read, is of another format, or does not fit.
    """
    config: dict[str, Any] = read_json(folder / CONFIG, Config, AGAIN, FORMAT)
    return config

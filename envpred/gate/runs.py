"""What fit, test, predict and sweeps leave on the disk."""

import itertools
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, TypedDict

from msgspec import UNSET, Meta, Struct, UnsetType, field

from envpred.gate.arrays import ArraySchema
from envpred.gate.types import Cells, Checksum, Count, Key, Length, Line, Number, Place, Point, Positive, Values

Seconds = Annotated[float, Meta(ge=0, le=1e9)]  # `seconds.json` of a run of an ablation


class Named(Struct):
    """The model of predictions."""

    name: Key
    hyperparameters: dict[str, Any] = {}
    untrained: bool = False


class TrainedOn(Struct):
    """The data that weights come from."""

    drives: list[Line] = []


class Trained(Struct):
    """Where the weights of a result come from."""

    data: TrainedOn = field(default_factory=TrainedOn)


class Model(Named, kw_only=True):
    """The model of a result."""

    parameters: Count
    hyperparameters: dict[str, Any]
    trained: Trained | None = None
    flops: Number | None = None


class Data(Struct):
    """What a result was measured on."""

    store_hash: Line
    input_hash: dict[Key, Line]
    windows: Annotated[list[tuple[Line, Count]], Meta(min_length=1)]
    given: Count
    length: Count
    drives: list[Line]
    split: Line
    window_rule: Line
    resolution: Length
    movers: Literal["tracklets", "labels"]
    warnings: dict[Line, list[Line]] = {}


class Metric(Struct):
    """A metric of a result: its values by horizon, and how it is written."""

    mean: Values
    standard_error: Values
    title: Line
    unit: Line
    digits: Annotated[int, Meta(ge=0, le=17)]
    factor: Number
    direction: Literal["lower", "higher"] | Number
    per_window: list[Values] | UnsetType = UNSET


class Diagram(Struct):
    """A reliability diagram: (N, bins) each."""

    forecast: list[Values]
    occupied: list[Values]
    count: list[Values]

    def __post_init__(self) -> None:
        if len({tuple(map(len, rows)) for rows in (self.forecast, self.occupied, self.count)}) > 1:
            raise ValueError("rows of different lengths")


class Result(Struct):
    """`result.json` of a test run."""

    model: Model
    role: Key
    variant: Key
    data: Data
    horizon_s: Annotated[list[Positive], Meta(min_length=1)]
    metrics: dict[Key, dict[str, Any]]  # a `Metric` each that has a mean, and `reliability` a `Diagram`
    seed: int | None = None
    revision: Line | None = None
    command: str | None = None
    forecast_seconds_per_window: Number | None = None
    pictures: dict[Line, Place] | None = None
    drawn: Place | None = None

    def __post_init__(self) -> None:
        if any(b <= a for a, b in itertools.pairwise(self.horizon_s)):
            raise ValueError("horizon_s does not increase")


class PredictedDrive(Struct):
    """A drive in a manifest of predictions."""

    lattice_origin_m: Point
    resolution_m: Length
    cells: Cells
    evidence_checksum: Checksum


class PredictedWindow(Struct):
    """A window in a manifest of predictions."""

    drive: Line
    start: Count
    frames: Annotated[list[Count], Meta(min_length=1)]
    targets: Count
    file: Place
    checksum: Checksum


class PredictedData(Struct):
    """What predictions were made from."""

    context: int | None = None


class PredictionsManifest(Struct):
    """`manifest.json` of predictions."""

    model: Named
    role: Key
    variant: Key
    data: PredictedData
    horizon_s: Annotated[list[Length], Meta(min_length=1)]
    drives: dict[Line, PredictedDrive]
    windows: list[PredictedWindow]

    def __post_init__(self) -> None:
        if any(window.drive not in self.drives for window in self.windows):
            raise ValueError("a window is of a drive that is not there")


class ValidationErrors(TypedDict):
    """Squared errors of a validation, at one horizon or over all: means over windows, the static baseline's beside."""

    val_mse: float
    static_mse: float


class Validation(ValidationErrors):
    """One validation of a training, after `step` steps of the optimiser; its horizons by name."""

    epoch: Count
    step: Count
    stage: Line | None
    horizons: dict[Line, ValidationErrors]


class Best(TypedDict):
    """Which validation a checkpoint is of, by its place, and the monitored score that it was chosen for."""

    monitor: Line
    score: float
    validation: Count


class History(Struct):
    """`validations.json`, which checkpoints hold, too."""

    validations: list[Validation]
    best: dict[Place, Best]
    ended: Count | None = None
    initial: Validation | None = None

    def __post_init__(self) -> None:
        if any(best["validation"] >= len(self.validations) for best in self.best.values()):
            raise ValueError("best names a validation that is not there")


class Training(Struct):
    """What a checkpoint says of how its weights came about."""

    data: dict[str, Any]
    hyperparameters: dict[str, Any] = {}


class Checkpoint(Struct):
    """What every checkpoint of a forecaster holds beside its weights."""

    state_dict: dict[str, Any]
    epoch: Count
    global_step: Count
    lightning: Annotated[str, Meta(pattern=r"\A\d{1,4}(\.\d{1,4}){0,3}[a-z0-9.+]{0,40}\Z")] = field(
        name="pytorch-lightning_version"
    )
    class_path: Line = ""
    forecaster: Line = ""
    hyper_parameters: dict[str, Any] = {}
    callbacks: dict[str, Any] = {}
    trained: Training | None = None


class Progress(Struct):
    """What a checkpoint holds beside weights, from which a training goes on."""

    optimizer_states: list[dict[str, Any]]
    lr_schedulers: list[dict[str, Any]]


# `drawn.npz`: K windows of N horizons, S frames shown.
SCENES = {
    "index": ArraySchema("iu", ("K",), 0),
    "drive": ArraySchema("U", ("K",)),
    "frames": ArraySchema("iu", ("K", "S"), 0),
    "seen": ArraySchema("f", ("K", "S", "H", "H")),
    "target": ArraySchema("f", ("K", "N", "H", "H")),
    "centre_cell": ArraySchema("iu", ("K", "frames", 2), -(2**40), 2**40),
    "forecast": ArraySchema("f", ("K", "horizons", "H", "H")),
    "resolution": ArraySchema("f", ("K",), 1e-4, 1e4),
    "period": ArraySchema("f", ("K",), 1e-4, 1e4),
    "context": ArraySchema("f", ("K", "W", "W"), optional=True),
}


def keras_weights(names: Sequence[str]) -> Mapping[str, ArraySchema]:
    """Those of the arrays `names` that are weights of Keras layers; what else an archive holds is not read."""
    return {name: ArraySchema("f", None) for name in names if "/" in name}

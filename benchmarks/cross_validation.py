"""Cross-validates rollouts: every drive is forecast with constants and weights that were found on other drives alone.

    python -m benchmarks.cross_validation STORE [STORE ...] [--folds 4] [--steps 500]

The stores are built with `--config rollout`.  The drives of each are dealt to the folds by turns;
a fold's drives are left out together, and on all others the hit rates and the spread of the ego's futures are fitted
and, with --steps, the network of `configs/model/corrected_rollout.yaml` is trained on top of these.  Printed as
Markdown: the squared error of every drive as a share of the static baseline's, beside that of the shipped constants.
"""

import argparse
import sys
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from lightning.pytorch import Trainer, seed_everything

from benchmarks.hit_rates import examples_of, longest_stretch, pose_in_cells
from envpred.datamodules import GridDataModule
from envpred.datamodules.grids import AHEAD
from envpred.errors import UserError
from envpred.horizons import horizon_name, shown_steps
from envpred.mapping.ego_calibration import Track, estimate
from envpred.mapping.ego_motion import EgoMotion
from envpred.mapping.geometry import FloatArray
from envpred.mapping.hit_rate_fit import Examples, fit
from envpred.mapping.hit_rates import HitRates
from envpred.models import CorrectedRolloutForecaster, Forecaster, RolloutForecaster
from envpred.report.table import Cell, Table
from envpred.results.result import revision
from envpred.store import Store, StoredDrive

METHODS = ("rollout as shipped", "rollout, left out", "corrected, left out")


class Material(NamedTuple):
    """What constants are found in, of one drive."""

    examples: Examples
    track: Track

    @classmethod
    def of(cls, drive: StoredDrive, every: int) -> "Material":
        """Read a drive; examples look ahead from `every` so many-th frame."""
        frames = longest_stretch(drive)
        return cls(
            examples_of(drive, every), Track(pose_in_cells(drive)[frames], np.array(drive.array("time"))[frames])
        )


@dataclass(frozen=True)
class Constants:
    """What rollouts are told that was found on drives."""

    rates: HitRates
    motion: EgoMotion

    @classmethod
    def of(cls, drives: Sequence[Material], resolution: float, horizons: int) -> "Constants":
        """Fit them; every drive counts alike."""
        motion = estimate([drive.track for drive in drives], resolution, horizons=horizons)
        return cls(fit([drive.examples for drive in drives]), motion)

    def into(self, forecaster: RolloutForecaster) -> RolloutForecaster:
        """The forecaster, told them."""
        forecaster.rates, forecaster.motion = self.rates, self.motion
        return forecaster


def folds(stores: Mapping[str, Sequence[str]], count: int) -> list[list[str]]:
    """Drives that are left out together: those of each store dealt to `count` folds by turns, no empty ones."""
    dealt = [[name for names in stores.values() for name in names[k::count]] for k in range(count)]
    return [names for names in dealt if names]


def joined(stores: Sequence[Path], folder: Path) -> dict[str, list[str]]:
    """Make `folder` one store of links to the drives of all; returns the names of each store's drives.

    Raises:
        UserError: if two stores hold a drive of the same name.
    """
    found: dict[str, list[str]] = {}
    (folder / "store.json").write_bytes((stores[0] / "store.json").read_bytes())
    for store in stores:
        found[store.name] = list(Store(store).drives)
        for name in found[store.name]:
            if (folder / name).exists():
                raise UserError(f"{store}: another store holds a drive {name} too; rename the folder of one of them")
            (folder / name).symlink_to((store / name).absolute())
    return found


def trainer(**options: Any) -> Trainer:
    """A quiet trainer on the CPU that keeps nothing."""
    quiet = dict.fromkeys(("logger", "enable_checkpointing", "enable_progress_bar", "enable_model_summary"), False)
    return Trainer(accelerator="cpu", num_sanity_val_steps=0, **quiet, **options)


def trained(forecaster: CorrectedRolloutForecaster, store: Path, drives: Sequence[str], steps: int) -> Forecaster:
    """The forecaster after so many steps on `drives`, as `configs/model/corrected_rollout.yaml` trains it.

    The last weights count: nothing is chosen, so the drive that a data module wants for validation is not looked at.
    """
    options: dict[str, Any] = {"split": "custom", "train": [*drives[:-1]], "val": [drives[-1]]}
    data = GridDataModule(store, samples=steps, augment=True, **options)
    trainer(max_epochs=1, gradient_clip_val=0.5, limit_val_batches=0).fit(forecaster, datamodule=data)
    return forecaster


def forecasters(
    store: Path, material: Mapping[str, Material], out: Sequence[str], steps: int, seed: int, futures: int
) -> dict[str, Forecaster]:
    """The methods, with all that is fitted found on the drives of the `material` that are not left `out`."""
    rest = [name for name in material if name not in out]
    drive = Store(store).drives[rest[0]]
    horizons = max(1, round(AHEAD / drive.period))
    constants = Constants.of([material[name] for name in rest], drive.grid.resolution, horizons)
    options: dict[str, Any] = {"futures": futures, "movers": True, "seed": seed}
    shipped, fitted = RolloutForecaster(**options), constants.into(RolloutForecaster(**options))
    methods: list[Forecaster] = [shipped, fitted]
    if steps:
        seed_everything(seed, verbose=False)
        corrected = CorrectedRolloutForecaster(horizons=horizons, max_epochs=1, **options)
        constants.into(corrected)
        methods.append(trained(corrected, store, rest, steps))
    return dict(zip(METHODS, methods, strict=False))


def errors(forecaster: Forecaster, store: Path, drives: Sequence[str]) -> dict[str, FloatArray]:
    """Squared errors (windows, 2, horizons) of the forecaster and of the static baseline, of each drive's windows."""
    data = GridDataModule(store, split="custom", test=list(drives))
    trainer().test(forecaster, datamodule=data, verbose=False)
    mse, static = forecaster.tested["mse"], forecaster.tested["static_mse"]
    both = np.stack([mse.per_window.numpy(), static.per_window.numpy()], axis=1)
    places = data.datasets["test"].places
    of = np.array([places[index].drive.name for index in mse.index.tolist()])
    return {name: both[of == name] for name in drives}


def table(
    stores: Mapping[str, Sequence[str]], found: Mapping[str, Mapping[str, FloatArray]], period: float, caption: str
) -> Table:
    """Shares of the static baseline's error, a drive a row, and their mean and largest of each store.

    Args:
        stores: names of each store's drives.
        found: `errors` of each drive, by method.
        period: seconds between frames.
        caption: what a reader must know.
    """
    horizons = next(iter(next(iter(found.values())).values())).shape[-1]
    steps = shown_steps(horizons, period)
    shown = [step - 1 for step in steps]
    rows = []
    for store, names in stores.items():
        shares = {m: np.array([np.divide(*of[n].mean(axis=0))[shown] for n in names]) for m, of in found.items()}
        counts = [len(next(iter(found.values()))[name]) for name in names]
        for k, name in enumerate(names):
            rows.append([name, str(counts[k]), *(_written(share[k]) for share in shares.values())])
        for title, of in (("mean", np.mean), ("largest", np.max)):
            about = f"{store}: {title} of {len(names)}"
            rows.append([about, str(sum(counts)), *(_written(of(share, axis=0)) for share in shares.values())])
    columns = ["left out", "windows", *found]
    title = f"MSE as a share of the static baseline's at {', '.join(horizon_name(step, period) for step in steps)}"
    return Table("cross_validation", title, caption, columns, [[Cell(text) for text in row] for row in rows])


def _written(shares: FloatArray) -> str:
    return ", ".join(f"{share:.2f}" for share in shares)


def main() -> None:
    """Leave out, fit, train, test, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("stores", nargs="+", type=Path, help="built with --config rollout")
    parser.add_argument("--folds", type=int, default=4, help="as many as drives leave out each alone")
    parser.add_argument("--steps", type=int, default=0, help="of the network that corrects the world; 0 for none")
    parser.add_argument("--every", type=int, default=10, help="frames between those from which examples look ahead")
    parser.add_argument("--futures", type=int, default=16, help="of the ego")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    found: dict[str, dict[str, FloatArray]] = {}
    with TemporaryDirectory() as folder:
        store = Path(folder)
        stores = joined(arguments.stores, store)
        drives = Store(store).drives
        material = {name: Material.of(drive, arguments.every) for name, drive in drives.items()}
        for out in folds(stores, arguments.folds):
            methods = forecasters(store, material, out, arguments.steps, arguments.seed, arguments.futures)
            for method, forecaster in methods.items():
                found.setdefault(method, {}).update(errors(forecaster, store, out))
            fitted = methods[METHODS[1]]
            assert isinstance(fitted, RolloutForecaster)
            numbers = zip(fields(EgoMotion), astuple(fitted.motion), strict=True)
            print(f"without {', '.join(out)}:", *(f"{f.name} {v:.4g}" for f, v in numbers), file=sys.stderr)
        period = next(iter(drives.values())).period
    command = " ".join(["python -m benchmarks.cross_validation", *sys.argv[1:]])
    print(table(stores, found, period, f"`{command}`, revision {revision()}").markdown())


if __name__ == "__main__":
    main()

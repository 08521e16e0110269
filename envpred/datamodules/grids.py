"""The LightningDataModule over a store of grids."""

from pathlib import Path
from typing import Any, Literal

import numpy as np
from lightning.pytorch import LightningDataModule
from lightning.pytorch.utilities import rank_zero_info
from torch.utils.data import DataLoader

from envpred.datamodules.selection import Selection, Split, preset, select
from envpred.datamodules.variants import variant as variant_of
from envpred.datamodules.windows import (
    Place,
    RandomWindows,
    Window,
    WindowDataset,
    every_window,
    windows_in_order,
)
from envpred.errors import UserError
from envpred.store import Store, StoredDrive, digest


class GridDataModule(LightningDataModule):
    """Windows of precomputed grids, as one of the paper's input variants.

    Training draws random windows; validation and test take windows in order that do not overlap.  `frames` of a batch
    (B, T, C, H, W) are the variant's channels, `occupancy` (B, T, H, W) is the probability that is judged.  Prediction
    needs no targets: but for the test windows, its batches hold the frames shown and no more.

    Args:
        store: folder that `envpred grids` wrote.
        variant: dst_static, prob_static, dst_dogma or prob_dogma.
        split: auto, paper, or custom for the lists below (see `envpred.datamodules.selection.preset`).
        train: drives that train, each as name or name@start-stop; they replace the preset's.
        val: drives that validate, likewise.
        test: drives that test, likewise.
        length: frames in a window.
        given: frames of it that are shown to a forecaster; the others are to be forecast.
        samples: random training windows an epoch.
        val_windows: validation windows at most, spread evenly over the validation drives.
        batch_size: windows in a batch.
        augment: turn and mirror training windows at random.
        crop: train on random squares of so many cells a side, cut out of the windows: a network of convolutions alone
            learns the same from them, in a share of the time.  Validation and test see whole grids.
        num_workers: processes that read ahead; reading a window takes a millisecond or two, so none is usually best.
        seed: of the random windows.
        predict: windows that are predicted, of the drives that test: the test windows, the newest `given` frames of
            each drive, or all, one after every frame that is the last of `given` without a gap.
    """

    def __init__(
        self,
        store: Path,
        variant: str = "dst_static",
        split: str = "auto",
        train: list[str] | None = None,
        val: list[str] | None = None,
        test: list[str] | None = None,
        length: int = 20,
        given: int = 5,
        samples: int = 500,
        val_windows: int = 100,
        batch_size: int = 1,
        augment: bool = False,
        crop: int | None = None,
        num_workers: int = 0,
        seed: int = 0,
        predict: Literal["test", "newest", "all"] = "test",
    ) -> None:
        super().__init__()
        if not 1 <= given < length:
            raise UserError(f"--data.given {given} must be at least 1 and below --data.length {length}")
        if min(samples, val_windows, batch_size) < 1:
            raise UserError("--data.samples, --data.val_windows and --data.batch_size must be at least 1")
        self.store, self.variant, self.split = Path(store), variant, split
        self.asked = {"train": train, "val": val, "test": test}
        self.length, self.given, self.samples, self.val_windows = length, given, samples, val_windows
        self.batch_size, self.augment, self.num_workers, self.seed = batch_size, augment, num_workers, seed
        self.predict, self.crop = predict, crop
        self.view = variant_of(variant)
        self.selected: dict[str, list[Selection]] = {}
        self.datasets: dict[str, WindowDataset] = {}

    def setup(self, stage: str) -> None:
        """Find the windows that a stage needs; refuse what does not fit before anything runs."""
        if not self.selected:
            self.selected = self._split(self._usable_drives())
        if stage == "fit" and self.crop is not None and not 1 <= self.crop <= self.cells:
            raise UserError(f"--data.crop {self.crop}: the grids have {self.cells} cells a side; give at most so many")
        needed = {"fit": ("train", "val"), "validate": ("val",), "test": ("test",), "predict": ("predict",)}[stage]
        for part in needed:
            if part not in self.datasets:
                extra = self._extra()
                crop = self.crop if part == "train" else None
                self.datasets[part] = WindowDataset(
                    self._places(part, extra), self.view, self._frames(part), self.given, extra, crop
                )
                names = [str(selection) for selection in self._selected(part)]
                drives = ", ".join(names) if len(names) <= 8 else f"{len(names)} drives, {names[0]} to {names[-1]}"
                rank_zero_info(f"{part}: {len(self.datasets[part])} windows of {drives}")

    def train_dataloader(self) -> DataLoader[Window]:
        data = self.datasets["train"]
        spare = 0 if self.crop is None else self.cells - self.crop
        sampler = RandomWindows(len(data), self.samples, self.seed, self.augment, self._epoch, spare)
        return self._loader(data, sampler=sampler, drop_last=self.samples >= self.batch_size)

    def val_dataloader(self) -> DataLoader[Window]:
        return self._loader(self.datasets["val"])

    def test_dataloader(self) -> DataLoader[Window]:
        return self._loader(self.datasets["test"])

    def predict_dataloader(self) -> DataLoader[Window]:
        return self._loader(self.datasets["predict"])

    def training_mean(self, windows: int = 50) -> float:
        """Mean probability of occupied over training windows in order, at most so many, spread evenly.

        Raises:
            UserError: if the split leaves no drive to train.
        """
        data = WindowDataset(self._places("train"), self.view, self.length)
        chosen = np.unique(np.linspace(0, len(data) - 1, windows).round().astype(int))
        return float(np.mean([data[int(k)]["occupancy"].mean() for k in chosen]))

    @property
    def cells(self) -> int:
        """Cells along a side of the grids."""
        drives = [selection.drive for selections in self.selected.values() for selection in selections]
        return int(drives[0].manifest["lattice"]["cells"])

    def describe(self, part: str) -> dict[str, Any]:
        """What a result was measured on: split, drives, windows and hashes of their content.

        `store_hash` is of what is judged, the same for all variants; `input_hash` of each array that the variant reads
        beside it.
        """
        beside = sorted({*self.view.arrays} - {"evidence"})
        return {
            "store": self.store.name,
            "store_hash": self._hash(part, ["evidence"]),
            "input_hash": {name: self._hash(part, [name]) for name in beside},
            "variant": self.variant,
            "split": "custom" if any(self.asked.values()) else self.split,
            "part": part,
            "drives": [str(selection) for selection in self._selected(part)],
            "window_rule": self._window_rule(part),
            "length": self.length,
            "given": self.given,
            "windows": [[place.drive.name, place.start] for place in self.datasets[part].places],
        }

    def _hash(self, part: str, arrays: list[str]) -> str:
        """A hash of some stored arrays of the drives of `part`."""
        entries = {selection.drive.name: selection.drive.manifest["arrays"] for selection in self._selected(part)}
        return digest({drive: [entry[name]["checksum"] for name in arrays] for drive, entry in entries.items()})

    def _selected(self, part: str) -> list[Selection]:
        """What `part` takes of the drives; what is predicted lies in those that test."""
        return self.selected["test" if part == "predict" else part]

    def _frames(self, part: str) -> int:
        """Frames in a window of `part`: where no targets are needed, those shown."""
        return self.given if part == "predict" and self.predict != "test" else self.length

    def _window_rule(self, part: str) -> str:
        if self._frames(part) < self.length:
            which = "newest of each drive" if self.predict == "newest" else "every start, overlapping"
            return f"windows of {self.given} frames shown, {which}"
        return f"windows of {self.length} frames in order from the start of every stretch, no overlap"

    def _epoch(self) -> int:
        return self.trainer.current_epoch if self.trainer is not None else 0

    def _loader(self, data: WindowDataset, **options: Any) -> DataLoader[Window]:
        return DataLoader(
            data,
            batch_size=self.batch_size,
            num_workers=self.num_workers,
            persistent_workers=self.num_workers > 0,
            **options,
        )

    def _usable_drives(self) -> dict[str, StoredDrive]:
        store = Store(self.store)
        drives = store.drives
        if not drives:
            unfinished = store.unfinished()
            hint = f" ({', '.join(unfinished)} unfinished)" if unfinished else ""
            raise UserError(f"{self.store}: holds no finished drive{hint}; run `envpred grids --store {self.store}`")
        key = digest(store.parameters("mapping"))
        stale = [name for name, drive in drives.items() if drive.manifest["groups"].get("mapping") != key]
        if stale:
            raise UserError(
                f"{self.store}: {', '.join(stale)} were built with other parameters than the store says; "
                "run `envpred grids` again"
            )
        return drives

    def _split(self, drives: dict[str, StoredDrive]) -> dict[str, list[Selection]]:
        asked = {part: select(items, drives) for part, items in self.asked.items() if items}
        if self.split == "custom" or len(asked) == len(self.asked):
            base = Split([], [], [])
        else:
            base = preset(self.split, drives)
        return {"train": base.train, "val": base.val, "test": base.test} | asked

    def _extra(self) -> str | None:
        """The stored array that the trainer's forecaster asks for beside its variant."""
        forecaster = getattr(self.trainer, "lightning_module", None)
        return getattr(forecaster, "extra", None)

    def _places(self, part: str, extra: str | None = None) -> list[Place]:
        selections, length = self._selected(part), self._frames(part)
        argument = f"--data.{'test' if part == 'predict' else part}"
        if not selections:
            raise UserError(f"the split {self.split!r} leaves no drive to {part}; name some with {argument}")
        for selection in selections:
            for name in (*self.view.arrays, *([extra] if extra else [])):
                selection.drive.array(name)  # an error here names the command that makes it
        if part == "train" or length < self.length:
            places = every_window(selections, length)
        else:
            places = windows_in_order(selections, length)
        if not places:
            longest = max((n for s in selections for _, n in s.stretches()), default=0)
            smaller = "--data.length" if length == self.length else "--data.given"
            raise UserError(
                f"no window of {length} frames fits into {', '.join(map(str, selections))}, whose longest stretch "
                f"without a gap has {longest}; give a smaller {smaller} or other drives as {argument}"
            )
        if part == "predict" and self.predict == "newest":
            places = list({place.drive.name: place for place in sorted(places, key=lambda p: p.start)}.values())
        if part == "val" and len(places) > self.val_windows:
            places = [places[k] for k in np.linspace(0, len(places) - 1, self.val_windows).round().astype(int)]
        return places

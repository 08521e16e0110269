"""The LightningDataModule over a store of grids."""

import math
from pathlib import Path
from typing import Any, Literal

import numpy as np
from lightning.pytorch import LightningDataModule
from lightning.pytorch.utilities import rank_zero_info
from torch.utils.data import DataLoader

from envpred.datamodules.contract import Needs
from envpred.datamodules.selection import Selection, movers_of, select, split_drives, told, usable_drives, warnings_of
from envpred.datamodules.variants import variant as variant_of
from envpred.datamodules.windows import (
    CONTEXT,
    Place,
    RandomWindows,
    Window,
    WindowDataset,
    collate,
    every_window,
    occupancy_of,
    windows_in_order,
)
from envpred.errors import UserError, check_number
from envpred.horizons import PERIOD
from envpred.mapping.geometry import GridSpec
from envpred.store import MAPPING_ARRAYS, Store, StoredDrive, check_content, digest

AHEAD = 1.5  # seconds that windows reach beyond the frames shown, unless another length is asked for


class GridDataModule(LightningDataModule):
    """Windows of precomputed grids, as one of the paper's input variants.

    Training draws random windows; validation and test take windows in order that do not overlap.  A batch holds what is
    seen apart from what came then (see `envpred.datamodules.contract`).  Prediction needs no targets: but for the test
    windows, its batches hold what is seen and no more.

    Args:
        store: folder that `envpred grids` wrote.
        variant: dst_static, prob_static, dst_dogma, prob_dogma, or module.NAME of a variant of your own.
        split: auto, reference, or custom for the lists below (see `envpred.datamodules.selection.preset`).
        train: drives that train, each as name or name@start-stop; they replace the preset's.
        val: drives that validate, likewise.
        test: drives that test, likewise.
        length: frames in a window; by default as many as reach 1.5 s beyond those given.
        given: frames of it that are shown to a forecaster; the others are to be forecast.
        samples: random training windows an epoch.
        val_windows: validation windows at most, spread evenly over the validation drives.
        batch_size: windows in a batch.
        augment: turn and mirror training windows at random.
        crop: train on random squares of so many cells a side, cut out of the windows: a network of convolutions alone
            learns the same from them, in a share of the time.  Validation and test see whole grids.
        num_workers: processes that read ahead; reading a window takes a millisecond or two, so none is usually best.
        seed: of the random windows.
        stride: take every so many-th frame of the store: 2 makes 10 Hz of a drive of 20 Hz.
        movers: what says which cells of the test windows move: tracklets, a comparison of labels, or auto for tracklets
            where all test drives have them.
        predict: windows that are predicted: the test windows; or, of the drives named as `test`, by default of all, the
            newest `given` frames of each, or all, one after every frame that is the last of `given` without a gap.
    """

    def __init__(
        self,
        store: Path,
        variant: str = "dst_static",
        split: str = "auto",
        train: list[str] | None = None,
        val: list[str] | None = None,
        test: list[str] | None = None,
        length: int | None = None,
        given: int = 5,
        samples: int = 500,
        val_windows: int = 100,
        batch_size: int = 1,
        augment: bool = False,
        crop: int | None = None,
        num_workers: int = 0,
        seed: int = 0,
        predict: Literal["test", "newest", "all"] = "test",
        stride: int = 1,
        movers: Literal["auto", "tracklets", "labels"] = "auto",
    ) -> None:
        super().__init__()
        if given < 1 or (length is not None and given >= length):
            of = "" if length is None else f" of --data.length {length}"
            raise UserError(f"--data.given {given}{of}: give at least 1, and leave a frame to forecast")
        counts = {"samples": samples, "val_windows": val_windows, "batch_size": batch_size, "stride": stride}
        for name, value in counts.items():
            check_number(f"data.{name}", value, 1)
        check_number("data.num_workers", num_workers)
        check_number("data.seed", seed)
        self.store, self.variant, self.split = Path(store), variant, split
        self.asked = {"train": train, "val": val, "test": test}
        self.asked_length, self.given, self.samples, self.val_windows = length, given, samples, val_windows
        self.batch_size, self.augment, self.num_workers, self.seed = batch_size, augment, num_workers, seed
        self.predict, self.crop, self.stride, self.movers = predict, crop, stride, movers
        self.view = variant_of(variant)
        self.selected: dict[str, list[Selection]] = {}
        self.datasets: dict[str, WindowDataset] = {}

    def setup(self, stage: str) -> None:
        """Find the windows that a stage needs; refuse what does not fit before anything runs."""
        if not self.selected:
            drives = usable_drives(self.store)
            if stage == "predict" and self.predict != "test":
                self.selected = {"predict": select(self.asked["test"] or list(drives), drives)}
            else:
                self.selected = split_drives(self.split, self.asked, drives)
        if stage == "fit" and self.crop is not None and not 1 <= self.crop <= self.cells:
            raise UserError(f"--data.crop {self.crop}: the grids have {self.cells} cells a side; give at most so many")
        needed = {"fit": ("train", "val"), "validate": ("val",), "test": ("test",), "predict": ("predict",)}[stage]
        fresh = [part for part in needed if part not in self.datasets]
        for part in fresh:
            crop = self.crop if part == "train" else None
            horizons, tracked = self._frames(part) - self.given, "moving" in self._arrays(part)
            self.datasets[part] = WindowDataset(
                self._places(part), self.view, self.given, horizons, self.needs, crop, self.stride, tracked
            )
            rank_zero_info(told(part, len(self.datasets[part]), self._selected(part)))
        if fresh and not math.isclose(self.period, PERIOD):  # at another rate, how far ahead that is must be said
            ahead = self.horizons * self.period
            rank_zero_info(f"{self.horizons} forecasts {self.period:.3g} s apart, the last {ahead:.3g} s ahead")

    @property
    def needs(self) -> Needs:
        """What the trainer's forecaster reads beside its variant."""
        forecaster = getattr(self.trainer, "lightning_module", None)
        needs: Needs = getattr(forecaster, "needs", Needs())
        return needs

    @property
    def period(self) -> float:
        """Seconds between the frames of a window."""
        return self._example.period * self.stride

    @property
    def horizons(self) -> int:
        """Frames after those shown that are to be forecast."""
        if self.asked_length is not None:
            return self.asked_length - self.given
        return max(1, round(AHEAD / self.period))

    @property
    def length(self) -> int:
        """Frames in a window."""
        return self.given + self.horizons

    @property
    def grid(self) -> GridSpec:
        """The judged grid."""
        return self._example.grid

    @property
    def cells(self) -> int:
        """Cells along a side of the judged grid."""
        return self.grid.cells

    @property
    def _example(self) -> StoredDrive:
        """A drive that stands for all: their grids and periods are the same."""
        return next(selection.drive for selections in self.selected.values() for selection in selections)

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
        data = WindowDataset(self._places("train"), self.view, self.given, self.horizons, stride=self.stride)
        chosen = np.unique(np.linspace(0, len(data) - 1, windows).round().astype(int))
        return float(np.mean([occupancy_of(data[int(k)]).mean() for k in chosen]))

    def describe(self, part: str) -> dict[str, Any]:
        """What a result was measured on: split, drives, windows and hashes of their content.

        `store_hash` is of what is judged, the same for all variants; `input_hash` of each array that is read beside it,
        by the variant, because the forecaster needs it, or to say what moves.
        """
        return {
            "store": self.store.name,
            "store_hash": self.content_hash(part, ["evidence"]),
            "input_hash": {name: self.content_hash(part, [name]) for name in self._arrays(part) if name != "evidence"},
            "variant": self.variant,
            "split": "custom" if any(self.asked.values()) else self.split,
            "part": part,
            "drives": [str(selection) for selection in self._selected(part)],
            "warnings": warnings_of(self._selected(part)),
            "window_rule": self._window_rule(part),
            "length": self.length,
            "given": self.given,
            "stride": self.stride,
            "movers": movers_of(self._selected(part), self.movers) if part == "test" else None,
            **self.grids(),
            "windows": [[place.drive.name, place.start] for place in self.datasets[part].places],
        }

    def content_hash(self, part: str, arrays: list[str]) -> str:
        """A hash of some stored arrays of the drives of `part`."""
        entries = {selection.drive.name: selection.drive.manifest["arrays"] for selection in self._selected(part)}
        return digest({drive: [entry[name]["checksum"] for name in arrays] for drive, entry in entries.items()})

    def _selected(self, part: str) -> list[Selection]:
        """What `part` takes of the drives."""
        return self.selected["test" if part == "predict" and self.predict == "test" else part]

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
            collate_fn=collate,
            persistent_workers=self.num_workers > 0,
            **options,
        )

    def _arrays(self, part: str) -> list[str]:
        """Names of the stored arrays that are read for `part` beside those of every drive, in order."""
        names = {*self.view.arrays, *self.needs.arrays}
        if part == "test" and movers_of(self._selected(part), self.movers) == "tracklets":
            names.add("moving")
        if self.needs.context:
            names |= {f"{CONTEXT}label", f"{CONTEXT}evidence"}
        return sorted(names - {"label", "centre_cell", "pose", "time"})

    def shape_of(self, array: str) -> tuple[int, ...]:
        """Shape of a frame of a stored array."""
        return tuple(self._example.array(array).shape[1:])

    def velocity_frame(self) -> str | None:
        """What the store's velocities are relative to, `ego` or `ground`; None if it has none."""
        parameters = Store(self.store).parameters("dogma")
        return parameters.get("filter", {}).get("frame", "ego") if parameters else None

    def grids(self) -> dict[str, Any]:
        """What kind of grids these are: time base, cell, cells a side, and of the wide grid if it is read."""
        context = self._example.context if self.needs.context else None
        return {
            "period": self.period,
            "resolution": self.grid.resolution,
            "cells": self.cells,
            "context": None if context is None else context.cells,
        }

    def _places(self, part: str) -> list[Place]:
        selections, length = self._selected(part), self._frames(part)
        argument = f"--data.{'test' if part == 'predict' else part}"
        if not selections:
            raise UserError(f"the split {self.split!r} leaves no drive to {part}; name some with {argument}")
        # What is read must be there, and made with what the store says; else a line names the command that mends it.
        Store(self.store).check([selection.drive.name for selection in selections], self._arrays(part))
        check_content(self.store, [selection.drive for selection in selections], [*MAPPING_ARRAYS, *self._arrays(part)])
        if part == "train" or length < self.length:
            places = every_window(selections, length, self.stride)
        else:
            places = windows_in_order(selections, length, self.stride)
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

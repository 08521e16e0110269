"""Writes the forecasts of `envpred predict` into a folder that is there whole or not at all."""

import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from lightning.pytorch import LightningModule, Trainer
from lightning.pytorch.callbacks import BasePredictionWriter
from lightning.pytorch.utilities import rank_zero_info

from envpred.callbacks.provenance import provenance
from envpred.errors import UserError
from envpred.models import Forecaster
from envpred.results.predictions import FORMAT, WHAT, drive_entry, window_entry
from envpred.store import MANIFEST, sweep
from envpred.store.files import write_json
from envpred.store.parts import Part, begin


class PredictionWriter(BasePredictionWriter):
    """Writes each window's forecast as an array, and a manifest of them all.

    Args:
        folder: new or empty folder for the forecasts; by default `predictions` in the run's folder.
        dtype: of the arrays; half precision is off by 0.00024 at most.
    """

    def __init__(self, folder: Path | None = None, dtype: Literal["float16", "float32"] = "float16") -> None:
        super().__init__("batch")
        self.folder, self.dtype = folder, np.dtype(dtype)
        self.out: Path | None = None
        self.part: Path | None = None  # where all processes write
        self.own: Part | None = None  # what one of them has made for it
        self.entries: dict[int, dict[str, Any]] = {}

    def setup(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Refuse a folder that holds anything before there is work to lose."""
        super().setup(trainer, pl_module, stage)
        if stage != "predict" or trainer.fast_dev_run:  # type: ignore[attr-defined]
            return
        run = Path(trainer.log_dir or trainer.default_root_dir)  # all processes agree on it together
        self.out = self.folder or run / "predictions"
        if self.out.exists() and not (self.out.is_dir() and not any(self.out.iterdir())):
            raise UserError(f"{self.out}: holds files already; give a new or an empty folder as --predictions.folder")
        self.entries = {}
        if trainer.is_global_zero:
            place = self.out.absolute()
            try:
                place.parent.mkdir(parents=True, exist_ok=True)
                sweep(place.parent, place.name)
                self.own = begin(place)
            except OSError as error:
                raise UserError(f"{self.out}: cannot be written ({error.strerror}); give another folder") from None
        self.part = trainer.strategy.broadcast(self.own.folder if self.own is not None else None)

    def write_on_batch_end(
        self,
        trainer: Trainer,
        pl_module: LightningModule,
        prediction: Any,
        batch_indices: Sequence[int] | None,
        batch: Any,
        batch_idx: int,
        dataloader_idx: int,
    ) -> None:
        """Write the forecasts of one batch."""
        if self.part is None or not isinstance(pl_module, Forecaster):
            return
        data = pl_module.dataset
        forecasts = prediction["forecast"].float().cpu().numpy().astype(self.dtype)
        for index, forecast in zip(prediction["index"].tolist(), forecasts, strict=True):
            place = data.datasets["predict"].places[index]
            entry = window_entry(place.drive, place.start, data.given, data.horizons)
            file = f"{place.drive.name}/{entry['frames'][-1]:010d}.npy"
            try:
                (self.part / file).parent.mkdir(exist_ok=True)
                np.save(self.part / file, forecast, allow_pickle=False)
            except OSError as error:
                raise UserError(f"{self.out}: cannot be written ({error.strerror}); make room") from None
            self.entries[index] = {"file": file, "checksum": zlib.crc32(forecast.tobytes()), **entry}

    def on_predict_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Publish what all processes wrote."""
        if self.part is None or self.out is None or not isinstance(pl_module, Forecaster):
            return
        entries = _gathered(self.entries)
        if self.own is not None:
            about = provenance(pl_module, "predict")
            del about["data"]["windows"]  # the list below says more
            places = pl_module.dataset.datasets["predict"].places
            manifest = {
                "format": FORMAT,
                "what": WHAT,
                **about,
                "given": pl_module.given,
                "dtype": str(self.dtype),
                "drives": {places[k].drive.name: drive_entry(places[k].drive) for k in sorted(entries)},
                "windows": [entries[k] for k in sorted(entries)],
            }
            write_json(self.part / MANIFEST, manifest)
            self.own.publish(self.out)
            rank_zero_info(f"predictions: {len(entries)} windows in {self.out}")
        self.part = self.own = None

    def on_exception(self, trainer: Trainer, pl_module: LightningModule, exception: BaseException) -> None:
        """Leave nothing half done behind."""
        if self.own is not None:
            self.own.discard()
        self.part = self.own = None


def _gathered(entries: dict[int, dict[str, Any]]) -> dict[int, dict[str, Any]]:
    """The entries of all processes."""
    if not torch.distributed.is_initialized():
        return entries
    parts: list[dict[int, dict[str, Any]] | None] = [None] * torch.distributed.get_world_size()
    torch.distributed.all_gather_object(parts, entries)
    return {index: entry for part in parts if part for index, entry in part.items()}

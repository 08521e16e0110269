"""Makes a folder of weights from a training: half precision, what is to be known of them, and their card."""

import hashlib
import inspect
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import envpred.models
from envpred.cli.signatures import summary
from envpred.errors import UserError
from envpred.gate import conform
from envpred.gate.runs import Validation
from envpred.gate.weights import CARD, CONFIG, FORMAT, TENSORS, Config, read_config
from envpred.models.checkpoints import read_checkpoint
from envpred.models.weights import halved
from envpred.report.card import card, measured
from envpred.results.validations import read_validations
from envpred.store.files import replace_text, replaced, write_json


def export(run: Path, name: str, out: Path, results: Sequence[Path]) -> list[str]:
    """Write the weights of a run's best checkpoint into the folder `out`/`name`; returns lines that say so.

    Args:
        run: folder that `envpred fit` wrote.
        name: of the weights.
        out: folder of several.
        results: of tests of these weights and of methods beside them.

    Raises:
        UserError: if the run kept no checkpoint, or a forecaster or variant of one's own; if results are of others, or
            the folder holds other weights.
    """
    validation, checkpoint = _best(run)
    content = halved(checkpoint["state_dict"])
    config = _config(name, validation, checkpoint, content)
    folder = out / name
    conform(config, Config, folder / CONFIG, "give another --name, or train it again with this version")
    if folder.exists() and (not (folder / CONFIG).is_file() or read_config(folder)["sha256"] != config["sha256"]):
        raise UserError(f"{folder}: holds something else already; give another --name or --out, or remove it")
    if results:
        config["horizon_s"], config["measured"] = measured(results, name, config["sha256"])
    folder.mkdir(parents=True, exist_ok=True)
    with replaced(folder / TENSORS) as part:
        part.write_bytes(content)
    write_json(folder / CONFIG, config)
    replace_text(folder / CARD, card(config))
    lines = [f"{folder}: {config['parameters']:,} parameters, {len(content) / 1e6:.2f} MB"]
    if not results:
        lines.append(
            f"next: envpred test --weights {folder} --data.store STORE, and the same command as now with --results of "
            "what that wrote"
        )
    return lines


def _best(run: Path) -> tuple[Validation, dict[str, Any]]:
    """The best checkpoint of a run, and its validation."""
    chosen = read_validations(run).chosen() if run.is_dir() else None
    if chosen is None:
        raise UserError(f"{run}: no run with a best checkpoint; give the folder that `envpred fit` names at its end")
    return chosen.validation, read_checkpoint(run / "checkpoints" / chosen.checkpoint)


def _config(name: str, validation: Validation, checkpoint: dict[str, Any], content: bytes) -> dict[str, Any]:
    """What `config.json` says."""
    kind = str(checkpoint["class_path"]).rpartition(".")[2]
    if kind not in envpred.models.__all__:
        raise UserError(
            f"{checkpoint['class_path']} is no forecaster of envpred, so that nobody else could load its weights; "
            "hand on its checkpoint and its file instead"
        )
    values = checkpoint["hyper_parameters"]
    taken = inspect.signature(getattr(envpred.models, kind)).parameters
    left_out = ("variant", "given", "init_from")
    kept = ("epoch", "val_mse", "static_mse")
    return {
        "format": FORMAT,
        "name": name,
        "about": summary(f"envpred.models.{kind}"),
        "forecaster": kind,
        "init_args": {key: values[key] for key in taken if key in values and key not in left_out},
        "variant": values["variant"],
        "given": values["given"],
        "parameters": sum(tensor.numel() for tensor in checkpoint["state_dict"].values()),
        "sha256": hashlib.sha256(content).hexdigest(),
        "training": {**checkpoint["trained"], **{key: validation[key] for key in kept}},  # type: ignore[literal-required]
        "horizon_s": [],
        "measured": [],
    }

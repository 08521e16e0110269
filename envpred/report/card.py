"""The card of weights: what `config.json` says of them, for people; and what results of tests measured with them."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from envpred.errors import UserError
from envpred.horizons import in_seconds, shown_steps
from envpred.metrics.horizon_mse import HorizonMSE
from envpred.report.run import FloatArray, Run
from envpred.report.runs import read_run, read_runs, result_files
from envpred.report.table import Cell, Table

STATIC, ROLLOUT = "static", "rollout"
DIGITS = 6  # of an error
FEW = 8  # drives that are named one by one


def measured(paths: Sequence[Path], name: str, sha256: str) -> tuple[list[float], list[dict[str, Any]]]:
    """The shown horizons in seconds, and squared errors by drive and method of results of `envpred test`.

    Args:
        paths: results, or folders that hold some, of any number of stores; those of one are of the same windows.
        name: of the weights, which their own results get.
        sha256: of the weights' file, which their own results must tell.

    Raises:
        UserError: if results do not fit together, none is of these weights, or one is of others.
    """
    runs = [read_run(file) for file in result_files(paths)]
    by_store: dict[str, list[Path]] = {}
    for run in runs:
        by_store.setdefault(str(run.data["store_hash"]), []).append(run.file)
    horizons: list[float] = []
    rows = []
    for group in by_store.values():
        compared = read_runs(group, same_inputs=False)
        own = [run for run in compared if run.role == "learned"]
        for run in own:
            told = ((run.record["model"].get("trained") or {}).get("weights") or {}).get("sha256")
            if told != sha256:
                raise UserError(
                    f"{run.file}: was not measured with these weights; test them by `envpred test --weights`, and give "
                    "what that wrote"
                )
        if not own:
            raise UserError(f"{group[0]}: no result of these weights beside it; give one on the same windows")
        steps = [n - 1 for n in shown_steps(len(own[0].horizon_s), float(own[0].horizon_s[0]))]
        shown = [float(own[0].horizon_s[k]) for k in steps]
        if horizons not in ([], shown):
            raise UserError(f"{group[0]}: other horizons than the results before; give results of one kind of grids")
        horizons = shown
        methods = {STATIC: _windows(own[0], "static_mse"), name: _windows(own[0], "mse")}
        methods |= {run.name: _windows(run, "mse") for run in compared if run.role not in ("learned", "static")}
        for drive in dict.fromkeys(own[0].drives):
            chosen = [k for k, other in enumerate(own[0].drives) if other == drive]
            for method, errors in methods.items():
                rows.append(_row(own[0], drive, method, errors[chosen][:, steps]))
    return horizons, rows


def _windows(run: Run, metric: str) -> FloatArray:
    """A metric (W, N) of each window."""
    values = run.metrics[metric].per_window
    assert values is not None  # `read_run` refuses results without
    return values


def _row(run: Run, drive: str, method: str, errors: FloatArray) -> dict[str, Any]:
    """What `config.json` says of the errors (W, N) of a method on a drive."""
    return {
        "store": run.data["store"],
        "store_hash": run.data["store_hash"],
        "drive": drive,
        "windows": len(errors),
        "method": method,
        "mse": [round(float(value), DIGITS) for value in errors.mean(axis=0)],
        "first": [round(float(value), DIGITS) for value in errors[0]],
    }


def card(config: dict[str, Any]) -> str:
    """The card, in Markdown, of what `config.json` says."""
    name, training = config["name"], config["training"]
    data = training["data"]
    wide = f", read on a wide grid of {data['context']} cells" if data["context"] else ""
    reach = f", {in_seconds(config['horizon_s'][-1])} ahead" if config["horizon_s"] else ""
    drives = data["drives"]
    told = ", ".join(drives) if len(drives) <= FEW else f"{drives[0]} to {drives[-1]}"
    minutes, threads = training["seconds"] / 60, training["threads"]
    best, static = (HorizonMSE.factor * training[key] for key in ("val_mse", "static_mse"))
    unit = HorizonMSE.unit
    return "\n".join(
        [
            *("---", "license: mit", "library_name: envpred", "tags: [occupancy grid, LiDAR, forecasting]", "---", ""),
            *(f"# {name}", "", f"{config['about']}", ""),
            *(
                f"* `{config['forecaster']}`, {config['parameters']:,} parameters in half precision; input "
                f"`{config['variant']}`, {config['given']} frames shown{reach}",
                f"* grids of {data['cells']} cells of {data['resolution']:.3g} m every {data['period']:.3g} s{wide}; "
                "others are refused",
                f"* sha256 of `model.safetensors`: `{config['sha256']}`",
                "",
            ),
            *("```", f"envpred test --weights {name} --data.store grids/", "```", ""),
            *("## Training", ""),
            *(
                f"* {len(drives)} drives of a store `{data['store']}` (content {data['store_hash']}): {told}",
                f"* `{training['command']}`",
                f"* seed {training['seed']}, revision {training['revision']}, {minutes:.0f} minutes of wall time with "
                f"{threads} thread{'s' * (threads != 1)}",
                f"* validation of the epoch kept ({training['epoch']}, counted from 0): MSE {unit}, mean of all "
                f"horizons, {best:.1f}; static baseline {static:.1f}",
                "",
            ),
            *("## Measured", ""),
            *(_measured(config) or ["Nothing yet.", ""]),
            *("## What it is not for", ""),
            *(f"* {line}" for line in _limits(config)),
            "",
        ]
    )


def _measured(config: dict[str, Any]) -> list[str]:
    """A table for each store."""
    rows, tables = config["measured"], []
    for store in dict.fromkeys(row["store_hash"] for row in rows):
        own = [row for row in rows if row["store_hash"] == store]
        drives = list(dict.fromkeys(row["drive"] for row in own))
        shown = [{**row, "place": f"{row['drive']}, {row['windows']} windows"} for row in own]
        if len(drives) > 1:
            for method in dict.fromkeys(row["method"] for row in own):
                errors = [row["mse"] for row in own if row["method"] == method]
                mean = np.mean(np.array(errors, np.float64), axis=0).tolist()
                shown.append({"place": f"mean of {len(drives)} drives", "method": method, "mse": mean})
        table = Table(
            "measured",
            f"Store `{own[0]['store']}`: {len(drives)} drive{'s' * (len(drives) != 1)}",
            f"MSE {HorizonMSE.unit} (as a share of the static baseline's). Drives count alike in a mean.",
            ["drive", "method", *map(in_seconds, config["horizon_s"])],
            [_cells(row, _static(shown, row)) for row in shown],
        )
        tables.append(table.markdown())
    return tables


def _static(rows: Sequence[dict[str, Any]], of: dict[str, Any]) -> list[float]:
    """The static baseline's errors where a row was measured."""
    found: list[float] = next(row["mse"] for row in rows if row["method"] == STATIC and row["place"] == of["place"])
    return found


def _cells(row: dict[str, Any], static: Sequence[float]) -> list[Cell]:
    pairs = zip(row["mse"], static, strict=True)
    errors = [f"{HorizonMSE.factor * error:.1f} ({error / below:.2f})" for error, below in pairs]
    return [Cell(row["place"]), Cell(row["method"]), *map(Cell, errors)]


def _limits(config: dict[str, Any]) -> list[str]:
    """What these weights should not be used for, and where the measurements say so."""
    data = config["training"]["data"]
    lines = [
        "Driving, or anything on which somebody's safety depends: it is a research baseline.",
        "Other sensors and mountings than it has seen: a spinning LiDAR of 64 beams on the roof of a car, in towns.",
        f"Grids of another rate, cell or size than every {data['period']:.3g} s, {data['resolution']:.3g} m and "
        f"{data['cells']} cells.",
    ]
    errors = {(row["store_hash"], row["drive"], row["method"]): row["mse"] for row in config["measured"]}
    for method in (STATIC, ROLLOUT):
        worse = []
        for (store, drive, of), own in errors.items():
            beside = errors.get((store, drive, method))
            if of != config["name"] or beside is None:
                continue
            pairs = zip(config["horizon_s"], own, beside, strict=True)
            at = [in_seconds(seconds) for seconds, error, other in pairs if error > other]
            told = "everywhere" if len(at) == len(own) else ", ".join(at)
            worse += [f"{drive} ({told})"] if at else []
        if worse:
            what = "the static baseline" if method == STATIC else "the rollout, for which nothing is trained,"
            lines.append(f"Where {what} errs less: {'; '.join(worse)}.")
    return lines

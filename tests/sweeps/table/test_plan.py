"""The plan of an ablation, and the stores that it builds: what differs from the unchanged run, and nothing else."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest
import yaml

from envpred.build.dogma import build_dogma
from envpred.cli.arguments import FitArguments
from envpred.datamodules.variants import VARIANTS
from envpred.errors import UserError
from envpred.mapping.dogma import DogmaParameters
from envpred.mapping.evidence import EvidenceParameters
from envpred.mapping.mapper import MappingParameters
from envpred.mapping.particle_state import GROUND, ParticleFilterParameters
from envpred.store import Store
from sweeps.table import stores
from sweeps.table.plan import MAIN, SWITCHES, Run, make_plan
from sweeps.table.rollouts import ROLLOUT, ROWS
from tests.build import builds
from tests.drives.synthetic import write_drive
from tests.store.stores import write_store
from tests.sweeps.conftest import SMALL

FIT = [f"--config={SMALL}", "--model.t1_epochs=2", "--model.t5_epochs=4", "--model.t5_drop_epoch=3", "--data.val=[b]"]


def planned(switches: list[str], **options: Any) -> dict[str, Run]:
    given = {"fit": FIT, "tuned": {}, "variants": ["dst_static"], "switches": switches, "seeds": [0]} | options
    return {run.name: run for run in make_plan(**given)}


def changed(name: str) -> dict[str, Any]:
    """What a switch changes of the complete configuration."""
    runs = planned([name])
    variant = SWITCHES[name].variant
    (unchanged,) = (planned([], variants=[variant])[f"{variant}_default_seed0"],)
    one, two = (FitArguments([*run.options, "--data.store=."]).base for run in (unchanged, runs[name]))
    flat = [{**c["data"], **c["model"]["init_args"], **c["trainer"], "seed": c["seed_everything"]} for c in (one, two)]
    return {key: flat[1][key] for key in flat[1] if flat[0][key] != flat[1][key]}


def test_every_variant_is_run_with_every_seed_and_set_of_hyperparameters(tmp_path: Path, fit: FitArguments) -> None:
    best = tmp_path / "best.yaml"
    best.write_text(yaml.safe_dump(fit.complete({"model.channels": [4, 4], "data.samples": 7, "data.val": ["c"]})))
    runs = planned([], variants=list(VARIANTS), seeds=[0, 3], tuned={"dst_dogma": best})
    trained = [run for run in runs.values() if run.trains]
    assert len(trained) == 4 * 2 + 2
    config = FitArguments([*runs["dst_dogma_tuned_seed3"].options, "--data.store=."]).base
    assert config["model"]["init_args"]["channels"] == [4, 4]
    assert (config["data"]["variant"], config["data"]["samples"], config["data"]["seed"]) == ("dst_dogma", 7, 3)
    assert config["seed_everything"] == 3
    assert config["data"]["val"] == ["b"]  # judged as the others are
    assert {run.groups for run in trained} == {("variants",)}
    baseline = FitArguments([*runs["moved_last_frame"].options, "--data.store=."]).base
    assert baseline["model"]["class_path"].endswith("MovedLastFrame")
    assert baseline["data"]["val"] == ["b"]


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("t1_only", {"t1_epochs": 6, "t1_drop_epoch": 6, "t5_epochs": 0}),
        ("t5_only", {"t5_epochs": 6, "t5_drop_epoch": 5, "t1_epochs": 0}),
        ("feedback_current", {"feedback": "current"}),
        ("all_scored", {"first_scored": 1}),
        ("absolute_error", {"t5_error": "absolute"}),
        ("fixed_frame", {"fixed_frame": True}),
        ("fixed_context", {"fixed_frame": True, "context": True}),
        ("ground_velocity", {}),
        ("fewer_particles", {}),
        ("ransac", {}),
        ("context_3", {"given": 3}),
        ("context_10", {"given": 10}),
    ],
)
def test_a_switch_changes_one_thing(name: str, changes: dict[str, Any]) -> None:
    assert changed(name) == changes
    # What changes nothing here changes the grids; the wide grid is both.
    assert (SWITCHES[name].store == MAIN) == (bool(changes) and name != "fixed_context")


def test_more_frames_shown_leave_those_forecast_as_many() -> None:
    runs = planned(["context_3", "context_10"], fit=[*FIT, "--data.length=15"])
    data = {name: FitArguments([*runs[name].options, "--data.store=."]).base["data"] for name in runs}
    lengths = {name: (data[name]["given"], data[name]["length"]) for name in ("context_3", "context_10")}
    assert lengths == {"context_3": (3, 13), "context_10": (10, 20)}


def test_a_switch_is_reported_beside_the_unchanged_run() -> None:
    runs = planned(["t1_only", "feedback_current", "fewer_particles", "ransac"])
    together = {
        group: {name for name, run in runs.items() if group in run.groups}
        for group in ("variants", "network", "velocities", "ransac")
    }
    assert together["variants"] == {"dst_static_default_seed0", "moved_last_frame"}
    assert together["network"] == {"dst_static_default_seed0", "t1_only", "feedback_current"}
    assert together["velocities"] == {"dst_dogma_default_seed0", "fewer_particles"}
    assert together["ransac"] == {"ransac"}


def test_a_row_of_the_rollout_changes_one_thing_of_it() -> None:
    rows = {name: {name.removeprefix("model."): v for name, v in row.changes.items()} for name, row in ROWS.items()}
    runs = planned(list(ROWS))
    configs = {name: FitArguments([*runs[name].options, "--data.store=."]).base for name in [ROLLOUT, *ROWS]}
    unchanged = configs[ROLLOUT]["model"]["init_args"]
    assert (unchanged["futures"], unchanged["world"], unchanged["context"]) == (16, "hits", True)
    assert unchanged["movers"]
    for name, changes in rows.items():
        found = configs[name]["model"]["init_args"]
        if not name.startswith("rollout_corrected"):
            assert {key: value for key, value in found.items() if unchanged[key] != value} == changes
            assert changes
    for name, config in configs.items():
        assert config["data"]["val"] == ["b"]  # judged as the others are
        assert config["data"]["variant"] == "dst_static"
        assert (runs[name].store, runs[name].trains) == (ROLLOUT, name.startswith("rollout_corrected"))
    assert {name for name, run in runs.items() if ROLLOUT in run.groups} == {ROLLOUT, *ROWS, "moved_last_frame"}


def test_the_network_on_top_of_the_rollout_is_trained_for_as_many_steps_as_prednet() -> None:
    runs = planned(["rollout_corrected"], fit=[*FIT, "--data.samples=7"])
    assert {ROLLOUT, "rollout_corrected"} < set(runs)  # beside what it starts from
    config = FitArguments([*runs["rollout_corrected"].options, "--data.store=."]).base
    assert config["model"]["class_path"].endswith("CorrectedRolloutForecaster")
    assert (config["model"]["init_args"]["max_epochs"], config["data"]["samples"]) == (6, 7)
    assert config["model"]["init_args"]["movers"]


def test_what_the_configuration_has_already_is_left_out() -> None:
    names = ["all_scored", "forecasts_scored", "absolute_error", "squared_error", "t5_only", "context_3"]
    assert planned(names).keys() & set(names) == {"all_scored", "absolute_error", "t5_only", "context_3"}
    paper = [*FIT, "--model.first_scored=1", "--model.t5_error=absolute", "--model.t1_epochs=0", "--data.given=3"]
    found = planned(names, fit=[*paper, "--data.length=18"])
    assert found.keys() & set(names) == {"forecasts_scored", "squared_error"}
    told = [*FIT, "--model.fixed_frame=true"]
    assert planned(["fixed_frame", "fixed_context"], fit=told).keys() & set(SWITCHES) == {"fixed_context"}


def test_what_is_not_known_is_refused() -> None:
    with pytest.raises(UserError, match=r"--switches .*there are t1_only"):
        planned(["one"])
    with pytest.raises(UserError, match=r"--variants .*there are dst_static"):
        planned([], variants=["dst"])
    with pytest.raises(UserError, match="give different numbers"):
        planned([], seeds=[1, 1])


def test_another_ground_segmentation_is_all_that_differs(tmp_path: Path) -> None:
    main = Store(tmp_path / "main")
    main.claim("mapping", MappingParameters(evidence=EvidenceParameters(discount=0.8)).as_dict())
    options = stores.command("ransac", main.folder, tmp_path / "ransac", tmp_path)
    assert {"--ground=RansacPlane", "--evidence.discount=0.8", "--grid.cells=128", "--sensor=calibration"} < set(
        options
    )
    assert not any(option.startswith(("--ground.", "--particles", "--dogma")) for option in options)


@pytest.mark.slow
def test_another_filter_is_all_that_differs(tmp_path: Path) -> None:
    main = write_store(tmp_path / "main", {"a": list(range(6)), "b": [*range(3), *range(5, 9)]})
    build_dogma(main, DogmaParameters(ParticleFilterParameters(2000, 200, birth=0.03), tau=5), workers=1)
    before = Store(main)
    for key, changes in (
        ("ground_velocity", asdict(GROUND) | {"persistent": 2000, "births": 200}),
        ("fewer_particles", {"persistent": 200, "births": 20}),
    ):
        folder = tmp_path / key
        assert not stores.is_whole(key, folder, main)
        stores.build(key, main, folder, None)
        assert stores.is_whole(key, folder, main)
        found = Store(folder)
        assert found.parameters("mapping") == before.parameters("mapping")
        given = before.parameters("dogma")
        assert found.parameters("dogma") == given | {"filter": given["filter"] | changes}
        for name, drive in found.drives.items():
            ours, theirs = drive.manifest, before.drives[name].manifest
            assert {k: ours[k] for k in ("frames", "stretches", "lattice")} == {
                k: theirs[k] for k in ("frames", "stretches", "lattice")
            }
            assert ours["arrays"]["evidence"]["checksum"] == theirs["arrays"]["evidence"]["checksum"]
            assert ours["arrays"]["velocity"]["checksum"] != theirs["arrays"]["velocity"]["checksum"]
            drive.verify()


def test_the_rollout_uses_the_store_if_it_has_what_it_needs(tmp_path: Path) -> None:
    drives, out = {"a": list(range(6))}, tmp_path / "stores"
    whole = write_store(tmp_path / "whole", drives, dogma=True, context=32, frame="ground")
    assert stores.folder(ROLLOUT, whole, out) == whole
    stores.check(ROLLOUT, whole, None, False)
    assert stores.is_whole(ROLLOUT, whole, whole)
    relative = write_store(tmp_path / "relative", drives, dogma=True, context=32, frame="ego")
    narrow = write_store(tmp_path / "narrow", drives, dogma=True, frame="ground")
    plain = write_store(tmp_path / "plain", drives, context=32)
    assert {stores.folder(ROLLOUT, main, out) for main in (relative, narrow, plain)} == {out / ROLLOUT}
    stores.check(ROLLOUT, relative, None, False)  # its wide grid can be copied
    stores.check(ROLLOUT, plain, None, False)
    with pytest.raises(
        UserError, match="the store of rollout is mapped from the drives; give their folder as --source"
    ):
        stores.check(ROLLOUT, narrow, None, False)
    stores.check(ROLLOUT, narrow, tmp_path, False)


@pytest.mark.slow
@pytest.mark.parametrize("dogma", [False, True])
def test_the_rollouts_store_has_the_same_grids_and_ground_velocities(tmp_path: Path, dogma: bool) -> None:
    main = write_store(tmp_path / "main", {"a": list(range(5)), "b": [*range(3), *range(5, 8)]}, context=32)
    if dogma:
        build_dogma(main, DogmaParameters(ParticleFilterParameters(2000, 200), tau=5), workers=1)
    folder = tmp_path / "rollout"
    stores.build(ROLLOUT, main, folder, None)
    assert stores.is_whole(ROLLOUT, folder, main)
    before, found = Store(main), Store(folder)
    for group in ("mapping", "context"):
        assert found.parameters(group) == before.parameters(group)
    told = found.parameters("dogma")
    assert told["filter"]["frame"] == "ground"
    assert (told["filter"]["persistent"], told["tau"]) == ((2000, 5) if dogma else (200_000, DogmaParameters().tau))
    for name, drive in found.drives.items():
        for array in ("evidence", "context_evidence", "context_label"):
            checksums = {d.manifest["arrays"][array]["checksum"] for d in (drive, before.drives[name])}
            assert len(checksums) == 1
        assert drive.context == before.drives[name].context
        drive.verify()


@pytest.mark.slow
def test_a_wide_grid_is_mapped_from_the_drives(tmp_path: Path) -> None:
    source, main = tmp_path / "drives", tmp_path / "main"
    write_drive(source, "0001", frames=6, azimuths=90)
    done = builds.run(source, main, "--workers=1", "--ground.cell=0.5")
    assert done.returncode == 0, done.stderr
    stores.build(ROLLOUT, main, tmp_path / "rollout", source)
    assert stores.is_whole(ROLLOUT, tmp_path / "rollout", main)
    before, found = Store(main), Store(tmp_path / "rollout")
    assert found.parameters("mapping") == before.parameters("mapping")
    assert found.parameters("context") == {"cells": 256}
    for name, drive in found.drives.items():
        mine, theirs = (d.manifest["arrays"]["evidence"]["checksum"] for d in (drive, before.drives[name]))
        assert mine == theirs


@pytest.mark.slow
def test_drives_are_mapped_with_ransac(tmp_path: Path) -> None:
    source, main = tmp_path / "drives", tmp_path / "main"
    write_drive(source, "0001", frames=6, azimuths=90)
    done = builds.run(source, main, "--workers=1", "--evidence.discount=0.8")
    assert done.returncode == 0, done.stderr
    stores.build("ransac", main, tmp_path / "ransac", source)
    assert stores.is_whole("ransac", tmp_path / "ransac", main)
    before, ransac = (Store(folder).parameters("mapping") for folder in (main, tmp_path / "ransac"))
    assert ransac.pop("ground")["method"] == "RansacPlane"
    assert ransac == {name: value for name, value in before.items() if name != "ground"}


def test_what_cannot_be_built_is_refused(store: Path, tmp_path: Path) -> None:
    with pytest.raises(UserError, match="give their folder as --source"):
        stores.check("ransac", store, None, False)
    main = Store(tmp_path / "main")
    main.claim("mapping", MappingParameters().as_dict())
    (tmp_path / "empty").mkdir()
    with pytest.raises(UserError, match=r"the store of ransac cannot be built: .*no drive"):
        stores.build("ransac", main.folder, tmp_path / "ransac", tmp_path / "empty")

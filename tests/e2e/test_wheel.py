"""What is installed of envpred, seen from a folder that holds somebody else's `sweeps`."""

import os
import re
import site
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from envpred import FALLBACK_VERSION
from tests.store.stores import write_store

REPOSITORY = Path(__file__).resolve().parents[2]
THEIRS = "raise RuntimeError('this is not what envpred ships')"

pytestmark = pytest.mark.slow


def run(*command: str | Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    """A command to its end, without what points it to a checkout."""
    outside = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "PYTHONHOME")}
    return subprocess.run(command, cwd=cwd, env=outside, capture_output=True, text=True, check=False, timeout=300)


def version_of(wheel: Path) -> str:
    """The version in a wheel's name."""
    return wheel.name.split("-")[1]


def said(*command: str | Path, cwd: Path) -> str:
    """What a command says that goes well."""
    done = run(*command, cwd=cwd)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    said(sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", folder, REPOSITORY, cwd=folder)
    (file,) = folder.glob("*.whl")
    return file


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The programs of an environment that holds the wheel, and sees what it depends on in ours."""
    folder = tmp_path_factory.mktemp("installed")
    said(sys.executable, "-m", "venv", "--without-pip", folder, cwd=folder)
    programs = folder / "bin"
    pip = (sys.executable, "-m", "pip", "--python", programs / "python", "install", "--quiet", "--no-deps")
    said(*pip, wheel, cwd=folder)
    place = said(programs / "python", "-c", "import site; print(site.getsitepackages()[0])", cwd=folder).strip()
    # Links to an editable envpred are not followed from a place that is only named here.
    (Path(place) / "ours.pth").write_text("\n".join(site.getsitepackages()) + "\n")
    return programs


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """What git keeps of the present commit, without git."""
    packed = tmp_path / "tree.tar"
    said("git", "archive", "--output", packed, "HEAD", cwd=REPOSITORY)
    folder = tmp_path / "tree"
    folder.mkdir()
    said("tar", "-xf", packed, cwd=folder)
    return folder


@pytest.fixture
def foreign(tmp_path: Path) -> Path:
    """A folder that holds another package `sweeps`."""
    package = tmp_path / "sweeps"
    package.mkdir()
    for name in ("__init__", "tune", "ablation"):
        (package / f"{name}.py").write_text(THEIRS)
    return tmp_path


def test_a_wheel_holds_one_package_with_everything_that_it_reads(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    assert {name.split("/")[0] for name in names} == {"envpred", f"envpred-{version_of(wheel)}.dist-info"}
    kept = subprocess.run(
        ["git", "ls-files", "envpred", "configs", "sweeps"], cwd=REPOSITORY, capture_output=True, text=True, check=True
    ).stdout.split()
    for file in ("envpred/py.typed", "envpred/mapping/hit_rates.json", "envpred/simulate/traffic.npz"):
        assert file in kept
    assert {f.split("/")[1] for f in kept if f.startswith("sweeps/") and f.endswith(".yaml")} == {"spaces", "presets"}
    missing = [f for f in kept if (f if f.startswith("envpred/") else f"envpred/{f}") not in names]
    assert missing == []
    assert [name for name in names if name.endswith(".pyc")] == []


def test_the_command_and_its_sweeps_are_found_from_anywhere(wheel: Path, installed: Path, foreign: Path) -> None:
    python = installed / "python"
    assert said(installed / "envpred", "--version", cwd=foreign) == f"envpred {version_of(wheel)}\n"
    assert "prednet_small" in said(installed / "envpred", "configs", cwd=foreign)
    for name, command in (("tune", "tune"), ("ablation", "ablate")):
        assert f"usage: envpred {command} " in said(python, "-m", f"envpred.sweeps.{name}", "--help", cwd=foreign)
    found = "from envpred.cli.sweeps import module; print(module('tune').__name__, module('ablation').__file__)"
    name, file = said(python, "-c", found, cwd=foreign).split()
    assert name == "envpred.sweeps.tune"
    assert Path(file).is_relative_to(installed.parent)
    assert "ModuleNotFoundError" in run(python, "-c", "import sweeps", cwd=installed).stderr


def test_the_sweeps_work_with_what_ships(installed: Path, foreign: Path) -> None:
    store = write_store(foreign / "grids", {name: list(range(40)) for name in "abc"}, cells=64, dogma=True)
    python, given = installed / "python", ("--store", store)
    names = ("sweeps/presets/demo.yaml", "sweeps/spaces/prednet.yaml")
    where = "import sys; from envpred.cli.shipped import shipped; print(*map(shipped, sys.argv[1:]))"
    preset, space = said(python, "-c", where, *names, cwd=foreign).split()
    plan = ("--config", preset, "--switches", "[]", "--dry_run", "true")
    assert "5 of 5 runs" in said(python, "-m", "envpred.sweeps.ablation", *given, *plan, cwd=foreign)
    # Both workers' first trials fail, in processes of their own, once the space and its configuration were read.
    study = ("--variant", "dst_static", "--space", space, "--max_failures", "1", "--workers", "2")
    done = run(python, "-m", "envpred.sweeps.tune", *given, *study, "--trainer.devices", "0", cwd=foreign)
    assert done.returncode == 1
    assert re.match("envpred tune: the last . trials of the study prednet_dst_static failed", done.stderr)


def test_the_version_is_that_of_the_tag(tree: Path, tmp_path: Path) -> None:
    """Without git it is the fallback; with an untagged commit a development release behind that; then the tag's."""
    built = []
    git = ("git", "-c", "user.name=a", "-c", "user.email=a@b.c")

    def build(name: str) -> None:
        wheels = tmp_path / name
        said(sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", wheels, tree, cwd=tmp_path)
        built.append(version_of(next(wheels.glob("*.whl"))))

    build("plain")
    for command in (("init", "--quiet"), ("add", "--all"), ("commit", "--quiet", "--message=all")):
        said(*git, *command, cwd=tree)
    build("untagged")
    said(*git, "tag", "v3.2.1", cwd=tree)
    build("tagged")
    plain, untagged, tagged = built
    assert plain == FALLBACK_VERSION
    assert re.fullmatch(r"\d+\.\d+\.\d+\.dev1\+g[0-9a-f]+", untagged)
    assert tagged == "3.2.1"


def test_a_drive_becomes_a_recording_outside_of_a_checkout(installed: Path, tmp_path: Path) -> None:
    """From simulated scans to what a planner reads, with what the wheel alone brings."""
    program = installed / "envpred"
    said(program, "simulate", "drives", "--drives=1", "--frames=8", "--seed=3", "--workers=1", cwd=tmp_path)
    said(program, "grids", "--source=drives", "--store=grids", "--workers=1", "--context=192", cwd=tmp_path)
    predict = ("--config=rollout_static", "--data.store=grids", "--data.predict=newest", "--predictions.folder=newest")
    said(program, "predict", *predict, cwd=tmp_path)
    given = ("--predictions=newest", "--store=grids", "--source=drives")
    assert "1 forecasts" in said(program, "bag", "--out=drive.mcap", *given, cwd=tmp_path)
    assert (tmp_path / "drive.mcap").read_bytes().startswith(b"\x89MCAP0\r\n")

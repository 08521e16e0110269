# Every target works on a fresh machine: it makes the virtual environment it needs.
# PYTHON: any Python from 3.11 on.  VENV: where the environment lies.  OLDEST: where that of the
# oldest releases lies, whose torch brings CUDA's libraries along on Linux (6 GB on the disk).
# N: how many times as many faults `make faults` tries as the slow tests do.
# KITTI: a folder of real drives for the demo and the paper; without it they simulate their own.
PYTHON ?= python3
VENV ?= .venv
OLDEST ?= .venv-oldest
DEMO ?= demo
PAPER ?= paper
KITTI ?=
N ?= 20
BIN := $(VENV)/bin

.PHONY: install test slow faults messages oldest lint docs bench paper demo clean

install: $(VENV)/.installed

$(VENV)/.installed: pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "envpred needs Python 3.11 or newer; say make PYTHON=python3.11")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --constraint constraints.txt --editable '.[dev]'
	touch $@

test: install
	$(BIN)/python -m pytest

slow: install
	$(BIN)/python -m pytest -m slow

# Kills long commands and damages files, N times as often as `make slow`.
faults: install
	ENVPRED_FAULTS=$(N) $(BIN)/python -m pytest -m slow tests/faults

# After test and slow: every message of UserError was provoked, and the commands that it names were run.
messages: install
	$(BIN)/python -m tests.user_errors

# The suite with the oldest release of everything that pyproject.toml allows.
oldest: $(OLDEST)/.installed
	$(OLDEST)/bin/python -m pytest

$(OLDEST)/.installed: pyproject.toml constraints-oldest.txt
	$(PYTHON) -m venv $(OLDEST)
	$(OLDEST)/bin/pip install --quiet --constraint constraints-oldest.txt --editable '.[test]'
	touch $@

lint: install
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy

# The pages, in docs/_build/html; a warning is an error.
docs: install
	$(BIN)/sphinx-build -q -W --keep-going -b html docs docs/_build/html

bench: install
	$(BIN)/pip install --quiet --constraint constraints.txt --editable '.[bench]'
	$(BIN)/python -m benchmarks.mapping
	$(BIN)/python -m benchmarks.datamodule
	$(BIN)/python -m benchmarks.prednet --threads 2
	$(BIN)/python -m benchmarks.particles --threads 2

# The paper's tables and figures, on simulated drives or on those in KITTI.
paper: install
	$(BIN)/envpred paper --out "$(PAPER)" $(if $(KITTI),--source "$(KITTI)")

demo: install
	PATH="$(abspath $(BIN)):$$PATH" DEMO="$(DEMO)" KITTI="$(KITTI)" bash demo.sh

clean:
	rm -rf $(VENV) $(OLDEST) docs/_build .mypy_cache .ruff_cache .pytest_cache .hypothesis

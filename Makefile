# Everything runs in .venv, which each target makes itself with python3 and pip alone. The programs there are run by
# "python -m", as scripts do not start in a folder whose path has a space.
PYTHON ?= python3
BIN := .venv/bin
PIP := -m pip install --disable-pip-version-check

.PHONY: demo demo-robot readme-picture demo-cell docs test test-base test-slow test-train test-cell test-peers test-robot test-view fuzz lint dist clean

demo: .venv/sim
	$(BIN)/python -m reorient demo --out out/demo

readme-picture: demo
	cp out/demo/loop.gif docs/demo.gif

test: .venv/dev
	$(BIN)/python -m pytest -n auto -m "not slow"

test-base:  # size, import time and first result of the install without extras
	$(PYTHON) benchmarks/install_size.py out/base

test-slow: .venv/dev
	$(BIN)/python -m pytest -n auto -m slow

test-train: .venv/train
	$(BIN)/python -m pytest tests/train

demo-robot: .venv/robot/ready
	.venv/robot/bin/python benchmarks/franka_loops.py out/robot

demo-cell: .venv/cell
	$(BIN)/python -m reorient cell out/cell --objects 3 --trials 1

test-cell: .venv/cell
	$(BIN)/python -m pytest tests/cell

test-peers: .venv/peers
	$(BIN)/python -m pytest tests/peers

test-robot: .venv/robot/ready
	.venv/robot/bin/python -m pytest tests/robot

docs: .venv/docs  # out/site/index.html, which opens from the disk
	$(BIN)/python -m mkdocs build --strict --quiet

lint: .venv/dev
	$(BIN)/python -m ruff check .
	$(BIN)/python -m ruff format --check .
	$(BIN)/python -m mypy

test-view: .venv/view
	$(BIN)/python -m pytest tests/view

# Mutated files for every reader: make fuzz COUNT=5000 for a hundred thousand inputs.
COUNT ?= 500
fuzz: .venv/train
	PYTHONPATH=benchmarks $(BIN)/python benchmarks/fuzz.py --count $(COUNT)

dist: .venv/dev
	rm -rf dist
	$(BIN)/python -m hatchling build --directory dist

.venv/made:
	@echo "Making a Python environment in .venv ..."
	$(PYTHON) -m venv .venv
	@touch $@

EXTRAS_sim := sim
EXTRAS_dev := dev
EXTRAS_train := dev,train,cluster,s3,s3-tests
EXTRAS_docs := docs
EXTRAS_cell := dev,cell
EXTRAS_peers := dev,peers
EXTRAS_view := dev,view,view-tests

.venv/%: pyproject.toml | .venv/made
	@echo "Installing reorient[$(EXTRAS_$*)] into .venv, once; this takes a minute or more ..."
	$(BIN)/python $(PIP) --editable '.[$(EXTRAS_$*)]'
	@touch $@

# An environment of its own: the wheels of ROS start each Python of theirs anew, with another library path.
.venv/robot/ready: pyproject.toml
	@echo "Making a Python environment in $(@D) ..."
	$(PYTHON) -m venv $(@D)
	$(@D)/bin/python $(PIP) \
		--editable '.[dev,realsense,franka,franka-sim,ur,abb,ros2]'
	touch $@

clean:
	rm -rf .venv out dist

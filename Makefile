# Everything runs in .venv, which each target makes itself with python3 and pip alone.
PYTHON ?= python3
BIN := .venv/bin

.PHONY: demo demo-robot readme-picture demo-cell test test-slow test-train test-cell test-peers test-robot test-view fuzz lint clean

demo: .venv/base
	$(BIN)/reorient demo --out out/demo

readme-picture: demo
	cp out/demo/loop.gif docs/demo.gif

test: .venv/dev
	$(BIN)/pytest -n auto -m "not slow"

test-slow: .venv/dev
	$(BIN)/pytest -n auto -m slow

test-train: .venv/train
	$(BIN)/pytest tests/train

demo-robot: .venv/robot/ready
	.venv/robot/bin/python benchmarks/franka_loops.py out/robot

demo-cell: .venv/cell
	$(BIN)/reorient cell out/cell --objects 3 --trials 1

test-cell: .venv/cell
	$(BIN)/pytest tests/cell

test-peers: .venv/peers
	$(BIN)/pytest tests/peers

test-robot: .venv/robot/ready
	.venv/robot/bin/pytest tests/robot

lint: .venv/dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

test-view: .venv/view
	$(BIN)/pytest tests/view

# Mutated files for every reader: make fuzz COUNT=5000 for a hundred thousand inputs.
COUNT ?= 500
fuzz: .venv/train
	PYTHONPATH=benchmarks $(BIN)/python benchmarks/fuzz.py --count $(COUNT)

.venv/base: pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable .
	touch $@

# The other environments add extras to the base.
EXTRAS_dev := dev
EXTRAS_train := dev,train,cluster,s3,s3-tests
EXTRAS_cell := dev,cell
EXTRAS_peers := dev,peers
EXTRAS_view := dev,view,view-tests

.venv/%: .venv/base
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[$(EXTRAS_$*)]'
	touch $@

# An environment of its own: the wheels of ROS start each Python of theirs anew, with another library path.
.venv/robot/ready: pyproject.toml
	$(PYTHON) -m venv $(@D)
	$(@D)/bin/python -m pip install --quiet --disable-pip-version-check \
		--editable '.[dev,realsense,franka,franka-sim,ur,abb,ros2]'
	touch $@

clean:
	rm -rf .venv out

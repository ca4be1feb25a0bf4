# Everything runs in .venv, which each target makes itself with python3 and pip alone.
PYTHON ?= python3
BIN := .venv/bin

.PHONY: demo demo-cell test test-train test-cell test-peers lint clean

demo: .venv/base
	$(BIN)/reorient demo --out out/demo

test: .venv/dev
	$(BIN)/pytest -n auto

test-train: .venv/train
	$(BIN)/pytest tests/train

demo-cell: .venv/cell
	$(BIN)/reorient cell out/cell --objects 3 --trials 1

test-cell: .venv/cell
	$(BIN)/pytest tests/cell

test-peers: .venv/peers
	$(BIN)/pytest tests/peers

lint: .venv/dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

.venv/base: pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable .
	touch $@

.venv/dev: .venv/base
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	touch $@

.venv/train: .venv/dev
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[train,cluster]'
	touch $@

.venv/cell: .venv/dev
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev,cell]'
	touch $@

.venv/peers: .venv/dev
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev,peers]'
	touch $@

clean:
	rm -rf .venv out

# Everything runs in .venv, which each target makes itself with python3 and pip alone.
PYTHON ?= python3
BIN := .venv/bin

.PHONY: demo test test-train lint clean

demo: .venv/base
	$(BIN)/reorient demo --out out/demo

test: .venv/dev
	$(BIN)/pytest -n auto

test-train: .venv/train
	$(BIN)/pytest tests/train

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

clean:
	rm -rf .venv out

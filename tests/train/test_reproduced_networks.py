"""The figures that train their own networks, from pairs to pages, at tiny size."""

from dataclasses import replace

import pytest
import torch

from reorient.cli import main
from reorient.learning.network import build
from reorient.learning.recipes import load_preset
from reorient.learning.weights import load_weights
from reorient.reporting.rows import read_table
from reorient.reproducing import full, networks, non_symmetric
from reorient.reproducing.figure import load_figure
from reorient.world.objects import generated


@pytest.fixture
def tiny(tmp_path, monkeypatch):
    """Tiny sets and trainings; returns what the command is told."""
    monkeypatch.setattr(networks, "RECIPE", replace(load_preset("debug"), batch=4))
    for module in (non_symmetric, full):
        monkeypatch.setattr(module, "PAIRS_PER_OBJECT", 3)
        monkeypatch.setattr(module, "PAIRS", 4)
        monkeypatch.setattr(module, "EPOCHS", 2)
        monkeypatch.setattr(module, "FEW_EPOCHS", 1)
    monkeypatch.setattr(non_symmetric, "SPLITS", {"train 5, test 3": 3})
    monkeypatch.setattr(full, "COUNT", 8)
    (tmp_path / "lists").mkdir()
    names = generated(110, 2021).names[:8]
    (tmp_path / "lists" / "non-symmetric.txt").write_text("".join(f"{name}\n" for name in names))
    folders = [x for key in ("data", "out", "lists") for x in (f"--{key}", str(tmp_path / key))]
    return [*folders, "--workers", "1"]


def test_non_symmetric(tiny, tmp_path, capsys):
    main(["reproduce", "non-symmetric", *tiny])
    said = capsys.readouterr().out
    assert "train 5, test 3, hybrid, 2 epochs: mean error" in said
    assert "5.76°" in said
    folder = tmp_path / "out" / "non-symmetric"
    rows = read_table(folder / "train-5-test-3" / "rows.csv.gz", ["estimator"])
    assert len(rows) == 4 * (4 + 5)
    assert {row["object"] for row in rows} <= set((folder / "train-5-test-3" / "objects.txt").read_text().split())
    assert sorted(path.name for path in (folder / "training").iterdir()) == [
        f"non-symmetric-3-{loss}-{epochs}.csv" for loss in ("hybrid", "mean") for epochs in (1, 2)
    ]
    for name in ("report.html", "error-against-angle.png", "error-histograms.png", "numbers.csv"):
        assert (folder / name).is_file()
    main(["reproduce", "non-symmetric", "--quick", *tiny])  # the short trainings of the whole figure serve again
    said = capsys.readouterr().out
    assert "non-symmetric: holds" in said or "non-symmetric: DOES NOT HOLD" in said
    runs = {path.name for path in (tmp_path / "data" / "runs").iterdir()}
    assert runs == {f"non-symmetric-3-{loss}-{epochs}" for loss in ("hybrid", "mean") for epochs in (1, 2)}


def test_full(tiny, tmp_path, capsys):
    main(["reproduce", "full", *tiny])
    said = capsys.readouterr().out
    assert "shapematch, 2 epochs: mean absolute real part" in said
    assert "hybrid (shipped): mean error less that of mean, 2 epochs" in said
    last = torch.load(tmp_path / "data" / "runs" / "full-shapematch-2" / "last.ckpt", weights_only=True)["network"]
    measured = build(networks.RECIPE.network)
    load_weights(
        measured, tmp_path / "data" / "weights" / "full-shapematch-2.onnx"
    )  # not the best, but what it came to
    for key, value in measured.named_parameters():
        torch.testing.assert_close(value.float(), last[key].float(), rtol=1e-3, atol=1e-4)
    folder = tmp_path / "out" / "full"
    shapes = read_table(folder / "shapes.csv.gz", ["shape_match", "raw_real"])
    learned = [row for row in shapes if row["estimator"].endswith(".onnx") or row["estimator"] == "paper"]
    assert all(-1 <= float(row["raw_real"]) <= 1 for row in learned)
    assert all(row["raw_real"] == "" for row in shapes if row not in learned)
    assert all(0 <= float(row["shape_match"]) < 1 for row in shapes)
    nothing = [float(row["shape_match"]) for row in shapes if row["estimator"].endswith("Nothing")]
    gicp = [float(row["shape_match"]) for row in shapes if row["estimator"] == "gicp"]
    assert sum(gicp) < sum(nothing)
    before = (folder / "rows.csv.gz").read_bytes()
    main(["reproduce", "full", *tiny])
    assert (folder / "rows.csv.gz").read_bytes() == before
    assert load_figure("full") is full

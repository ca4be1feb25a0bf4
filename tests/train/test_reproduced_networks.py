"""The figures that train their own networks, from pairs to pages, at tiny size."""

from dataclasses import replace

import pytest
import torch

from reorient.learning.network import build
from reorient.learning.recipes import load_preset
from reorient.learning.weights import load_weights
from reorient.reporting.rows import read_table
from reorient.reproducing.findings import held
from reorient.reproducing.full import Full
from reorient.reproducing.making import reproduce
from reorient.reproducing.non_symmetric import NonSymmetric
from reorient.reproducing.setting import Setting
from reorient.world.objects import generated

RECIPE = replace(load_preset("debug"), batch=4)
NON_SYMMETRIC = NonSymmetric(
    pairs_per_object=3, pairs=4, epochs=2, few_epochs=1, splits={"train 5, test 3": 3}, recipe=RECIPE
)
FULL = Full(count=8, pairs_per_object=3, pairs=4, epochs=2, few_epochs=1, recipe=RECIPE)


@pytest.fixture
def setting(tmp_path):
    (tmp_path / "lists").mkdir()
    names = generated(110, 2021).names[:8]
    (tmp_path / "lists" / "non-symmetric.txt").write_text("".join(f"{name}\n" for name in names))
    return Setting(*(tmp_path / key for key in ("data", "out", "lists")))


def test_non_symmetric(setting, tmp_path, capsys):
    reproduce(NON_SYMMETRIC, setting)
    text = capsys.readouterr().out
    assert "train 5, test 3, hybrid, 2 epochs: mean error" in text
    assert "5.76°" in text
    folder = tmp_path / "out" / "non-symmetric"
    rows = read_table(folder / "train-5-test-3" / "rows.csv.gz", ["estimator"])
    assert len(rows) == 4 * (4 + 5)
    assert {row["object"] for row in rows} <= set((folder / "train-5-test-3" / "objects.txt").read_text().split())
    assert sorted(path.name for path in (folder / "training").iterdir()) == [
        f"non-symmetric-3-{loss}-{epochs}.csv" for loss in ("hybrid", "mean") for epochs in (1, 2)
    ]
    for name in ("report.html", "error-against-angle.png", "error-histograms.png", "numbers.csv"):
        assert (folder / name).is_file()
    part = replace(setting, share=0.1)
    reproduce(NON_SYMMETRIC, part)  # the short trainings of the whole figure serve again
    text = capsys.readouterr().out
    findings = {f.what: f for f in NON_SYMMETRIC.findings(setting.folder("non-symmetric"))}
    compared = [(f, findings[f.what]) for f in NON_SYMMETRIC.findings(part.folder("non-symmetric"))]
    agree = sum(bool(held(one, whole)) for one, whole in compared)
    assert f": {agree} of {len(compared)} numbers agree" in text
    assert text.count("\n  differs: ") == len(compared) - agree
    runs = {path.name for path in (tmp_path / "data" / "runs").iterdir()}
    assert runs == {f"non-symmetric-3-{loss}-{epochs}" for loss in ("hybrid", "mean") for epochs in (1, 2)}


def test_full(setting, tmp_path, capsys):
    reproduce(FULL, setting)
    text = capsys.readouterr().out
    assert "shapematch, 2 epochs: mean absolute real part" in text
    assert "hybrid (shipped): mean error less that of mean, 2 epochs" in text
    last = torch.load(tmp_path / "data" / "runs" / "full-shapematch-2" / "last.ckpt", weights_only=True)["network"]
    measured = build(RECIPE.network)
    load_weights(
        measured, tmp_path / "data" / "weights" / "full-shapematch-2.onnx"
    )  # not the best, but what it came to
    for key, value in measured.named_parameters():
        torch.testing.assert_close(value.float(), last[key].float(), rtol=1e-3, atol=1e-4)
    folder = tmp_path / "out" / "full"
    shapes = read_table(folder / "shapes" / "rows.csv.gz", ["shape_match", "raw_real"])
    learned = [row for row in shapes if row["estimator"].endswith(".onnx") or row["estimator"] == "paper"]
    assert all(-1 <= float(row["raw_real"]) <= 1 for row in learned)
    assert all(row["raw_real"] == "" for row in shapes if row not in learned)
    assert all(0 <= float(row["shape_match"]) < 1 for row in shapes)
    nothing = [float(row["shape_match"]) for row in shapes if row["estimator"].endswith("Nothing")]
    gicp = [float(row["shape_match"]) for row in shapes if row["estimator"] == "gicp"]
    assert sum(gicp) < sum(nothing)
    before = (folder / "rows.csv.gz").read_bytes()
    reproduce(FULL, setting)
    assert (folder / "rows.csv.gz").read_bytes() == before

"""The ablation: variants share pairs and sets of hypotheses, and are compared pair by pair."""

import numpy as np
import pytest
import stages
from stages import VARIANTS, Stages, markdown, verdict

from reorient.errors import ReorientError
from reorient.experiments.evaluation import Evaluation
from reorient.world.objects import ObjectSource


def rows_of(right: dict[str, list[bool]], low_deg: str = "30") -> list[dict[str, str]]:
    return [
        {"estimator": name, "object": f"o{index // 2}", "pair": str(index), "low_deg": low_deg, "high_deg": "60"}
        | {"error_sym_deg": "1" if hit else "90", "seconds": "0.05"}
        for name, hits in right.items()
        for index, hit in enumerate(hits)
    ]


def test_differences_are_paired():
    verifier = [True] * 15 + [False] * 5
    score = [True] * 10 + [False] * 9 + [True]
    lines = markdown(rows_of({"verifier": verifier, "score": score})).splitlines()
    assert len(lines) == 2 + 2 * 2
    assert lines[2] == "| 30–60° | verifier | 20 | 75.0% (53.1–88.8) |  |  |  | 50 |"
    cells = [cell.strip() for cell in lines[3].split("|")[1:-1]]
    assert cells[:4] == ["30–60°", "score", "20", "55.0% (34.2–74.2)"]
    assert cells[4].startswith("-20.0 (")
    assert cells[5] == "1 / 5"
    assert float(cells[6]) == 0.22  # 2 P(at most 1 of 6 fair tosses)
    assert lines[5].startswith("| all | score |")


def test_the_interval_is_over_objects():
    hits = np.arange(80) % 4 < 2  # both pairs of an object alike
    low, high = stages._bootstrapped(hits.astype(float), np.arange(80) // 2)
    alone, to = stages._bootstrapped(hits.astype(float), np.arange(80))
    assert low < 50 < high
    assert (high - low) / (to - alone) == pytest.approx(np.sqrt(2), abs=0.15)


def test_the_verdict():
    many = {"verifier": [True] * 900 + [False] * 100, "score": [True] * 800 + [False] * 200}
    assert verdict(rows_of(many)).endswith("the intervals are apart")
    few = {name: hits[::50] for name, hits in many.items()}
    assert verdict(rows_of(few)).endswith("the intervals overlap")


def test_a_small_ablation(tmp_path, capsys):
    names = ("default", "verifier", "score", "oracle", "oracle of 2")
    config = Evaluation(ObjectSource(count=1), names, ranges_deg=((30, 60),), noise_mm=(1.0,), pairs=1, pivot=True)
    stages.main(Stages(tmp_path / "run", config))
    text = capsys.readouterr().out
    assert [line.split(" | ")[1] for line in text.splitlines() if line.startswith("| 30–60°")] == list(names)
    rows = {row["estimator"]: float(row["error_sym_deg"]) for row in stages.read_rows(tmp_path / "run")}
    assert rows["oracle"] <= min(rows["verifier"], rows["score"], rows["oracle of 2"])
    stages.main(Stages(tmp_path / "run", config, also=(tmp_path / "run",)))
    assert "| 30–60° | verifier | 2 |" in capsys.readouterr().out
    fewer = Evaluation(
        ObjectSource(count=1), ("verifier",), ranges_deg=((30, 60),), noise_mm=(1.0,), pairs=1, pivot=True
    )
    with pytest.raises(ReorientError, match="has other variants: expected verifier"):
        stages.main(Stages(tmp_path / "other", fewer, also=(tmp_path / "run",)))
    assert set(names[1:]) <= set(VARIANTS)

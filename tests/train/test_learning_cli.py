"""The learning verbs from end to end on tiny data."""

import pytest
import trimesh

from reorient.cli import main


def ended(arguments, capsys):
    """Exit code and what was said on standard error."""
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    return stop.value.code, capsys.readouterr().err


def test_generate_train_export_on_own_meshes(tmp_path, capsys):
    """As a user fine-tunes on objects of his own."""
    (tmp_path / "meshes").mkdir()
    for i in range(6):
        trimesh.creation.box((1, 0.3 + 0.1 * i, 0.5)).export(tmp_path / "meshes" / f"{i}.stl")
    pairs, run, onnx = (str(tmp_path / name) for name in ("pairs", "run", "out.onnx"))
    main(["generate", pairs, "--meshes", str(tmp_path / "meshes"), "--pairs-per-object", "4", "--workers", "1"])
    assert "24 pairs: about" in capsys.readouterr().out
    main(["train", pairs, run, "debug", "--epochs", "1"])
    said = capsys.readouterr().out
    assert "epoch 1: loss" in said
    assert "(best)" in said
    main(["export", f"{run}/best.safetensors", onnx, "--compact"])
    main(["train", "--warm-start", onnx, pairs, str(tmp_path / "again"), "debug", "--epochs", "1"])
    assert (tmp_path / "again" / "best.safetensors").is_file()


def test_bad_input_is_one_line_and_code_2(tmp_path, small_set, capsys):
    code, said = ended(["train", str(tmp_path / "nothing"), str(tmp_path / "run"), "debug"], capsys)
    assert code == 2
    assert "no pairs in" in said
    assert not (tmp_path / "run").exists()
    code, said = ended(["generate", str(tmp_path / "pairs"), "--low-deg", "40"], capsys)
    assert code == 2
    assert "--high-deg 30: expected a number from 40 to 180" in said
    code, said = ended(["generate", str(tmp_path / "pairs"), "--workers", "0"], capsys)
    assert code == 2
    assert "--workers 0: expected at least 1" in said
    code, said = ended(["export", str(tmp_path / "no.safetensors"), str(tmp_path / "out.onnx")], capsys)
    assert code == 2
    assert "cannot load weights" in said
    code, said = ended(["generate", str(small_set), "--count", "3"], capsys)
    assert code == 2
    assert "holds other pairs" in said

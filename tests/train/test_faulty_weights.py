"""Exported weights that are no network of ours, or state nonsense: one line each, before or in the first estimate."""

import fuzz_targets
import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper

from reorient.errors import ReorientError
from reorient.estimators import load_estimator


@pytest.fixture
def model():
    return onnx.load_from_string(fuzz_targets._onnx_seeds()[0]["weights.onnx"])


def estimated(model, path):
    path.write_bytes(model.SerializeToString())
    image = fuzz_targets._image()
    return load_estimator(str(path)).estimate(image, image)


def test_the_network_itself_is_read(model, tmp_path):
    assert estimated(model, tmp_path / "a.onnx").R_goal_current.shape == (3, 3)


@pytest.mark.parametrize("rounds", ["x", "", "-1", "0", "1e9", "1000000000", "9" * 5000, "٣", "2.5"])
def test_rounds_that_are_no_small_number_are_refused(rounds, model, tmp_path):
    helper.set_model_props(model, {"rounds": rounds})
    with pytest.raises(ReorientError, match="rounds: expected a whole number from 1 to 20"):
        estimated(model, tmp_path / "a.onnx")


def test_another_type_of_input_is_refused(model, tmp_path):
    model.graph.input[0].type.tensor_type.elem_type = TensorProto.DOUBLE
    cast = helper.make_node("Cast", ["images"], ["cast"], to=TensorProto.FLOAT)
    model.graph.node[0].input[0] = "cast"
    model.graph.node.insert(0, cast)
    with pytest.raises(ReorientError, match="holds another network, of .*double"):
        estimated(model, tmp_path / "a.onnx")


def test_a_node_that_fails_is_one_line(model, tmp_path):
    """A shape that only the run can refuse."""
    shape = onnx.numpy_helper.from_array(np.array([-1, 5], np.int64), "shape")
    model.graph.initializer.append(shape)
    last = model.graph.node[1]
    last.CopyFrom(helper.make_node("Reshape", ["mean", "shape"], ["flat"]))
    with pytest.raises(ReorientError, match="expected") as refusal:
        estimated(model, tmp_path / "a.onnx")
    assert len(str(refusal.value).splitlines()) == 1


@pytest.mark.parametrize("value", [0.0, np.nan])
def test_answers_that_are_no_quaternions_are_refused(value, model, tmp_path):
    for initializer in model.graph.initializer:
        array = np.full_like(onnx.numpy_helper.to_array(initializer), value)
        initializer.CopyFrom(onnx.numpy_helper.from_array(array, initializer.name))
    with pytest.raises(ReorientError, match="returns no quaternions"):
        estimated(model, tmp_path / "a.onnx")

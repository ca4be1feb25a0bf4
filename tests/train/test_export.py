"""Exported weights give what torch gives."""

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from safetensors.torch import save_file

from reorient import so3
from reorient.errors import ReorientError
from reorient.estimators import load_estimator
from reorient.learning.export import export
from reorient.learning.network import build


@pytest.fixture(params=["paper", "swift"])
def network(request, tmp_path):
    """A network with batch-norm statistics of its own, and its weights on disk."""
    torch.manual_seed(0)
    model = build(request.param)
    model.train()
    with torch.no_grad():
        for _ in range(3):
            model(torch.rand(8, 2, 128, 128))
    save_file(model.state_dict(), tmp_path / "weights.safetensors")
    return request.param, model.eval(), tmp_path / "weights.safetensors"


@pytest.mark.parametrize(("compact", "tolerance"), [(False, 1e-4), (True, 5e-3)])
def test_onnx_answers_as_torch_does(network, compact, tolerance, tmp_path):
    name, model, weights = network
    export(name, weights, tmp_path / "out.onnx", compact)
    session = onnxruntime.InferenceSession(tmp_path / "out.onnx")
    images = torch.rand(5, 2, 128, 128)
    with torch.inference_mode():
        expected = model(images).numpy()
    answer = session.run(None, {"images": images.numpy()})[0]
    assert np.abs(answer - expected).max() < tolerance
    one = session.run(None, {"images": images[:1].numpy()})[0]
    assert so3.angle_between(one[0].astype(float), expected[0].astype(float)) < 2 * tolerance
    assert load_estimator(str(tmp_path / "out.onnx"))._rounds == (3 if name == "swift" else 1)
    size = (tmp_path / "out.onnx").stat().st_size
    assert size < (20e6 if compact else 40e6)


def test_weights_of_another_network_are_refused(network, tmp_path):
    name, _, weights = network
    other = "swift" if name == "paper" else "paper"
    with pytest.raises(ReorientError, match="expected the network's own"):
        export(other, weights, tmp_path / "out.onnx")
    assert not (tmp_path / "out.onnx").exists()


def test_another_network_is_no_estimator(tmp_path):
    values = [onnx.helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, ["n", 3]) for name in ("x", "y")]
    graph = onnx.helper.make_graph([onnx.helper.make_node("Identity", ["x"], ["y"])], "other", values[:1], values[1:])
    opset = onnx.helper.make_opsetid("", 17)
    onnx.save(onnx.helper.make_model(graph, opset_imports=[opset], ir_version=8), tmp_path / "other.onnx")
    with pytest.raises(ReorientError, match="holds another network, .* expected .*what `reorient export` wrote"):
        load_estimator(str(tmp_path / "other.onnx"))

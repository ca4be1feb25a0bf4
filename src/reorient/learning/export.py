"""Export of trained weights to ONNX: exact in float32, or compact with float16 weights."""

from pathlib import Path

import numpy as np
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper

from reorient.estimators.learned import SWIFT_ROUNDS
from reorient.learning.network import build
from reorient.learning.recipes import NetworkName
from reorient.learning.weights import HALF, load_weights
from reorient.runs.files import replacing


def export(network: NetworkName, weights: Path, out: Path, compact: bool = False) -> None:
    """Write ``out`` (.onnx): images (n, 2, 128, 128) float32 in, quaternions (n, 4) out.

    ``compact``: weights are stored as float16 and converted when loaded; the arithmetic is float32. Raises
    ReorientError for weights of another network.
    """
    model = build(network).eval()
    load_weights(model, weights)
    program = torch.onnx.export(
        model,
        (torch.zeros(2, 2, 128, 128),),
        input_names=["images"],
        output_names=["quat_wxyz"],
        dynamic_shapes=({0: torch.export.Dim("n")},),
        dynamo=True,
        optimize=False,  # keeps batch norm as a node, so that a training can start from the file; the runtime fuses it
        verbose=False,
    )
    assert program is not None
    proto = program.model_proto
    if network == "swift":
        proto.metadata_props.add(key="rounds", value=str(SWIFT_ROUNDS))
    if compact:
        _store_as_float16(proto)
    with replacing(out) as temporary:
        onnx.save(proto, temporary)


def _store_as_float16(proto: onnx.ModelProto) -> None:
    """Convert large float32 initialisers to float16, each followed by a cast."""
    graph = proto.graph
    casts = []
    for tensor in graph.initializer:
        values = numpy_helper.to_array(tensor)
        if tensor.data_type == TensorProto.FLOAT and values.size > 1000:
            name = tensor.name
            tensor.CopyFrom(numpy_helper.from_array(values.astype(np.float16), name + HALF))
            casts.append(helper.make_node("Cast", [name + HALF], [name], to=TensorProto.FLOAT))
    for cast in reversed(casts):
        graph.node.insert(0, cast)

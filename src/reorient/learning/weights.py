"""Weights of a network in files: of a run, of a checkpoint, of an export."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import onnx
import torch
from onnx import numpy_helper
from safetensors.torch import load_file
from torch import Tensor, nn

from reorient.errors import ReorientError, in_short

HALF = "_half"  # suffix of weights that an export stores as float16


def load_weights(network: nn.Module, path: Path) -> None:
    """Load the weights of a run (.safetensors; .ckpt: its last ones) or of an export (.onnx) into a network.

    Raises ReorientError for a broken file and for weights of another network.
    """
    with loading(path, "the network's own"):
        if path.suffix.lower() == ".ckpt":
            weights = last_state(path)["network"]
        else:
            weights = _onnx_weights(path) if path.suffix.lower() == ".onnx" else load_file(path)
        known = network.state_dict()
        weights |= {key: known[key] for key in known if key.endswith("num_batches_tracked")}  # no export has it
        network.load_state_dict({key: value.to(known[key].dtype) for key, value in weights.items()})


@contextmanager
def loading(path: Path, expected: str) -> Iterator[None]:
    """Raise ReorientError for a broken or foreign file, for which the loaders raise many kinds of errors."""
    try:
        yield
    except Exception as error:
        cause = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
        raise ReorientError(
            f"cannot load weights {str(path)!r} ({in_short(cause, 200)}): expected {expected}"
        ) from error


def last_state(path: Path) -> dict[str, Any]:
    """The state that a run saved last, its network and optimizer included."""
    try:
        return dict(torch.load(path, weights_only=True))
    except (EOFError, UnpicklingError, TypeError, IndexError) as error:  # they advise to load it unsafely
        raise RuntimeError("no state of a training") from error


def _onnx_weights(path: Path) -> dict[str, Tensor]:
    tensors = onnx.load(path).graph.initializer
    named = {
        tensor.name.removesuffix(HALF): torch.from_numpy(numpy_helper.to_array(tensor).copy()) for tensor in tensors
    }
    return {name: value for name, value in named.items() if "." in name}

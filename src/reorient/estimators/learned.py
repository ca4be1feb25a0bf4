"""A trained network as an estimator: ONNX Runtime, one core, no torch."""

from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float, Float32

from reorient import so3
from reorient.errors import ReorientError, in_short, reason_of
from reorient.estimators.base import History, RotationEstimate, check_pair, with_evidence
from reorient.imaging import DepthImage, without_strays
from reorient.imaging.virtual_camera import (
    VirtualCamera,
    aim,
    filled,
    join,
    network_input,
    outline,
    pivot_guess,
    rotated,
    slide,
)
from reorient.registration import DepthView

SWIFT_ROUNDS = 3  # from the second on it estimates the rotation left by the answer so far
NEAR_RAD = float(np.radians(3))  # below this the exchanged pair, too, is like those it was trained on
INTERFACE = [("images", 2, 128, 128, "float"), ("quat_wxyz", 4, "float")]  # of an export: names, shapes, types
MOST_ROUNDS = 20


@cache
def load_session(weights: str | Path) -> Any:
    """The ONNX Runtime session of weights in the package (a name) or of a file.

    Raises ReorientError for a missing or unreadable file, and for another network.
    """
    import onnxruntime

    file = weights if isinstance(weights, Path) else resources.files("reorient") / "weights" / f"{weights}.onnx"
    if not file.is_file():
        place = str(weights) if isinstance(weights, Path) else f"{weights}.onnx in this installation"
        raise ReorientError(f"no weights {place}: expected what `reorient export` wrote")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    try:
        session = onnxruntime.InferenceSession(file.read_bytes(), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # the runtime raises errors of its own
        raise ReorientError(f"cannot read weights {str(file)!r}: expected what `reorient export` wrote") from error
    interface = [(x.name, *x.shape[1:], x.type[7:-1]) for x in (*session.get_inputs(), *session.get_outputs())]
    if interface != INTERFACE:
        raise ReorientError(
            f"{str(file)!r} holds another network, of {in_short(interface, 300)}: expected {INTERFACE}, what `reorient "
            "export` wrote"
        )
    return session


def _stated_rounds(session: Any, weights: str | Path) -> int:
    """The rounds that a file of weights states, by default 1. Raises ReorientError for none from 1 to 20."""
    try:
        stated = str(session.get_modelmeta().custom_metadata_map.get("rounds", "1"))
    except UnicodeDecodeError:
        stated = "text that is none"
    if not (stated.isascii() and stated.isdecimal() and len(stated) < 3 and 1 <= int(stated) <= MOST_ROUNDS):
        raise ReorientError(
            f"{str(weights)!r} states {in_short(stated)!r} rounds: expected a whole number from 1 to {MOST_ROUNDS}, "
            "what `reorient export` wrote"
        )
    return int(stated)


class Learned:
    """A network for rotations of 0-30 degrees (paper, "Learning to Estimate 3D Rotations").

    ``weights``: a name in the package, or an exported file. ``rounds``: from the second on, the input is the current
    image rotated by the answer so far, as in the training of ``swift``; None: as stated in the file. Where the answer
    so far is small, these rounds also estimate the exchanged pair: the mean of both answers has no bias at the goal.
    Of all rounds the answer with the best evidence is given.
    """

    def __init__(self, weights: Literal["paper", "swift"] | Path, rounds: int | None = None) -> None:
        self._session = load_session(weights)
        self._rounds = _stated_rounds(self._session, weights) if rounds is None else rounds

    def estimate(
        self,
        current: DepthImage,
        goal: DepthImage,
        pivot_m: Float[np.ndarray, "3"] | None = None,
        history: History = (),
    ) -> RotationEstimate:
        """As ``Estimator.estimate``; the history is not used."""
        check_pair(current, goal, pivot_m)
        virtual, views_m = self._views(current, goal)
        from_m, to_m = (self._turning_point(virtual, view_m, pivot_m) for view_m in views_m)
        current_m, goal_m = views_m
        shown = DepthView(current), DepthView(goal)
        R_virtual = so3.matrix_from_quat(self._answer_wxyz(current_m, goal_m, virtual))
        answers = []
        for left in reversed(range(self._rounds)):
            seen_m, at_m = rotated(current_m, virtual.tangent, R_virtual, from_m, to_m), to_m
            if pivot_m is None:  # the rotated view improves a guess
                at_m = to_m + slide(seen_m, goal_m, virtual.tangent)
            R, t_m = virtual.to_camera(R_virtual)[0], at_m[0] - R_virtual[0] @ from_m[0]
            answers.append(with_evidence(*shown, R, virtual.R_virtual_camera[0].T @ t_m))
            if not left:
                break
            if pivot_m is None:
                seen_m = rotated(current_m, virtual.tangent, R_virtual, from_m, at_m)
            left_wxyz = self._answer_wxyz(seen_m, goal_m, virtual)
            if np.all(so3.angle(R_virtual) < NEAR_RAD):
                left_wxyz = so3.normalize(left_wxyz + so3.conjugate(self._answer_wxyz(goal_m, seen_m, virtual)))
            R_virtual = so3.matrix_from_quat(left_wxyz) @ R_virtual
        return max(answers, key=lambda answer: answer.evidence.score)

    def raw_quat_wxyz(self, current: DepthImage, goal: DepthImage) -> Float[np.ndarray, "4"]:
        """Raw output of the network in its first round: virtual camera axes, either sign."""
        virtual, (current_m, goal_m) = self._views(current, goal)
        return np.asarray(self._predict(current_m, goal_m, virtual)[0].astype(float))

    @staticmethod
    def _views(current: DepthImage, goal: DepthImage) -> tuple[VirtualCamera, list[Float32[np.ndarray, "n size size"]]]:
        images = [without_strays(image) for image in (current, goal)]
        virtual = aim(join(*(outline(image.valid[None], image.camera) for image in images)))
        return virtual, [filled(virtual.view(image.depth_m[None, None], image.camera))[:, 0] for image in images]

    def _predict(
        self,
        current_m: Float32[np.ndarray, "n size size"],
        goal_m: Float32[np.ndarray, "n size size"],
        virtual: VirtualCamera,
    ) -> Float32[np.ndarray, "n 4"]:
        images = network_input(np.stack([current_m, goal_m], axis=1), virtual.tangent)
        try:
            quat_wxyz = self._session.run(None, {"images": images})[0]
        except Exception as error:  # the runtime raises errors of its own
            raise ReorientError(
                f"the network fails ({reason_of(error)}): expected weights that `reorient export` wrote"
            ) from error
        if quat_wxyz.shape != (len(images), 4) or not np.all(np.linalg.norm(quat_wxyz, axis=1) > 0):
            raise ReorientError("the network returns no quaternions: expected weights that `reorient export` wrote")
        return np.asarray(quat_wxyz)

    def _answer_wxyz(
        self,
        current_m: Float32[np.ndarray, "n size size"],
        goal_m: Float32[np.ndarray, "n size size"],
        virtual: VirtualCamera,
    ) -> Float[np.ndarray, "n 4"]:
        return so3.canonical(so3.normalize(self._predict(current_m, goal_m, virtual).astype(float)))

    def _turning_point(
        self, virtual: VirtualCamera, view_m: Float32[np.ndarray, "n size size"], pivot_m: Float[np.ndarray, "3"] | None
    ) -> Float[np.ndarray, "n 3"]:
        """The pivot, else a guess from the visible surface, in virtual axes."""
        if pivot_m is None:
            return pivot_guess(view_m, virtual.tangent)
        return np.asarray(virtual.R_virtual_camera @ pivot_m)

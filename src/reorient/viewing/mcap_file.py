"""A loop as an MCAP file, as Foxglove and Rerun open it: images, cameras, transforms, estimates, belief, events.

Messages of Foxglove's schemas (Protobuf) where there is one, else JSON with a schema of its own. The fixed frame is the
goal's camera; the frame ``aligned`` is where the estimate takes the current points, so that they lie on the goal's.
"""

import json
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from reorient import so3
from reorient.controller import OrientResult, Step
from reorient.errors import ReorientError
from reorient.extras import import_extra
from reorient.imaging import DepthImage
from reorient.runs.files import replacing

CAMERA, ALIGNED = "camera", "aligned"
STEP_S = 1.0  # between images without stamps
_NUMBERS = {"type": "array", "items": {"type": "number"}}
_ESTIMATE = {
    "type": "object",
    "properties": {
        "index": {"type": "integer"},
        "angle_deg": {"type": "number"},
        "rotvec_rad": _NUMBERS,
        "R_goal_current": {"type": "array", "items": _NUMBERS},
        "t_goal_current_m": _NUMBERS,
        "confidence": {"type": ["number", "null"]},
        "inlier_ratio": {"type": "number"},
        "free_space_violation": {"type": "number"},
        "silhouette_violation": {"type": "number"},
        "occluded": {"type": "number"},
        "alternatives": {
            "type": "array",
            "items": {"type": "object", "properties": {"rotvec_rad": _NUMBERS, "probability": {"type": "number"}}},
        },
        "warnings": {"type": "array", "items": {"type": "string"}},
    },
}
_BELIEF = {
    "type": "object",
    "properties": {
        "index": {"type": "integer"},
        "hypotheses": {
            "type": "array",
            "items": {
                "type": "object",
                "properties": {"rotvec_rad": _NUMBERS, "angle_deg": {"type": "number"}, "log_odds": {"type": "number"}},
            },
        },
    },
}


def write_mcap(path: str | Path, goal: DepthImage, result: OrientResult) -> Path:
    """Write a loop as MCAP; returns the path. Times are the stamps of the images, or else 1 s for each image.

    Raises ReorientError where the extra ``view`` is not installed, for a loop without a step, and for a path that
    cannot be written.
    """
    if not result.steps:
        raise ReorientError(f"a loop without a step ({result.reason}): expected at least one image to write")
    import_extra("mcap_protobuf")
    with replacing(path) as temporary, temporary.open("wb") as stream:
        file = _File(stream)
        times_s = _times(result.steps)
        file.image("goal", goal, times_s[0])
        file.points("goal", goal, CAMERA, times_s[0])
        for step, time_s in zip(result.steps, times_s, strict=True):
            file.step(step, time_s)
        for error in result.errors:
            file.event(f"error during the loop: {error}", times_s[-1], "WARNING")
        file.event(f"{result.status}: {result.reason}", times_s[-1], "INFO" if result.converged else "WARNING")
        file.finish()
    return Path(path)


def _times(steps: tuple[Step, ...]) -> list[float]:
    """The time of each step, in seconds: by the stamps if all images have one and they increase, from 0 otherwise."""
    stamps = [step.image.stamp_s for step in steps]
    known = [stamp for stamp in stamps if stamp is not None and stamp >= 0]
    if len(known) == len(stamps) and all(a < b for a, b in pairwise(known)):
        return known
    return [STEP_S * k for k in range(len(steps))]


class _File:
    """An open MCAP file, and the channels that it has so far."""

    def __init__(self, stream: Any) -> None:
        from mcap.writer import Writer

        self._writer = Writer(stream)
        self._writer.start(profile="", library="reorient")
        self._channels: dict[str, int] = {}

    def finish(self) -> None:
        """Write the index."""
        self._writer.finish()

    def step(self, step: Step, time_s: float) -> None:
        """All of one step."""
        estimate = step.estimate
        self.image("current", step.image, time_s)
        self.transform(estimate.R_goal_current, estimate.t_goal_current_m, time_s)
        self.points("current", step.image, ALIGNED, time_s)
        evidence = estimate.evidence
        shares = ("inlier_ratio", "free_space_violation", "silhouette_violation", "occluded")
        self._json(
            "/estimate",
            _ESTIMATE,
            {
                "index": step.index,
                "angle_deg": float(np.degrees(estimate.angle_rad)),
                "rotvec_rad": estimate.rotvec_rad.tolist(),
                "R_goal_current": np.asarray(estimate.R_goal_current).tolist(),
                "t_goal_current_m": np.asarray(estimate.t_goal_current_m).tolist(),
                "confidence": estimate.confidence,
                **{name: getattr(evidence, name) for name in shares},
                "alternatives": [
                    {"rotvec_rad": so3.log(np.asarray(R)).tolist(), "probability": float(p)}
                    for R, p in estimate.alternatives
                ],
                "warnings": list(estimate.warnings),
            },
            time_s,
        )
        hypotheses = [
            {"rotvec_rad": so3.log(R).tolist(), "angle_deg": float(np.degrees(so3.angle(R))), "log_odds": log_odds}
            for R, log_odds in step.hypotheses
        ]
        self._json("/belief", _BELIEF, {"index": step.index, "hypotheses": hypotheses}, time_s)
        for message, level in _events(step):
            self.event(message, time_s, level)

    def image(self, name: str, image: DepthImage, time_s: float) -> None:
        """Depth in metres, unknown pixels as a mask, and the camera."""
        from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
        from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

        camera = image.camera
        for topic, encoding, pixels in (
            ("depth", "32FC1", image.depth_m.astype("<f4")),
            ("unknown", "mono8", 255 * image.unknown.astype(np.uint8)),
        ):
            message = RawImage(
                frame_id=CAMERA,
                width=camera.width,
                height=camera.height,
                encoding=encoding,
                step=pixels.strides[0],
                data=pixels.tobytes(),
            )
            self._message(f"/{name}/{topic}", message, time_s)
        # Foxglove counts pixels from the centre of the first one, as ROS
        cx, cy = camera.cx - 0.5, camera.cy - 0.5
        K = [camera.fx, 0, cx, 0, camera.fy, cy, 0, 0, 1]
        P = [camera.fx, 0, cx, 0, 0, camera.fy, cy, 0, 0, 0, 1, 0]
        calibration = CameraCalibration(frame_id=CAMERA, width=camera.width, height=camera.height, K=K, P=P)
        self._message(f"/{name}/camera", calibration, time_s)

    def points(self, name: str, image: DepthImage, frame: str, time_s: float) -> None:
        """The returns as a point cloud."""
        from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
        from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud

        fields = [
            PackedElementField(name=x, offset=4 * k, type=PackedElementField.FLOAT32) for k, x in enumerate("xyz")
        ]
        message = PointCloud(
            frame_id=frame, point_stride=12, fields=fields, data=image.points().astype("<f4").tobytes()
        )
        message.pose.orientation.w = 1
        self._message(f"/{name}/points", message, time_s)

    def transform(self, R: Float[np.ndarray, "3 3"], t_m: Float[np.ndarray, "3"], time_s: float) -> None:
        """The motion of the estimate as the pose of the frame ``aligned``."""
        from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform

        message = FrameTransform(parent_frame_id=CAMERA, child_frame_id=ALIGNED)
        message.translation.x, message.translation.y, message.translation.z = map(float, t_m)
        quat = message.rotation
        quat.w, quat.x, quat.y, quat.z = map(float, so3.quat_from_matrix(np.asarray(R)))
        self._message("/transform", message, time_s)

    def event(self, text: str, time_s: float, level: str = "INFO") -> None:
        """A decision, a move or an error, in words."""
        from foxglove_schemas_protobuf.Log_pb2 import Log

        self._message("/events", Log(level=getattr(Log, level), message=text, name="reorient"), time_s)

    def _message(self, topic: str, message: Any, time_s: float) -> None:
        from mcap_protobuf.schema import register_schema

        nanoseconds = round(1e9 * time_s)
        if hasattr(message, "timestamp"):
            message.timestamp.FromNanoseconds(nanoseconds)
        if topic not in self._channels:
            schema = register_schema(self._writer, type(message))
            self._channels[topic] = self._writer.register_channel(topic, "protobuf", schema)
        self._writer.add_message(self._channels[topic], nanoseconds, message.SerializeToString(), nanoseconds)

    def _json(self, topic: str, schema: dict[str, Any], message: dict[str, Any], time_s: float) -> None:
        if topic not in self._channels:
            name = "reorient." + topic.strip("/").capitalize()
            number = self._writer.register_schema(name, "jsonschema", json.dumps(schema).encode())
            self._channels[topic] = self._writer.register_channel(topic, "json", number)
        nanoseconds = round(1e9 * time_s)
        self._writer.add_message(self._channels[topic], nanoseconds, json.dumps(message).encode(), nanoseconds)


def _events(step: Step) -> Iterator[tuple[str, str]]:
    """What was decided and done at a step, each with its level."""
    yield f"image {step.index}: {step.message}", "INFO"
    if step.R_executed is not None:
        angle_deg = np.degrees(so3.angle(step.R_executed))
        yield f"moved by {angle_deg:.2f} deg" + (", undone" if step.undone else ""), "INFO"
    if step.error:
        yield step.error, "ERROR"

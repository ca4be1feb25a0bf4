"""What pages and viewers show of an estimate: depth images in a compact form, and hypotheses with their evidence."""

import base64
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from reorient import so3
from reorient.estimators.base import RotationEstimate
from reorient.imaging import DepthImage
from reorient.registration import DepthView, Evidence, Warped, inlier_tolerance_m, measure_evidence

LARGEST_PX = 128  # of an image on a page: its longer side
_STEPS = 2000  # of depth between the nearest and the farthest return, at least 0.1 mm each


@dataclass(frozen=True)
class PointClass:
    """One of the four things that a warped point is."""

    label: str
    share: str
    """Field of ``Evidence`` that counts it."""
    colour: tuple[int, int, int]
    """From the palette of Okabe and Ito, which colour-blind people can distinguish."""


CLASSES = (
    PointClass("inlier", "inlier_ratio", (0, 158, 115)),
    PointClass("free-space violation", "free_space_violation", (213, 94, 0)),
    PointClass("silhouette violation", "silhouette_violation", (240, 228, 66)),
    PointClass("occluded", "occluded", (0, 114, 178)),
)


def classes_of(warped: Warped, tolerance_m: float) -> UInt8[np.ndarray, " n"]:
    """The index of each point's class in ``CLASSES``."""
    classes: np.ndarray = np.select(
        [warped.inlier(tolerance_m), warped.free_space_violation(tolerance_m), warped.silhouette_violation()],
        [0, 1, 2],
        3,
    )
    return classes.astype(np.uint8)


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A motion from current to goal that the images are compared by, p_goal = R p_current + t, camera axes, metres."""

    label: str
    R_goal_current: Float[np.ndarray, "3 3"]
    t_goal_current_m: Float[np.ndarray, "3"]
    evidence: Evidence
    current_classes: UInt8[np.ndarray, " n"]
    """The class of each return of current, row by row, moved into goal."""
    goal_classes: UInt8[np.ndarray, " m"]
    """The class of each return of goal, row by row, moved into current."""
    probability: float | None = None

    @property
    def angle_deg(self) -> float:
        """Angle of the rotation, degrees."""
        return float(np.degrees(so3.angle(self.R_goal_current)))

    @property
    def axis(self) -> Float[np.ndarray, "3"]:
        """Unit axis of the rotation, camera axes."""
        return so3.quat_axis(so3.quat_from_matrix(self.R_goal_current))


class Compared:
    """Two images ready for the evidence of any motion between them."""

    def __init__(self, current: DepthImage, goal: DepthImage, goal_view: DepthView | None = None) -> None:
        """``goal_view``: that of goal, where it is known."""
        self.current, self.goal = current, goal
        self._views = DepthView(current), goal_view or DepthView(goal)
        self._tolerance_m = inlier_tolerance_m(*self._views)
        self._points_m = current.points().T, goal.points().T

    def hypothesis(
        self,
        label: str,
        R: Float[np.ndarray, "3 3"],
        t_m: Float[np.ndarray, "3"],
        probability: float | None = None,
        evidence: Evidence | None = None,
    ) -> Hypothesis:
        """The motion with the class of every point; ``evidence`` None: measured."""
        forward = self._views[1].warp(R @ self._points_m[0] + t_m[:, None])
        backward = self._views[0].warp(R.T @ (self._points_m[1] - t_m[:, None]))
        current, goal = (classes_of(warped, self._tolerance_m) for warped in (forward, backward))
        if evidence is None:
            evidence = measure_evidence(*self._views, R, t_m, self._tolerance_m)
        return Hypothesis(label, R, t_m, evidence, current, goal, probability)

    def of(self, estimate: RotationEstimate) -> list[Hypothesis]:
        """The answer of an estimate, then its alternatives, which move the middle of current to the same place."""
        R, t_m = estimate.R_goal_current, estimate.t_goal_current_m
        found = [self.hypothesis("answer", R, t_m, estimate.confidence, estimate.evidence)]
        middle_m = self._points_m[0].mean(axis=1)
        for number, (R_other, probability) in enumerate(estimate.alternatives, start=1):
            t_other_m = R @ middle_m + t_m - R_other @ middle_m
            found.append(self.hypothesis(f"alternative {number}", np.asarray(R_other), t_other_m, probability))
        return found


def at_most(image: DepthImage, largest_px: int = LARGEST_PX) -> DepthImage:
    """The image, shrunk where its longer side has more pixels."""
    camera = image.camera
    scale = largest_px / max(camera.width, camera.height)
    return (
        image
        if scale >= 1
        else image.resized(max(round(camera.width * scale), 1), max(round(camera.height * scale), 1))
    )


def image_data(image: DepthImage, stepped: int = _STEPS) -> dict[str, Any]:
    """An image as JSON: its camera, and the depth in steps; 0 is not the object, 1 unknown.

    The steps are the differences along each row (modulo 2^16), all their low bytes, then all their high bytes,
    compressed by zlib, in base 64.
    """
    camera, depth_m, valid = image.camera, image.depth_m.astype(float), image.valid
    near_m, far_m = float(depth_m[valid].min()), float(depth_m[valid].max())
    step_m = max((far_m - near_m) / stepped, 1e-4)
    steps = np.where(valid, np.round((depth_m - near_m) / step_m) + 2, image.unknown).astype(np.uint16)
    differences = np.diff(steps, axis=1, prepend=np.uint16(0)).ravel()
    planes = np.stack([differences & 0xFF, differences >> 8]).astype(np.uint8)
    return {
        "width": camera.width,
        "height": camera.height,
        "camera": [round(x, 4) for x in (camera.fx, camera.fy, camera.cx, camera.cy)],
        "near_m": round(near_m, 6),
        "step_m": step_m,
        "seen": int(np.count_nonzero(valid)),
        "unknown": int(np.count_nonzero(image.unknown)),
        "data": _packed(planes),
    }


def hypothesis_data(hypothesis: Hypothesis) -> dict[str, Any]:
    """A hypothesis as JSON."""
    evidence = hypothesis.evidence
    return {
        "label": hypothesis.label,
        "R": _rounded(hypothesis.R_goal_current, 6),
        "t_m": _rounded(hypothesis.t_goal_current_m, 5),
        "angle_deg": round(hypothesis.angle_deg, 3),
        "axis": _rounded(hypothesis.axis, 4),
        "probability": hypothesis.probability,
        "shares": [round(getattr(evidence, each.share), 4) for each in CLASSES],
        "classes": [_packed(each) for each in (hypothesis.current_classes, hypothesis.goal_classes)],
    }


def class_data() -> list[dict[str, Any]]:
    """The classes as JSON, for the legend."""
    return [{"label": each.label, "colour": list(each.colour)} for each in CLASSES]


def _packed(values: UInt8[np.ndarray, "..."]) -> str:
    return base64.b64encode(zlib.compress(values.tobytes(), 9)).decode()


def _rounded(values: Float[np.ndarray, "..."], decimals: int) -> list[float]:
    return [round(float(x), decimals) for x in np.ravel(values)]

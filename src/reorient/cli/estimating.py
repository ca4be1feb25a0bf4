"""The verb estimate, and the text of an estimate."""

import json
import sys
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from reorient import so3
from reorient.cli.arguments import Metavar, Positional
from reorient.cli.isolating import Frames
from reorient.formatting import format_number, format_probability, format_share
from reorient.plugins import in_one_line

if TYPE_CHECKING:
    from reorient.estimators.base import RotationEstimate
    from reorient.imaging import DepthImage
    from reorient.registration import Evidence


@dataclass(frozen=True)
class Estimate:
    """Estimate the rotation between two depth images of one object.

    The rotation takes the object from its pose in CURRENT to its pose in GOAL, in camera axes: x right, y down,
    z forward.

    Examples:
        reorient estimate now.npz goal.npz
        reorient estimate now.png goal.png --camera camera.json --box 200 120 256 256 --remove-plane --show-input in.png
    """

    current: Positional[Path]
    """Depth image of the object as it is now: .png, .tif, .npy, .npz, .exr, .pgm, .pfm, .pcd or .ply."""
    goal: Positional[Path]
    """Depth image of the object as it should be, or a goal of several views as of ``reorient capture --views`` and
    ``reorient goal from-mesh``."""
    frames: Frames = field(default_factory=Frames)
    estimator: str = "rotation-search"
    """One of default (rotation-search), rotation-search, fast, normal, gicp, icp, paper and swift, an .onnx file,
    or your own module:Class."""
    pivot: Annotated[tuple[float, float, float] | None, Metavar(("X", "Y", "Z"))] = None
    """Rotation centre in camera axes, in metres, if known to about 1 cm."""
    json: bool = False
    """Print a JSON object instead of text."""
    show_input: Path | None = None
    """Draw both frames with the isolated object, removed returns and unknown pixels (.png, .jpg)."""
    explain: Path | None = None
    """Draw both images and the evidence for the estimate (.png, .jpg), or show them in 3D on a page (.html)."""

    def run(self) -> None:
        """Read, isolate, estimate, print, draw."""
        from reorient.estimators import load_estimator
        from reorient.estimators.base import as_estimate
        from reorient.imaging.summary import Summary, pair_warnings

        as_page = self.explain is not None and self.explain.suffix.lower() == ".html"
        for path in (self.show_input, None if as_page else self.explain):
            if path is not None:
                from reorient.reporting.pictures import check_suffix

                check_suffix(path)
        estimator = load_estimator(self.estimator)
        inputs = self.frames.read_pair(self.current, self.goal, self.show_input)
        current, goal = (each.isolated for each in inputs)
        pivot_m = None if self.pivot is None else np.array(self.pivot)
        with in_one_line("the estimator failed"):
            answer = estimator.estimate(current, inputs[1].goal, pivot_m)
            estimate = as_estimate(answer, current, goal)
        if self.explain is not None:
            self._explain(self.explain, current, goal, estimate)
        summaries = {each.name: Summary.of(each.isolated) for each in inputs}
        for warning in (*pair_warnings(*summaries.values()), *estimate.warnings):
            print(f"reorient: warning: {warning}", file=sys.stderr)
        if self.json:
            print(json.dumps(as_data(estimate) | {name: asdict(each) for name, each in summaries.items()}, indent=2))
        else:
            print("\n".join(f"{name:13s} {summary}" for name, summary in summaries.items()))
            print(in_words(estimate))

    def _explain(self, path: Path, current: "DepthImage", goal: "DepthImage", estimate: "RotationEstimate") -> None:
        """Write the picture or the page."""
        if path.suffix.lower() == ".html":
            from reorient.reporting.loop import write_estimate

            write_estimate(path, current, goal, estimate, f"{self.current.name} to {self.goal.name}")
            return
        from reorient.reporting.explaining import picture
        from reorient.runs.files import replacing

        with replacing(path) as temporary:
            picture(current, goal, estimate).save(temporary)


def as_data(estimate: "RotationEstimate") -> dict[str, Any]:
    """The estimate as JSON has it, with the names of the Python interface."""
    evidence = estimate.evidence
    shares = asdict(evidence) | {"covisible_inlier_ratio": evidence.covisible_inlier_ratio, "score": evidence.score}
    return {
        "R_goal_current": estimate.R_goal_current.tolist(),
        "t_goal_current_m": estimate.t_goal_current_m.tolist(),
        "quat_wxyz": estimate.quat_wxyz.tolist(),
        "rotvec_rad": estimate.rotvec_rad.tolist(),
        "angle_deg": float(np.degrees(estimate.angle_rad)),
        "axis": so3.quat_axis(estimate.quat_wxyz).tolist(),
        "confidence": estimate.confidence,
        "alternatives": [{"R_goal_current": R.tolist(), "probability": p} for R, p in estimate.alternatives],
        "covariance_rad2": None if estimate.covariance_rad2 is None else estimate.covariance_rad2.tolist(),
        "free_axis": None if estimate.free_axis is None else estimate.free_axis.tolist(),
        "warnings": list(estimate.warnings),
        "evidence": {name: None if x != x else x for name, x in shares.items()},  # JSON has no NaN
    }


def in_words(estimate: "RotationEstimate") -> str:
    """The estimate as text, a line for each part."""
    evidence, rows = estimate.evidence, estimate.R_goal_current
    lines = [
        f"rotation      {_rotation(estimate.R_goal_current)} (camera axes)",
        f"quaternion    {_vector(estimate.quat_wxyz, 6)} (wxyz)",
        *(f"{'' if i else 'matrix':13s} {' '.join(f'{x:z9.6f}' for x in row)}" for i, row in enumerate(rows)),
        f"translation   {_vector(estimate.t_goal_current_m, 4)} m",
        f"confidence    {confidence_in_words(estimate.confidence)}",
        f"inliers       {inliers_in_words(evidence)}, residual {format_number(1000 * evidence.residual_m)} mm",
        f"violations    free space {format_share(evidence.free_space_violation)}, "
        f"silhouette {format_share(evidence.silhouette_violation)}",
        f"occluded      {format_share(evidence.occluded)}",
    ]
    if estimate.free_axis is not None:
        lines.append(
            f"free axis     {_vector(estimate.free_axis, 4)} (every rotation about it fits: the smallest is shown)"
        )
    for R, probability in estimate.alternatives:
        away = _rotation(R @ estimate.R_goal_current.T)
        lines.append(f"alternative   {format_probability(probability)}: the estimate rotated by {away}")
    return "\n".join(lines)


def confidence_in_words(confidence: float | None) -> str:
    """The probability that the error is small, or why there is none."""
    if confidence is None:
        return "not available (estimator is not calibrated)"
    return f"{format_probability(confidence)} (error below 5 deg)"


def inliers_in_words(evidence: "Evidence") -> str:
    """The share of inliers among all points and among those that both cameras see."""
    covisible = format_share(evidence.covisible_inlier_ratio)
    return f"{format_share(evidence.inlier_ratio)} ({covisible} of co-visible points)"


def _rotation(R: np.ndarray) -> str:
    quat_wxyz = so3.quat_from_matrix(R)
    return f"{np.degrees(so3.angle(R)):.2f} deg about {_vector(so3.quat_axis(quat_wxyz), 4)}"


def _vector(values: np.ndarray, decimals: int) -> str:
    return f"[{' '.join(f'{x:z.{decimals}f}' for x in values)}]"

"""The verb estimate: the rotation between two image files, and how their frames are read."""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from tyro.conf import Positional

from reorient.errors import ReorientError

if TYPE_CHECKING:
    from reorient.estimators.base import RotationEstimate
    from reorient.imaging import Camera, DepthImage

T = TypeVar("T")


@dataclass(frozen=True)
class Frames:
    """How raw camera frames become images of one isolated object. One value serves both images, two are for CURRENT
    and GOAL; '-' is none (--near 0.3 -)."""

    camera: tuple[str, ...] = ()
    """Intrinsics JSON (reorient, Open3D or RealSense style); not needed where the image file states its camera."""
    depth_scale: tuple[float, ...] = ()
    """Metres per unit of integer depth; default: what the file states, else 0.001."""
    mask: tuple[str, ...] = ()
    """Picture or .npy, not zero on the object."""
    box: tuple[int, ...] = ()
    """Left, top, width, height in px: keep what is inside; four numbers, or eight."""
    near: tuple[str, ...] = ()
    """Keep returns at least this far, m."""
    far: tuple[str, ...] = ()
    """Keep returns at most this far, m."""

    def read(self, path: Path, which: int) -> "DepthImage":
        """The isolated image; ``which``: 0 current, 1 goal."""
        from reorient.imaging import isolate
        from reorient.imaging.files import read_depth, read_mask

        camera_file, mask = _each(self.camera, which, "--camera"), _each(self.mask, which, "--mask")
        if len(self.box) not in (0, 4, 8):
            raise ReorientError(f"--box with {len(self.box)} numbers: expected left top width height, once or twice")
        box = self.box[4:] if which and len(self.box) == 8 else self.box[:4]
        image = read_depth(path, self._camera(camera_file), _each(self.depth_scale, which, "--depth-scale"))
        return isolate(
            image,
            mask=None if mask in (None, "-") else read_mask(mask),
            box_px=(box[0], box[1], box[2], box[3]) if box else None,
            near_m=_metres(self.near, which, "--near"),
            far_m=_metres(self.far, which, "--far"),
        )

    def _camera(self, file: str | None) -> "Camera | None":
        from reorient.imaging.files import read_camera

        return None if file in (None, "-") else read_camera(file)


def _each(values: tuple[T, ...], which: int, flag: str) -> T | None:
    if len(values) > 2:
        raise ReorientError(f"{flag} with {len(values)} values: expected one for both images, or two")
    return values[which if len(values) == 2 else 0] if values else None


def _metres(values: tuple[str, ...], which: int, flag: str) -> float | None:
    value = _each(values, which, flag)
    try:
        return None if value in (None, "-") else float(value)
    except ValueError as error:
        raise ReorientError(f"{flag} {value}: expected metres, or '-' for none") from error


@dataclass(frozen=True)
class Estimate:
    """The rotation that turns the object in CURRENT into the one in GOAL (camera axes: x right, y down, z forward).

    For example: reorient estimate now.npz goal.npz
    or, raw frames: reorient estimate now.png goal.png --camera camera.json --box 200 120 256 256 --far 0.9
    """

    current: Positional[Path]
    """Depth image now: .png, .tif, .npy or .npz."""
    goal: Positional[Path]
    """Depth image as desired."""
    frames: Frames = field(default_factory=Frames)
    estimator: str = "default"
    pivot: tuple[float, float, float] | None = None
    """Rotation centre in camera axes, m, good to about 1 cm, if known."""
    json: bool = False
    """Print one JSON object instead of words."""
    explain: Path | None = None
    """Draw current, goal, current turned by the answer, and where they disagree (.png, .jpg)."""

    def run(self) -> None:
        """Read, isolate, estimate, print, draw."""
        from reorient.estimators import load_estimator
        from reorient.estimators.base import as_estimate

        if self.explain is not None:
            from reorient.reporting.pictures import check_suffix

            check_suffix(self.explain)
        estimator = load_estimator(self.estimator)
        current, goal = self.frames.read(self.current, 0), self.frames.read(self.goal, 1)
        pivot_m = None if self.pivot is None else np.array(self.pivot)
        estimate = as_estimate(estimator.estimate(current, goal, pivot_m), current, goal)
        if self.explain is not None:
            from reorient.reporting.explaining import picture
            from reorient.runs.files import replacing

            with replacing(self.explain) as temporary:
                picture(current, goal, estimate).save(temporary)
        print(json.dumps(_as_data(estimate), indent=2) if self.json else _in_words(estimate))


def _as_data(estimate: "RotationEstimate") -> dict[str, Any]:
    from dataclasses import asdict

    from reorient import so3

    evidence = {k: None if v != v else v for k, v in asdict(estimate.evidence).items()}  # JSON has no NaN
    return {
        "quat_wxyz": estimate.quat_wxyz.tolist(),
        "angle_deg": float(np.degrees(estimate.angle_rad)),
        "axis": so3.quat_axis(estimate.quat_wxyz).tolist(),
        "R_goal_current": estimate.R_goal_current.tolist(),
        "t_goal_current_m": estimate.t_goal_current_m.tolist(),
        "covariance_rad2": None if estimate.covariance_rad2 is None else estimate.covariance_rad2.tolist(),
        "confidence": estimate.confidence,
        "alternatives": [{"R_goal_current": R.tolist(), "probability": p} for R, p in estimate.alternatives],
        "evidence": evidence | {"score": estimate.evidence.score},
    }


def _in_words(estimate: "RotationEstimate") -> str:
    from reorient.reporting.explaining import in_words

    data, evidence = _as_data(estimate), estimate.evidence
    rows = "\n           ".join(" ".join(f"{x:9.6f}" for x in row) for row in data["R_goal_current"])
    return "\n".join(
        [
            f"angle      {data['angle_deg']:.3f} degrees about [{' '.join(f'{x:.4f}' for x in data['axis'])}]",
            f"wxyz       {' '.join(f'{x:.6f}' for x in data['quat_wxyz'])}",
            f"matrix     {rows}",
            f"confidence {in_words(estimate)}",
            f"evidence   {evidence.inlier_ratio:.0%} inliers (rms {1000 * evidence.residual_m:.2f} mm), "
            f"{evidence.free_space_violation:.0%} free-space violations, "
            f"{evidence.silhouette_violation:.0%} silhouette violations, {evidence.occluded:.0%} occluded",
        ]
    )

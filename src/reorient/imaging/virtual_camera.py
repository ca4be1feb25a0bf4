"""The virtual camera: at the position of the real one, rotated to point at the object and zoomed to it.

Its images depend little on the real camera, so that one network serves all cameras. The same functions prepare training
batches and the two images of an estimate. All arrays lead with a batch of n pairs.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float32, Real

from reorient.errors import ReorientError
from reorient.imaging.camera import Camera
from reorient.imaging.splatting import splat

SIZE_PX = 128
FILL = 0.85  # distance of the object's outline from the image centre, over the half width of the image
BEHIND = 0.15  # depth of the guessed pivot behind the centroid of the visible surface, over the width of the view


@dataclass(frozen=True)
class VirtualCamera:
    """n square cameras at the position of the real camera."""

    R_virtual_camera: Float[np.ndarray, "n 3 3"]
    """Rotation from the real camera's axes to the virtual camera's."""
    tangent: Float[np.ndarray, " n"]
    """Tangent of half the field of view."""

    def view(self, depth: Real[np.ndarray, "n k h w"], camera: Camera) -> Float32[np.ndarray, "n k size size"]:
        """k depth images a pair of the real camera, in any unit, resampled to the virtual one by nearest neighbour."""
        axis = ((np.arange(SIZE_PX) + 0.5) / (SIZE_PX / 2) - 1) * self.tangent[:, None]
        column, row = axis[:, None, :].astype(np.float32), axis[:, :, None].astype(np.float32)
        R = self.R_virtual_camera.astype(np.float32)[:, None, None]  # rows: the virtual axes in the real camera's
        z = column * R[..., 0, 2] + (row * R[..., 1, 2] + R[..., 2, 2])
        per_z = 1 / z
        u = (column * R[..., 0, 0] + (row * R[..., 1, 0] + R[..., 2, 0])) * (per_z * np.float32(camera.fx))
        v = (column * R[..., 0, 1] + (row * R[..., 1, 1] + R[..., 2, 1])) * (per_z * np.float32(camera.fy))
        u += np.float32(camera.cx)
        v += np.float32(camera.cy)
        outside = (u < 0) | (u >= camera.width) | (v < 0) | (v >= camera.height)
        pixel = v.astype(np.intp) * camera.width + u.astype(np.intp)
        pixel[outside] = 0
        per_z[outside] = 0
        n, k, h, w = depth.shape
        start = np.arange(0, n * k * h * w, h * w).reshape(n, k, 1, 1)
        return np.asarray(np.take(depth.reshape(-1), start + pixel[:, None], mode="clip") * per_z[:, None])

    def to_camera(self, R_virtual: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, "n 3 3"]:
        """Rotations of the object from virtual to real camera axes, by conjugation."""
        return np.asarray(np.swapaxes(self.R_virtual_camera, 1, 2) @ R_virtual @ self.R_virtual_camera)

    def from_camera(self, R_camera: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, "n 3 3"]:
        """Rotations of the object from real to virtual camera axes, by conjugation."""
        return np.asarray(self.R_virtual_camera @ R_camera @ np.swapaxes(self.R_virtual_camera, 1, 2))


def outline(valid: Bool[np.ndarray, "n h w"], camera: Camera) -> Float[np.ndarray, "n 2 2"]:
    """[(low, high)] of x / z and of y / z for the box of pixels around the returns.

    Raises ReorientError for an image without returns.
    """
    sides = []
    for axis, size, f, c in ((1, camera.width, camera.fx, camera.cx), (2, camera.height, camera.fy, camera.cy)):
        hit = np.asarray(np.any(valid, axis=axis))
        if not hit.any(axis=1).all():
            raise ReorientError("an image without returns: expected the object in it")
        low, high = hit.argmax(axis=1), size - hit[:, ::-1].argmax(axis=1)
        sides.append((np.stack([low, high], axis=-1) - c) / f)
    return np.stack(sides, axis=1)


def aim(
    outlines: Float[np.ndarray, "n 2 2"],
    target: Float[np.ndarray, "n 3"] | None = None,
    fill: Float[np.ndarray, " n"] | float = FILL,
) -> VirtualCamera:
    """The cameras that point at a target, zoomed so that the outline reaches the share ``fill`` of the half width.

    ``target``: any point on the line of sight, camera axes, of any length; default: the middle of the outline. Raises
    ReorientError for a target behind the camera, and where part of the outline is behind the virtual camera.
    """
    if target is None:
        middle = outlines.mean(axis=2)
        target = np.concatenate([middle, np.ones((len(middle), 1))], axis=1)
    if not (np.all(np.isfinite(target)) and np.all(target[:, 2] > 0)):
        raise ReorientError(f"pivot {target[0]}: expected three finite numbers, metres, in front of the camera")
    z = target / np.linalg.norm(target, axis=1, keepdims=True)
    # The rotation of least angle that takes the optical axis to z, in closed form; its inverse has rows x, y, z.
    a, b, c = z.T
    k = 1 / (1 + c)
    x = np.stack([1 - k * a * a, -k * a * b, -a], axis=1)
    y = np.stack([-k * a * b, 1 - k * b * b, -b], axis=1)
    R_virtual_camera = np.stack([x, y, z], axis=1)
    corners = np.stack(
        [np.stack([outlines[:, 0, i], outlines[:, 1, j], np.ones(len(z))], axis=1) for i in (0, 1) for j in (0, 1)],
        axis=1,
    )
    seen = corners @ np.swapaxes(R_virtual_camera, 1, 2)
    if seen[..., 2].min() <= 0:
        raise ReorientError(
            f"pivot {target[0]}: expected it near the object, some returns lie behind a camera aimed at it"
        )
    extent = np.abs(seen[..., :2] / seen[..., 2:]).max(axis=(1, 2))
    return VirtualCamera(R_virtual_camera, extent / fill)


def join(first: Float[np.ndarray, "n 2 2"], second: Float[np.ndarray, "n 2 2"]) -> Float[np.ndarray, "n 2 2"]:
    """The outlines that hold both."""
    return np.stack([np.minimum(first[..., 0], second[..., 0]), np.maximum(first[..., 1], second[..., 1])], axis=-1)


def network_input(
    pair: Float32[np.ndarray, "n 2 size size"], tangent: Float[np.ndarray, " n"]
) -> Float32[np.ndarray, "n 2 size size"]:
    """Network input from the views of current and goal: relief over the width of the view, independent of the unit of
    depth, of the distance and of the object's size.

    1 at the mean depth of the pair, larger where nearer, 0 where there is no return (as in the paper's images).
    """
    valid = pair > 0
    count = np.maximum(np.count_nonzero(valid, axis=(1, 2, 3)), 1)
    middle = pair.sum(axis=(1, 2, 3)) / count
    width = 2 * np.maximum(tangent, 1e-9)
    scale = (1 / np.maximum(middle * width, 1e-9)).astype(np.float32)[:, None, None, None]
    shift = (1 / width + 1).astype(np.float32)[:, None, None, None]
    return np.where(valid, shift - pair * scale, np.float32(0))


def rotated(
    depth_m: Float32[np.ndarray, "n size size"],
    tangent: Float[np.ndarray, " n"],
    R: Float[np.ndarray, "n 3 3"],
    from_m: Float[np.ndarray, "n 3"],
    to_m: Float[np.ndarray, "n 3"],
) -> Float32[np.ndarray, "n size size"]:
    """Views of the visible surface after the motion x -> R (x - from_m) + to_m, in virtual camera axes, metres.

    Surface that was hidden before the motion stays empty. Gaps one pixel wide are closed.
    """
    size = depth_m.shape[1]
    which, row, column = np.nonzero(depth_m)
    z = depth_m[which, row, column]
    unit = (tangent / (size / 2)).astype(np.float32)[which]
    middle = np.float32(size / 2 - 0.5)
    points = np.stack([(column - middle) * unit * z, (row - middle) * unit * z, z], axis=1, dtype=np.float32)
    shift = (to_m - np.einsum("nij,nj->ni", R, from_m)).astype(np.float32)
    moved = np.einsum("kij,kj->ki", R.astype(np.float32)[which], points) + shift[which]
    depth = moved[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        uv_px = moved[:, :2] / depth[:, None] / unit[:, None] + np.float32(size / 2)
    out = splat(uv_px, depth, depth_m.shape, which)
    for a, b in ((out[:, 1:-1, :-2], out[:, 1:-1, 2:]), (out[:, :-2, 1:-1], out[:, 2:, 1:-1])):
        inner = out[:, 1:-1, 1:-1]  # points of a surface that comes nearer lie more than a pixel apart
        gap = (inner == 0) & (a > 0) & (b > 0)
        inner[gap] = (a[gap] + b[gap]) / 2
    return out


def pivot_guess(
    depth_m: Float32[np.ndarray, "n size size"], tangent: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n 3"]:
    """Guessed rotation centres, virtual camera axes, metres: behind the centroid of the visible surface."""
    size = depth_m.shape[1]
    axis = ((np.arange(size) + 0.5) / (size / 2) - 1).astype(np.float32)
    count = np.maximum(np.count_nonzero(depth_m, axis=(1, 2)), 1)
    x = np.einsum("nij,j->n", depth_m, axis) * tangent / count
    y = np.einsum("nij,i->n", depth_m, axis) * tangent / count
    z = depth_m.sum(axis=(1, 2)) / count
    return np.stack([x, y, z + BEHIND * 2 * tangent * z], axis=1)


def slide(
    seen_m: Float32[np.ndarray, "n size size"],
    goal_m: Float32[np.ndarray, "n size size"],
    tangent: Float[np.ndarray, " n"],
) -> Float[np.ndarray, "n 3"]:
    """Translations, virtual camera axes, metres, that align views with goal views: by the middle of the outlines, and
    by the median depth difference where both show the object. Zero where a view has no return."""
    shifts = np.zeros((len(seen_m), 3))
    for shift, seen, goal, wide in zip(shifts, seen_m, goal_m, tangent, strict=True):
        if not (seen.any() and goal.any()):
            continue
        unit = 2 * wide / len(goal)
        z = goal[goal > 0].mean()
        for i, axis in enumerate((0, 1)):
            a, b = (np.nonzero((x > 0).any(axis=axis))[0] for x in (seen, goal))
            shift[i] = (b[0] + b[-1] - a[0] - a[-1]) / 2 * unit * z
        both = (seen > 0) & (goal > 0)
        if both.any():
            shift[2] = np.median(goal[both] - seen[both])
    return shifts

"""The virtual camera: at the position of the real one, rotated to point at the object and zoomed to it.

Its images depend little on the real camera, so that one network serves all cameras. The same functions prepare training
batches and the two images of an estimate. All arrays lead with a batch of n pairs.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float32, Real
from scipy import fft, ndimage

from reorient.errors import ReorientError
from reorient.imaging.camera import Camera
from reorient.imaging.splatting import splat

SIZE_PX = 128
FILL = 0.85  # distance of the object's outline from the image centre, over the half width of the image
GAP_PX = 11  # chosen on 150 pairs of generated objects (sequence 1701) of the preset in_hand
RELIEF_SCATTER = 0.1  # of depth differences, over the width of the view, that weighs as much as the whole overlap
ALIKE = 0.015  # shifts whose scores differ by less are averaged; not tuned
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


def filled(views: Float32[np.ndarray, "n k size size"]) -> Float32[np.ndarray, "n k size size"]:
    """Views whose gaps narrower than ``GAP_PX`` are closed, by a grey closing of the inverse depth.

    Dropouts and holes of a mask are no shape; a network that meets them takes them for one.
    """
    nearness = np.divide(1, views, out=np.zeros_like(views), where=views > 0)
    size = (1, 1, GAP_PX, GAP_PX)
    closed = ndimage.grey_closing(nearness, size, mode="constant")
    out: Float32[np.ndarray, "n k size size"] = views.copy()
    np.divide(1, closed, out=out, where=(views == 0) & (closed > 0))
    return out


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
    """Translations, virtual camera axes, metres, that align views with goal views. Zero where a view has no return.

    Of all shifts in whole pixels, those at which most pixels show the object in both views and the depth differences
    there scatter least; then the median depth difference. Part of a view may be missing, so that the boxes and the
    centroids of both views differ.
    """
    return np.stack([_slide(*views) for views in zip(seen_m, goal_m, tangent, strict=True)])


def _slide(
    seen_m: Float32[np.ndarray, "size size"], goal_m: Float32[np.ndarray, "size size"], tangent: float
) -> Float[np.ndarray, "3"]:
    views_m = np.stack([seen_m, goal_m])
    valid = views_m > 0
    if not valid.any(axis=(1, 2)).all():
        return np.zeros(3)
    size, distance_m = len(goal_m), float(goal_m[valid[1]].mean())
    width_m, padded = 2 * tangent * distance_m, (3 * size // 2, 3 * size // 2)  # shifts up to half a view either way
    relief = np.where(valid, (views_m - distance_m) / width_m, 0)
    seen, goal = fft.rfft2(np.stack([valid, relief, relief**2], axis=1).astype(np.float32), padded)
    spectra = np.stack([np.conj(seen[a]) * goal[b] for a, b in ((0, 0), (0, 1), (1, 0), (0, 2), (2, 0), (1, 1))])
    sums = fft.fftshift(fft.irfft2(spectra, padded), axes=(1, 2))
    common, of_goal, of_seen, goal_squares, seen_squares, products = sums
    common = np.maximum(common, 1)
    variance = (seen_squares + goal_squares - 2 * products) / common - ((of_goal - of_seen) / common) ** 2
    score = common / common.max() - variance / RELIEF_SCATTER**2
    score[common < common.max() / 2] = -np.inf
    rows, columns = np.nonzero(score >= score.max() - ALIKE)
    shift_px = np.array([columns.mean(), rows.mean()]) - padded[0] // 2
    moved = np.roll(seen_m, np.rint(shift_px[::-1]).astype(int), (0, 1))
    both = (moved > 0) & valid[1]
    depth_m = float(np.median(goal_m[both] - moved[both])) if both.any() else 0.0
    return np.array([*(shift_px * width_m / size), depth_m])

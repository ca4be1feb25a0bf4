"""Planes of a depth frame that continue beyond a part of it: a table, a wall, the floor of a tray."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage

from reorient.imaging.depth_image import DepthImage
from reorient.imaging.masks import Mask, longer_side, window

_SAMPLE = 3000  # returns that vote for a plane
_TRIPLES = 600  # planes through three returns each: one of 20% of the returns is missed in 1% of the cases
_COARSE = 0.006  # distance of an inlier of a triple's plane, relative to the median depth: the noise of stereo cameras
_FINE = 2.5  # distance of an inlier of a refined plane, over the noise
_MOST, _LEAST = 6, 0.03  # planes sought one after another; share of the returns that the smallest one holds
_RIM_PX = 3  # width of the rim along which a plane must continue
_RIM_SHARE = 0.03  # of the rim along which a plane must continue
_WIDE = 0.2  # of the rim: a table around an object has nearly all of it, a wall a side, other parts less
_SQUARE = np.ones((3, 3), bool)
_MEDIAN_PX, _MEAN_PX = 5, 9  # windows of densities and of mean heights
_LOWEST_M, _HIGHEST_M = 0.001, 0.004  # range of the smoothed height below which a return belongs to a plane
_SINGLE = 6.0  # distance of a return that needs no neighbours, over the noise
_CERTAIN = 5.0  # mean height of a return that is certainly off a plane, over the noise of such means
# Of total variation: weight, over the noise; iterations; largest height, over the noise; and the smoothed height above
# which a return is off, over the noise. By the intersection over union on 24 frames of household tuning objects, each
# cut out with 40 px around; among weights 1-3, largest heights 4-12, thresholds 1.3-2.2. 1.6 itself was not measured
_WEIGHT, _STEPS, _CLIP = 1.0, 40, 6.0
_ABOVE_NOISE = 1.6
_DOUBTFUL = 0.5  # of that threshold: a return above, next to one that is off, may be off as well. On 14 such frames it
# holds 60% (median) of the returns of the object that are removed with the table


@dataclass(frozen=True, eq=False)
class Plane:
    """Points with ``normal @ p = offset_m`` in camera axes."""

    normal: Float[np.ndarray, "3"]
    """Unit vector towards the side of the camera."""
    offset_m: float
    noise_m: float
    """Standard deviation of the distance of its returns, from their median."""
    rim_share: float = 0.0
    """Share of the rim of a part of the frame along which it continues."""

    @property
    def is_wide(self) -> bool:
        """Whether it can be removed: another part next to the object may have a plane that continues, too."""
        return bool(self.rim_share >= _WIDE)

    def height(self, points_m: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n"]:
        """Distance of points from the plane, metres, positive on the side of the camera."""
        return np.asarray(points_m @ self.normal - self.offset_m)

    def holds(self, points_m: Float[np.ndarray, "*n 3"]) -> Bool[np.ndarray, "*n"]:
        """Whether points are on the plane, by its noise."""
        return np.asarray(np.abs(self.height(points_m)) < max(_FINE * self.noise_m, _LOWEST_M))


def continuing_planes(image: DepthImage, part: Mask) -> list[Plane]:
    """The planes that hold returns of a part of a frame and continue beyond it, those with most returns first.

    A plane continues if it holds returns along the part's rim, and beyond the rim as well, or reaches the end of the
    frame there. So the sides of an object within the part do not count. Planes are found by RANSAC (Fischler and Bolles
    1981) around the part, and refined by least squares. Deterministic.
    """
    rays, rng = image.camera.rays(), np.random.default_rng(0)
    points_m = rays * image.depth_m[..., None]
    rest = image.valid & _surroundings(part)
    least = max(_LEAST * np.count_nonzero(rest), 50)
    found = []
    for _ in range(_MOST):
        plane = _largest_plane(points_m[rest], rng)
        if plane is None:
            break
        on = rest & plane.holds(points_m)
        if np.count_nonzero(on) < least:
            break
        if (share := _rim_share(on, part)) >= _RIM_SHARE:
            found.append(replace(plane, rim_share=share))
        rest &= ~on
    return found


def above(image: DepthImage, part: Mask, plane: Plane) -> tuple[Mask, Mask]:
    """The returns of a part of a frame that do not belong to a plane that continues beyond it, and the doubtful ones.

    Smoothed heights separate objects 5 mm high from a plane with depth noise of 2 mm.
    """
    heights_m = plane.height(image.camera.rays() * image.depth_m[..., None])
    return off_surface(heights_m, image.valid, part, plane.noise_m)


def off_surface(
    heights_m: Float[np.ndarray, "height width"], valid: Mask, part: Mask, noise_m: float
) -> tuple[Mask, Mask]:
    """The returns of a part of a frame that are off a surface, given each one's distance from it and the noise; and the
    doubtful ones.

    Heights without noise are found by total variation (Rudin, Osher and Fatemi 1992), which keeps the outlines: their
    returns off the surface by more than a threshold are the segmentation with the least sum of outline and misfit
    (Chambolle 2004). Of these belong the ones that are connected to certain ones: those with a mean over 9 x 9 pixels
    that is off by five times its noise, and thin parts, off by six times the noise themselves. So the noise of a large
    surface leaves nothing, and the foot of an object and low parts beside high ones stay. Doubtful are those
    nearly as far off that are connected to these: the lowest part of a foot.
    """
    result, doubtful = np.zeros_like(part), np.zeros_like(part)
    near = window(part, 2 * _MEAN_PX)
    heights_m, seen = heights_m[near].astype(np.float32), valid[near]
    nearest = ndimage.distance_transform_edt(~seen, return_distances=False, return_indices=True)
    heights_m = heights_m[tuple(nearest)]
    limit_m = float(np.clip(_ABOVE_NOISE * noise_m, _LOWEST_M, _HIGHEST_M))
    on = seen & (np.abs(heights_m) < max(_FINE * noise_m, _LOWEST_M))
    mean_m = ndimage.uniform_filter(heights_m, _MEAN_PX)
    single = seen & (np.abs(heights_m) > max(_SINGLE * noise_m, limit_m))
    certain = single | (seen & (np.abs(mean_m) > _limit(mean_m, on, _CERTAIN)))
    if not certain.any():
        return result, doubtful
    around = window(certain, longer_side(window(certain)) // 4 + 2 * _MEAN_PX)
    scale_m = limit_m / _ABOVE_NOISE
    smooth = _denoised(np.clip(heights_m[around] / scale_m, -_CLIP, _CLIP))
    off = (np.abs(smooth) > _ABOVE_NOISE) | single[around]
    off = ndimage.binary_propagation(certain[around] & off, _SQUARE, mask=off)
    perhaps = off | (np.abs(smooth) > _DOUBTFUL * _ABOVE_NOISE)
    perhaps = ndimage.binary_propagation(off, _SQUARE, mask=perhaps) & ~off
    for found, within in ((result, off), (doubtful, perhaps)):
        mask = np.zeros_like(seen)
        mask[around] = within
        found[near] = mask & seen & part[near]
    return result, doubtful


def _denoised(values: Float[np.ndarray, "height width"]) -> Float[np.ndarray, "height width"]:
    """The minimum of total variation + |result - values|^2 / (2 weight), by Chambolle's projection (2004)."""
    dual = np.zeros((2, *values.shape), np.float32)
    slope = np.zeros_like(dual)
    result = values.copy()
    for _ in range(_STEPS):
        np.subtract(result[1:], result[:-1], out=slope[0, :-1])
        np.subtract(result[:, 1:], result[:, :-1], out=slope[1, :, :-1])
        dual += slope * np.float32(0.25 / _WEIGHT)
        dual /= np.maximum(1, np.hypot(dual[0], dual[1]))
        divergence = dual[0] + dual[1]
        divergence[1:] -= dual[0, :-1]
        divergence[:, 1:] -= dual[1, :, :-1]
        result = values + np.float32(_WEIGHT) * divergence
    return result


def _limit(smooth_m: Float[np.ndarray, "height width"], on: Mask, above_noise: float) -> float:
    """The distance above which smoothed returns are off a surface, from those on it."""
    noise_m = float(np.median(np.abs(smooth_m[on]))) / 0.6745 if on.any() else 0.0
    return float(np.clip(above_noise * noise_m, _LOWEST_M, _HIGHEST_M))


def _surroundings(part: Mask) -> Mask:
    """The bounding box of a part, extended by a quarter of its longer side."""
    around = np.zeros_like(part)
    around[window(part, longer_side(window(part)) // 4)] = True
    return around


def _rim_share(on: Mask, part: Mask) -> float:
    """The share of a part's rim along which the returns of a plane continue beyond it, densely, not as outliers."""
    on = on & (ndimage.uniform_filter(on.astype(np.float32), _MEDIAN_PX) > 0.5)
    square = np.ones((2 * _RIM_PX + 1,) * 2)
    rim = part & ~ndimage.binary_erosion(part, square)  # the end of the frame is a rim, too
    beyond = np.pad(on & ~part, _RIM_PX, constant_values=True)
    beyond = ndimage.binary_dilation(beyond, square)[_RIM_PX:-_RIM_PX, _RIM_PX:-_RIM_PX]
    return float(np.count_nonzero(rim & on & beyond) / np.count_nonzero(rim))


def _largest_plane(points_m: Float[np.ndarray, "n 3"], rng: np.random.Generator) -> Plane | None:
    """The plane with most of the points; None for fewer than three points, or none but on a line."""
    if len(points_m) < 3:
        return None
    sample_m = points_m[rng.integers(len(points_m), size=_SAMPLE)]
    tolerance_m = _COARSE * float(np.median(sample_m[:, 2]))
    a, b, c = sample_m[rng.integers(_SAMPLE, size=(3, _TRIPLES))]
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    apart = lengths[:, 0] > 1e-9
    if not apart.any():
        return None
    normals, a = (normals / np.where(lengths > 0, lengths, 1))[apart], a[apart]
    distances_m = np.abs(sample_m @ normals.T - np.sum(normals * a, axis=1))
    best = int(np.argmax((distances_m < tolerance_m).sum(axis=0)))
    plane = Plane(normals[best], float(normals[best] @ a[best]), tolerance_m / _FINE)
    for _ in range(4):
        inliers_m = sample_m[plane.holds(sample_m)]
        if len(inliers_m) < 3:
            return None
        plane = _fitted(inliers_m)
    return plane


def _fitted(points_m: Float[np.ndarray, "n 3"]) -> Plane:
    """The plane of least squares, and the noise from the median distance."""
    middle_m = points_m.mean(axis=0)
    normal = np.linalg.eigh((points_m - middle_m).T @ (points_m - middle_m))[1][:, 0]
    normal = normal if normal @ middle_m < 0 else -normal
    distances_m = np.abs((points_m - middle_m) @ normal)
    return Plane(normal, float(normal @ middle_m), float(np.median(distances_m)) / 0.6745)

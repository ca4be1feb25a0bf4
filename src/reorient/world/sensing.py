"""The sensor model p(I | R): from exact depth to a measured depth image.

From the paper ("Dataset Generation"): a thin rectangle without returns on the start image (the gripper), and dropped
pixels. Beyond the paper, for a structured-light camera: depth noise that is smooth over pixels, returns lost at grazing
angles, flying pixels at depth edges, and the shadow of a projector beside the camera, by a second ray cast.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy.random import Generator
from scipy import ndimage

from reorient.imaging import Camera, DepthImage
from reorient.world.rendering import Placement, Renderer


@dataclass(frozen=True)
class Sensor:
    """Parameters of the sensor model; the default is exact."""

    rectangle: bool = False
    """Remove the returns in a thin rectangle through the object, on images with ``occluded=True``."""
    dropout: float = 0.0
    """Share of pixels without return."""
    noise_m: float = 0.0
    """Standard deviation of the depth noise."""
    noise_scale_px: float = 1.0
    """Standard deviation of the Gaussian filter that smooths the noise."""
    grazing_cos: float = 0.0
    """All returns with |cos| of incidence below this are lost, and some up to twice this. 0: none."""
    flying: float = 0.0
    """Share of the pixels at depth edges whose depth lies between the two surfaces."""
    projector_m: tuple[float, float, float] | None = None
    """Position of the projector, camera axes; None: no shadow."""


def randomised(noise_m: float = 0.0) -> Sensor:
    """The paper's rectangle and dropout; with noise, the errors of a structured-light camera as well."""
    if noise_m == 0:
        return Sensor(rectangle=True, dropout=0.01)
    return Sensor(True, 0.01, noise_m, grazing_cos=0.12, flying=0.2, projector_m=(0.1, 0.0, 0.0))


FLYING_REACH_M = 0.02  # largest depth of a flying pixel behind an edge with no surface behind it
RECTANGLE_PX = ((4.0, 10.0), (40.0, 160.0))  # ranges of thickness and length, for an image 128 px wide


def sense(
    rng: Generator,
    renderer: Renderer,
    camera: Camera,
    R_camera_object: Float[np.ndarray, "3 3"],
    placement: Placement,
    sensor: Sensor,
    quantum_m: float = 0.0,
    occluded: bool = False,
) -> DepthImage:
    """One depth image of the object at a pose. ``occluded``: the rectangle is on this image (that of the start).

    Raises ReorientError if the image has no return.
    """
    if sensor.grazing_cos > 0:
        exact_m, cosine = renderer.depth_and_incidence(camera, R_camera_object, placement)
    else:
        exact_m, cosine = renderer.depth(camera, R_camera_object, placement), None
    exact = DepthImage(exact_m, camera)
    seen = exact.valid
    lost = np.zeros_like(seen)
    if sensor.projector_m is not None:
        lost[seen] = renderer.shadowed(exact.points(), np.array(sensor.projector_m), R_camera_object, placement)
    if cosine is not None:
        lost |= cosine < sensor.grazing_cos * rng.uniform(1, 2, cosine.shape)
    depth_m = _with_errors(rng, exact_m, seen, sensor)
    if sensor.dropout > 0:
        lost |= rng.random(lost.shape) < sensor.dropout
    if sensor.rectangle and occluded:
        lost |= thin_rectangle(rng, seen)
    return DepthImage(_quantised(np.where(seen & ~lost, depth_m, 0), quantum_m), camera)


def _with_errors(rng: Generator, depth_m: np.ndarray, seen: np.ndarray, sensor: Sensor) -> np.ndarray:
    """Depth with smooth noise and flying pixels."""
    if sensor.noise_m > 0:
        noise = ndimage.gaussian_filter(rng.standard_normal(depth_m.shape), sensor.noise_scale_px)
        depth_m = depth_m + sensor.noise_m / _smoothed_deviation(sensor.noise_scale_px) * noise
    return _with_flying_pixels(rng, depth_m, seen, sensor.flying) if sensor.flying > 0 else depth_m


def _quantised(depth_m: np.ndarray, quantum_m: float) -> np.ndarray:
    """Depth in whole steps of ``quantum_m`` (0: unchanged), none below 0."""
    if quantum_m > 0:
        depth_m = np.rint(depth_m / quantum_m) * quantum_m
    return np.asarray(np.maximum(depth_m, 0))


def thin_rectangle(rng: Generator, seen: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """A thin rectangle, in any direction, centred on a random pixel of the object (paper, "Dataset Generation")."""
    rows, columns = np.nonzero(seen)
    i = rng.integers(len(rows))
    unit = seen.shape[1] / 128
    thickness, length = (rng.uniform(*limits) * unit for limits in RECTANGLE_PX)
    direction = rng.uniform(0, np.pi)
    dx, dy = np.arange(seen.shape[1]) - columns[i], np.arange(seen.shape[0])[:, None] - rows[i]
    along = dx * np.cos(direction) + dy * np.sin(direction)
    across = dy * np.cos(direction) - dx * np.sin(direction)
    return np.asarray((np.abs(along) <= length / 2) & (np.abs(across) <= thickness / 2))


def _smoothed_deviation(scale_px: float) -> float:
    """Standard deviation of unit white noise after the Gaussian filter: the norm of the kernel."""
    impulse = np.zeros(8 * int(np.ceil(scale_px)) + 9)
    impulse[len(impulse) // 2] = 1
    return float(np.sum(ndimage.gaussian_filter1d(impulse, scale_px) ** 2))


def _with_flying_pixels(rng: Generator, depth_m: np.ndarray, seen: np.ndarray, share: float) -> np.ndarray:
    """Some pixels at a depth edge get a depth between the near and the far side, or behind the outline."""
    behind = ndimage.maximum_filter(np.where(seen, depth_m, 0), size=3)
    outline = seen & ~ndimage.binary_erosion(seen, np.ones((3, 3)), border_value=1)
    behind = np.where(outline, np.maximum(behind, depth_m + FLYING_REACH_M), behind)
    edge = seen & (behind - depth_m > 0.005)
    flies = edge & (rng.random(depth_m.shape) < share)
    return np.where(flies, depth_m + rng.random(depth_m.shape) * (behind - depth_m), depth_m)

"""p(I | R): what a real sensor makes of exact depth (paper, "Dataset Generation", and a structured-light camera).

The paper's part: a thin rectangle without returns (the gripper's shadow on the start image), and dropped pixels.
Ours: depth noise smooth over pixels, returns lost at grazing angles, flying pixels at depth edges, and the shadow of a
projector beside the camera, found by a second ray cast.
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
    """A sensor model; the default is exact."""

    rectangle: bool = False
    """Blank a thin rectangle through the object, where the image is asked to be occluded."""
    dropout: float = 0.0
    """Share of pixels without return."""
    noise_m: float = 0.0
    """Standard deviation of the depth noise."""
    noise_scale_px: float = 1.0
    """Gaussian radius over which the noise is smooth."""
    grazing_cos: float = 0.0
    """Below this |cos| of incidence all returns are lost; up to twice it, some. 0: none."""
    flying: float = 0.0
    """Share of the pixels at depth edges that float between the two surfaces."""
    projector_m: tuple[float, float, float] | None = None
    """The projector's place in camera axes; None: nothing lies in its shadow."""


def randomised(noise_m: float = 0.0) -> Sensor:
    """The paper's rectangle and dropouts; with noise, a structured-light camera of that noise on top of them."""
    if noise_m == 0:
        return Sensor(rectangle=True, dropout=0.01)
    return Sensor(True, 0.01, noise_m, grazing_cos=0.12, flying=0.2, projector_m=(0.1, 0.0, 0.0))


FLYING_REACH_M = 0.02  # how far behind an edge against nothing a flying pixel may float
RECTANGLE_PX = ((4.0, 10.0), (40.0, 160.0))  # thickness and length, of an image 128 px wide


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
    """One depth image of the object in a pose. ``occluded``: the rectangle lies on this image (the start's).

    Raises ReorientError where nothing of the object is seen.
    """
    if sensor.grazing_cos > 0:
        depth_m, cosine = renderer.depth_and_incidence(camera, R_camera_object, placement)
    else:
        depth_m, cosine = renderer.depth(camera, R_camera_object, placement), None
    exact = DepthImage(depth_m, camera)
    seen = exact.valid
    lost = np.zeros_like(seen)
    if sensor.projector_m is not None:
        lost[seen] = renderer.shadowed(exact.points(), np.array(sensor.projector_m), R_camera_object, placement)
    if cosine is not None:
        lost |= cosine < sensor.grazing_cos * rng.uniform(1, 2, cosine.shape)
    if sensor.noise_m > 0:
        noise = ndimage.gaussian_filter(rng.standard_normal(depth_m.shape), sensor.noise_scale_px)
        depth_m = depth_m + sensor.noise_m / _smoothed_deviation(sensor.noise_scale_px) * noise
    if sensor.flying > 0:
        depth_m = _with_flying_pixels(rng, depth_m, seen, sensor.flying)
    if sensor.dropout > 0:
        lost |= rng.random(lost.shape) < sensor.dropout
    if sensor.rectangle and occluded:
        lost |= thin_rectangle(rng, seen)
    kept = np.where(seen & ~lost, depth_m, 0)
    if quantum_m > 0:
        kept = np.rint(kept / quantum_m) * quantum_m
    return DepthImage(np.maximum(kept, 0), camera)


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
    return (np.abs(along) <= length / 2) & (np.abs(across) <= thickness / 2)


def _smoothed_deviation(scale_px: float) -> float:
    """Standard deviation left of unit white noise after the Gaussian filter: the kernel's norm."""
    impulse = np.zeros(8 * int(np.ceil(scale_px)) + 9)
    impulse[len(impulse) // 2] = 1
    return float(np.sum(ndimage.gaussian_filter1d(impulse, scale_px) ** 2))


def _with_flying_pixels(rng: Generator, depth_m: np.ndarray, seen: np.ndarray, share: float) -> np.ndarray:
    """Some pixels at a depth edge take a depth between the near and the far side (or float free of the outline)."""
    behind = ndimage.maximum_filter(np.where(seen, depth_m, 0), size=3)
    outline = seen & ~ndimage.binary_erosion(seen, np.ones((3, 3)), border_value=1)
    behind = np.where(outline, np.maximum(behind, depth_m + FLYING_REACH_M), behind)
    edge = seen & (behind - depth_m > 0.005)
    flies = edge & (rng.random(depth_m.shape) < share)
    return np.where(flies, depth_m + rng.random(depth_m.shape) * (behind - depth_m), depth_m)

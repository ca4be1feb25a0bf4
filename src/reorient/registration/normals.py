"""The plane of the surface around each return of a depth image."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from reorient.imaging import DepthImage

_WINDOW = np.argwhere(np.ones((5, 5))) - 2  # row and column offsets of a plane fit; not tuned
_BASIS = np.concatenate([_WINDOW[:, ::-1], np.ones((len(_WINDOW), 1))], axis=1)  # column, row, 1
_PRODUCTS = np.einsum("ki,kj->kij", _BASIS, _BASIS).reshape(len(_BASIS), 9)
_NEARNESS = np.sum(_WINDOW**2, axis=1) / 4
_EDGE_SLOPE = 3.0  # depth per pixel, in pixel widths, beyond which a neighbour hardly counts as the same surface


@dataclass(frozen=True, eq=False)
class Planes:
    """The plane ``normal @ x = offset_m`` through the surface at every return, row by row, in camera axes."""

    normals: Float[np.ndarray, "n 3"]
    """Unit vectors towards the camera."""
    offsets_m: Float[np.ndarray, " n"]


def fit_planes(image: DepthImage) -> Planes:
    """Planes fitted to the 5 x 5 neighbours of each return that lie on the same side of depth edges.

    A plane is linear in inverse depth over the image, so the fit is a small weighted regression at every pixel.
    """
    camera = image.camera
    inverse = np.zeros((camera.height + 4, camera.width + 4))
    inner = inverse[2:-2, 2:-2]
    inner[image.valid] = 1 / image.depth_m[image.valid]
    rows, columns = np.nonzero(image.valid)
    place = (rows + 2) * inverse.shape[1] + columns + 2
    near = inverse.ravel()[place[:, None] + (_WINDOW[:, 0] * inverse.shape[1] + _WINDOW[:, 1])]
    center = near[:, len(_WINDOW) // 2][:, None]
    slope = (near - center) / center * np.sqrt(camera.fx * camera.fy)  # in pixel widths
    weight = np.exp(-_NEARNESS - (slope / _EDGE_SLOPE) ** 2) * (near > 0)
    left = (weight @ _PRODUCTS).reshape(-1, 3, 3) + 1e-6 * np.diag([1.0, 1.0, 0.0])  # a lone return faces the camera
    du, dv, value = np.moveaxis(np.linalg.solve(left, ((weight * near) @ _BASIS)[..., None])[..., 0], -1, 0)
    x, y = (columns + 0.5 - camera.cx) / camera.fx, (rows + 0.5 - camera.cy) / camera.fy
    a, b = du * camera.fx, dv * camera.fy
    normals = -np.stack([a, b, value - a * x - b * y], axis=-1)  # times x it is -1 on the plane
    length = np.linalg.norm(normals, axis=1)
    return Planes(normals / length[:, None], -1 / length)

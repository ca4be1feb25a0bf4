"""A gripper that holds an object and rotates with it: two or three fingers, a palm and a forearm, made of boxes.

Cast with the object, it gives the pixels that a mask of the gripper removes from the image, and its shadow.
"""

import numpy as np
import trimesh
from jaxtyping import Bool, Float
from numpy.random import Generator

from reorient import so3
from reorient.imaging import Camera
from reorient.world.in_hand import Hand, Range
from reorient.world.rendering import Placement, Renderer

_BOX = trimesh.creation.box()
_CORNERS, _FACES = _BOX.vertices > 0, np.asarray(_BOX.faces)


class Gripper:
    """Rendered like the object, at the object's poses."""

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        """``mesh``: metres, in the object's axes about its origin."""
        self._renderer = Renderer(mesh)
        self._offset_m = mesh.bounds.mean(axis=0)  # the renderer centres its mesh

    def depth(
        self, camera: Camera, R_camera_object: Float[np.ndarray, "3 3"], placement: Placement
    ) -> Float[np.ndarray, "height width"]:
        """Exact depth, metres, 0 where the gripper is not hit; ``placement`` is the object's."""
        return self._renderer.depth(camera, R_camera_object, self._placed(R_camera_object, placement))

    def shadows(
        self,
        points_m: Float[np.ndarray, "n 3"],
        projector_m: Float[np.ndarray, "3"],
        R_camera_object: Float[np.ndarray, "3 3"],
        placement: Placement,
    ) -> Bool[np.ndarray, " n"]:
        """Whether the gripper hides each point from a projector; points and projector in camera axes."""
        placed = self._placed(R_camera_object, placement)
        return self._renderer.shadowed(points_m, projector_m, R_camera_object, placed)

    def _placed(self, R_camera_object: Float[np.ndarray, "3 3"], placement: Placement) -> Placement:
        return Placement(1.0, placement.center_m + R_camera_object @ self._offset_m)


def grip(
    rng: Generator, renderer: Renderer, placement: Placement, R_camera_object: Float[np.ndarray, "k 3 3"], hand: Hand
) -> Gripper:
    """A gripper at the object, for k poses in none of which its forearm points at the camera (if that is possible)."""
    approach = _approach(rng, R_camera_object, hand.towards_camera)
    closing = np.cross(approach, so3.sample_axes(rng, 1)[0])
    closing /= np.linalg.norm(closing)
    axes = np.stack([closing, np.cross(approach, closing), approach], axis=1)  # object axes of a gripper's x, y, z
    vertices_m = placement.scale_m * renderer.mesh.vertices
    radius_m = float(np.linalg.norm(vertices_m, axis=1).max())
    end_m = float((vertices_m @ approach).max())

    def size_m(limits: Range) -> float:
        return rng.uniform(*limits) * radius_m

    tip_m, width_m, thickness_m = rng.uniform(*hand.reach) * end_m, size_m(hand.finger_width), 0.0
    palm_m = end_m + size_m(hand.palm_gap)
    rows = [0.0]
    boxes = []
    for side in (1, -1):
        if side == -1 and rng.random() < hand.three_fingers:
            rows = [-width_m, width_m]
        thickness_m = size_m(hand.finger_thickness)
        for row_m in rows:
            inner_m = _contact(renderer, placement, axes, (side, row_m, tip_m), radius_m)
            x = sorted((side * inner_m, side * (inner_m + thickness_m)))
            boxes.append((x, (row_m - width_m / 2, row_m + width_m / 2), (tip_m - width_m / 2, palm_m)))
    half = size_m(hand.palm_width) / 2
    spread = max(abs(x) for box in boxes for x in box[0])
    back_m = palm_m + size_m(hand.palm_depth)
    boxes.append(([-max(half, spread), max(half, spread)], (-half, half), (palm_m, back_m)))
    half = size_m(hand.arm_width) / 2
    boxes.append(([-half, half], (-half, half), (back_m, back_m + hand.arm_length * radius_m)))
    low, high = np.moveaxis(np.array(boxes, float), 2, 0)[:, :, None]
    vertices = np.where(_CORNERS, high, low).reshape(-1, 3)
    faces = (_FACES + 8 * np.arange(len(boxes))[:, None, None]).reshape(-1, 3)
    return Gripper(trimesh.Trimesh(vertices @ axes.T, faces, process=False))


def _approach(
    rng: Generator, R_camera_object: Float[np.ndarray, "k 3 3"], towards_camera: float
) -> Float[np.ndarray, "3"]:
    """A direction in object axes: of 64 drawn ones the first that is allowed in all poses, else the least wrong."""
    drawn = so3.sample_axes(rng, 64)
    towards = (-drawn @ R_camera_object[:, 2].T).max(axis=1)
    allowed = np.flatnonzero(towards <= towards_camera)
    return np.asarray(drawn[allowed[0] if len(allowed) else towards.argmin()])


def _contact(
    renderer: Renderer,
    placement: Placement,
    axes: Float[np.ndarray, "3 3"],
    tip: tuple[float, float, float],
    radius_m: float,
) -> float:
    """Distance from the approach axis at which a finger that closes touches the object, metres; 0 if it misses."""
    side, row_m, tip_m = tip
    outside = axes @ np.array([side * 2 * radius_m, row_m, tip_m])
    distance_m = placement.scale_m * renderer.distances(outside[None] / placement.scale_m, -side * axes[:, :1].T)[0]
    return float(max(2 * radius_m - distance_m, 0.0))

"""The goal: a primary depth image of the object as desired, and further views of it from known sides."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from reorient import so3
from reorient.errors import ReorientError
from reorient.extras import extras_named
from reorient.imaging.camera import Camera
from reorient.imaging.depth_image import DepthImage
from reorient.imaging.viewpoints import spread_rotations
from reorient.se3 import Transform

MESH_VIEWS = 5
"""Further views of a goal from a mesh: with the primary one they look along six directions."""


@dataclass(frozen=True, eq=False)
class GoalView:
    """A further view of the goal object, taken after it was rotated away from the goal pose.

    Raises ReorientError where the rotation is none, or the translation is not three finite metres.
    """

    image: DepthImage
    R_goal_view: Float[np.ndarray, "3 3"]
    """Takes the object from the pose of this view to the goal pose (camera axes, left multiplication)."""
    t_goal_view_m: Float[np.ndarray, "3"] | None = None
    """With it, p_goal = R_goal_view p_view + t_goal_view_m, camera axes, metres; the motion is taken as exact.
    None: unknown, about the pivot; rotation and translation are then aligned to the other views."""

    def __post_init__(self) -> None:
        if not isinstance(self.image, DepthImage):
            raise ReorientError(f"image of a goal view is a {type(self.image).__name__}: expected DepthImage")
        try:
            R = np.asarray(self.R_goal_view, float)
            t_m = np.zeros(3) if self.t_goal_view_m is None else np.asarray(self.t_goal_view_m, float)
        except (TypeError, ValueError):
            R = t_m = np.empty(0)
        if not so3.is_rotation(R):
            raise ReorientError("R_goal_view: expected a (3, 3) rotation matrix")
        if t_m.shape != (3,) or not np.isfinite(t_m).all():
            raise ReorientError(f"t_goal_view_m {self.t_goal_view_m}: expected three finite metres, or None")
        object.__setattr__(self, "R_goal_view", R)
        object.__setattr__(self, "t_goal_view_m", None if self.t_goal_view_m is None else t_m)


@dataclass(frozen=True, eq=False)
class Goal:
    """The object as desired. Raises ReorientError for anything but a depth image and goal views."""

    image: DepthImage
    """The primary view: the object in the goal pose."""
    views: tuple[GoalView, ...] = ()
    """Further views of the same object."""

    def __post_init__(self) -> None:
        if not isinstance(self.image, DepthImage):
            raise ReorientError(f"goal is a {type(self.image).__name__}: expected DepthImage(depth_m, camera)")
        object.__setattr__(self, "views", tuple(self.views))
        if not all(isinstance(view, GoalView) for view in self.views):
            raise ReorientError("views of the goal: expected GoalView(image, R_goal_view, t_goal_view_m)")

    @classmethod
    def from_mesh(
        cls,
        path: str | Path,
        T_camera_object: Transform,
        camera: Camera,
        unit_m: float = 0.001,
        views: int = MESH_VIEWS,
    ) -> "Goal":
        """A goal rendered from a mesh file (.stl, .obj, .ply, ...) without noise, with ``views`` further views.

        ``T_camera_object`` takes the mesh, in metres, to the goal pose in camera axes. ``unit_m``: metres per unit of
        the file. The further views show the object rotated about the centre of its bounding box, so that all sides are
        visible. Raises ReorientError for a broken file, for a transform that is not rigid, and where the object is not
        inside the view as a whole, as with a wrong unit; MissingExtra without the extra ``sim``.
        """
        with extras_named():
            from reorient.world.mesh_goal import mesh_goal
        return mesh_goal(path, T_camera_object, camera, unit_m, spread_rotations(views))


def as_goal(goal: DepthImage | Goal) -> Goal:
    """The goal itself, or one of a single view. Raises ReorientError for anything else."""
    return goal if isinstance(goal, Goal) else Goal(goal)

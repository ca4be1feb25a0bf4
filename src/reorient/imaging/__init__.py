"""Depth images and cameras, their files, isolation, and the virtual camera."""

from reorient.imaging.camera import Camera
from reorient.imaging.clusters import without_strays
from reorient.imaging.depth_image import DepthImage
from reorient.imaging.goal import Goal, GoalView, as_goal
from reorient.imaging.isolation import Isolation, isolate

__all__ = ["Camera", "DepthImage", "Goal", "GoalView", "Isolation", "as_goal", "isolate", "without_strays"]

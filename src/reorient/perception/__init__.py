"""Perception of a held object: calibration of the cell's cameras, colour, segmentation.

A name is imported when it is first used: a frame holds the robot as a mesh, which needs the extra ``sim``.
"""

from typing import TYPE_CHECKING

from reorient.extras import imported_on_use

if TYPE_CHECKING:
    from reorient.perception.calibration import Calibration, MountedCamera, read_calibration, write_calibration
    from reorient.perception.frame import ColorImage, Frame
    from reorient.perception.recalibration import corrected_calibration
    from reorient.perception.segmentation import ByColour, ByShape, isolate_object, learn_gripper_colour, object_mask

__all__ = [
    "ByColour",
    "ByShape",
    "Calibration",
    "ColorImage",
    "Frame",
    "MountedCamera",
    "corrected_calibration",
    "isolate_object",
    "learn_gripper_colour",
    "object_mask",
    "read_calibration",
    "write_calibration",
]
_MODULES = {
    "calibration": ("Calibration", "MountedCamera", "read_calibration", "write_calibration"),
    "frame": ("ColorImage", "Frame"),
    "recalibration": ("corrected_calibration",),
    "segmentation": ("ByColour", "ByShape", "isolate_object", "learn_gripper_colour", "object_mask"),
}
if not TYPE_CHECKING:  # a type checker shall see the names above and no others
    __getattr__ = imported_on_use(__name__, _MODULES)

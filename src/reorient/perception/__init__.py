"""Perception of a held object: calibration of the cell's cameras, colour, segmentation."""

from reorient.perception.calibration import Calibration, MountedCamera, read_calibration, write_calibration
from reorient.perception.frame import ColorImage, Frame
from reorient.perception.recalibration import corrected_calibration
from reorient.perception.segmentation import ByColour, ByShape, isolate_object, learn_gripper_colour, object_mask

corrected = corrected_calibration  # the name in earlier documentation

__all__ = [
    "ByColour",
    "ByShape",
    "Calibration",
    "ColorImage",
    "Frame",
    "MountedCamera",
    "corrected",
    "corrected_calibration",
    "isolate_object",
    "learn_gripper_colour",
    "object_mask",
    "read_calibration",
    "write_calibration",
]

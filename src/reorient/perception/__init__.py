"""Perception of a held object: calibration of the cell's cameras, colour, segmentation."""

from reorient.perception.calibration import Calibration, MountedCamera, read_calibration, write_calibration
from reorient.perception.recalibration import corrected
from reorient.perception.segmentation import ByShape, ColorImage, Frame, isolate_object, object_mask

__all__ = [
    "ByShape",
    "Calibration",
    "ColorImage",
    "Frame",
    "MountedCamera",
    "corrected",
    "isolate_object",
    "object_mask",
    "read_calibration",
    "write_calibration",
]

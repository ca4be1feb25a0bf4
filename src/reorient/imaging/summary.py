"""An isolated object in numbers, and what in a pair of images makes a wrong isolation likely."""

from dataclasses import dataclass

import numpy as np

from reorient.errors import ReorientError
from reorient.imaging.connected import size_m
from reorient.imaging.depth_image import DepthImage
from reorient.imaging.goal import Goal

_LARGEST_RATIO = 1.5  # of the sizes in current and goal image
_LARGE_MM = 1000.0  # no gripper holds a larger object: the scale of the depth is wrong more likely
_WRONG_SCALE = 2.0  # of the sizes of the object now and a goal of several views: no view of one object differs by more
_UNITS = {10.0: ("mm", "cm"), 25.4: ("mm", "in"), 1000.0: ("mm", "m"), 2.54: ("cm", "in"), 39.37: ("in", "m")}
_UNIT_RATIO = 1.4  # of a ratio of sizes, which depends on the view, to that of two units
_FEWEST_PX = 3  # returns at the end of the frame of an object that touches it


@dataclass(frozen=True)
class Summary:
    """The visible part of an isolated object."""

    size_m: tuple[float, float, float]
    """Extents along its principal axes, largest first, without the outermost 1% of the returns."""
    distance_m: float
    """Median depth."""
    pixels: int
    """Returns."""
    touches_frame: bool
    """Whether returns are at the end of the frame, so that a part of the object may be beyond it."""

    @classmethod
    def of(cls, image: DepthImage) -> "Summary":
        """The summary of an isolated image."""
        points_m = image.points()
        ends = [image.valid[0], image.valid[-1], image.valid[:, 0], image.valid[:, -1]]
        first, second, third = (float(x) for x in size_m(points_m))
        touches = bool(max(np.count_nonzero(end) for end in ends) >= _FEWEST_PX)
        return cls((first, second, third), float(np.median(points_m[:, 2])), len(points_m), touches)

    def __str__(self) -> str:
        extents = " x ".join(f"{1000 * x:.0f}" for x in self.size_m)
        return f"object of {extents} mm at {self.distance_m:.2f} m, {self.pixels} px"


def pair_warnings(current: Summary, goal: Summary) -> list[str]:
    """What in a pair of images makes a wrong isolation likely, a sentence each."""
    warnings = [
        f"the object touches the frame of the {name} image: a part of it may be beyond"
        for name, summary in (("current", current), ("goal", goal))
        if summary.touches_frame
    ]
    sizes_mm = [1000 * float(np.linalg.norm(summary.size_m)) for summary in (current, goal)]
    if max(sizes_mm) > _LARGEST_RATIO * min(sizes_mm):
        warnings.append(
            f"the object measures {sizes_mm[0]:.0f} mm in the current image and {sizes_mm[1]:.0f} mm in the goal "
            "image: is it the same object, and isolated completely? (--show-input)"
        )
    if min(sizes_mm) > _LARGE_MM:
        warnings.append(
            f"the object measures {sizes_mm[0] / 1000:.1f} m at {current.distance_m:.1f} m: is the depth scale right? "
            "(--depth-scale; the translation depends on it, the rotation does not)"
        )
    return warnings


def check_scale(current: DepthImage, goal: Goal) -> None:
    """Raise ReorientError where the object now cannot have the size of a goal of several views, as with a wrong unit.

    Seen whole, it is at most as long as the goal, and at least as long as the goal is wide.
    """
    if not goal.views:
        return
    sizes_m = np.array([size_m(image.points()) for image in (goal.image, *(view.image for view in goal.views))])
    now_m = float(size_m(current.points())[0])
    longest_m, width_m = float(sizes_m[:, 0].max()), float(sizes_m[:, 1].min())
    if width_m / _WRONG_SCALE <= now_m <= longest_m * _WRONG_SCALE:
        return
    ratio = float(np.median(sizes_m[:, 0])) / now_m
    factor = min(_UNITS, key=lambda x: abs(np.log(x) - abs(np.log(ratio))))
    cure = "expected the same object, isolated completely"
    if abs(np.log(factor) - abs(np.log(ratio))) < np.log(_UNIT_RATIO):
        true, stated = _UNITS[factor] if ratio > 1 else _UNITS[factor][::-1]
        cure = f"a factor of about {factor:g}, as of a mesh in {true} that is read as {stated}: expected another --unit"
    raise ReorientError(
        f"the object measures {1000 * now_m:.3g} mm now and {1000 * longest_m:.3g} mm in the views of the goal: {cure}"
    )

"""The options of verbs that open the 3D view in a browser."""

import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING

from reorient.errors import check_range

if TYPE_CHECKING:
    from reorient.imaging import DepthImage
    from reorient.se3 import Transform
    from reorient.viewing.guide_view import GuideView
    from reorient.viewing.viewer import Viewer


@dataclass(frozen=True)
class ViewOptions:
    """The 3D view in a browser.

    It needs the extra view: pip install 'reorient[view]'.
    """

    host: str = "127.0.0.1"
    """Address that the view listens at. Any other than this computer's own is warned of: whoever reaches it sees the
    view and, with --station, commands the robot."""
    port: int = 8080
    """Port of the view; the next free one where it is taken."""

    def __post_init__(self) -> None:
        """Raises ReorientError for values out of range."""
        check_range(self, "port", high=65535)

    def open(self, goal: "DepthImage", title: str, T_camera_base: "Transform | None" = None) -> "Viewer":
        """The view of a goal; prints its address. Raises ReorientError where the extra is not installed."""
        from reorient.viewing.viewer import Viewer

        viewer = Viewer(goal, title, self.host, self.port, T_camera_base)
        self._announce(viewer.address)
        return viewer

    def guide(self, goal: "DepthImage", title: str, tolerance_deg: float) -> "GuideView":
        """The view of a guide; prints its address. Raises ReorientError where the extra is not installed."""
        from reorient.viewing.guide_view import GuideView

        view = GuideView(goal, title, tolerance_deg, self.host, self.port)
        self._announce(view.address)
        return view

    def _announce(self, address: str) -> None:
        """Print the address, and a warning where others than this computer reach it."""
        from reorient.viewing.showing import LOOPBACK

        if self.host not in LOOPBACK:
            print(
                f"reorient: warning: the view listens at {self.host}: whoever reaches this address sees it and can use "
                "its buttons; there is no password",
                file=sys.stderr,
            )
        print(f"view: {address}", flush=True)


def base_in_camera(station: object) -> "Transform | None":
    """The pose of the robot's base in camera axes, where the station has a calibration."""
    from reorient import se3

    T_base_camera = getattr(getattr(station, "calibration", None), "T_base_camera", None)
    return None if T_base_camera is None else se3.inverse(T_base_camera)

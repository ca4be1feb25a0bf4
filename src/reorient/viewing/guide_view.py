"""The view of ``reorient guide``: how the object is to be rotated by hand, live.

A subscriber of the guide. Only the latest state is drawn, by a thread of the view: a slow browser delays nothing.
"""

from itertools import pairwise

import numpy as np

from reorient import so3
from reorient.controller.guiding import GuideState
from reorient.imaging import DepthImage
from reorient.reporting.scenes import at_most
from reorient.viewing.showing import (
    AXIS,
    CURRENT,
    GOAL,
    LOOPBACK,
    PORT,
    View,
    add_cloud,
    look_at,
    plain,
)

NEAR_DEG = 10.0  # the bar is yellow below this, red above
_MATCHED, _CLOSE, _FAR = (0, 158, 115), (230, 159, 0), (213, 94, 0)
_MOST_PX = 96
_ARC = 24  # pieces of the arrow


class GuideView(View):
    """The ghost of the goal over the object as it is, an arrow of the rotation that remains, its angle, a bar."""

    def __init__(
        self, goal: DepthImage, title: str, tolerance_deg: float, host: str = LOOPBACK[0], port: int = PORT
    ) -> None:
        """Raises ReorientError where the extra ``view`` is not installed."""
        super().__init__(title, host, port)
        self._goal, self._tolerance_deg = at_most(goal, _MOST_PX), tolerance_deg
        self._middle_m, self._radius_m = look_at(self.server, self._goal)
        gui = self.server.gui
        self._instruction = gui.add_markdown("")
        self._bar = gui.add_progress_bar(0.0)
        self._numbers = gui.add_markdown("")
        gui.add_markdown("light blue: the goal as it lies now; orange: the object; white: how to rotate it")
        add_cloud(self.server.scene, "/ghost/points", self._goal, np.array(GOAL))
        self.drawn = 0
        """Number of states drawn so far."""
        self._latest: GuideState | None = None

    def __call__(self, state: GuideState) -> None:
        """Show a state soon, in place of any that is not shown yet."""
        self._latest = state
        self._inbox.put(state)

    def _draw_new(self, state: GuideState) -> None:
        """Draw the latest state alone."""
        if state is self._latest:
            self._draw(state)

    def _draw(self, state: GuideState) -> None:
        scene, estimate = self.server.scene, state.estimate
        with self.server.atomic():
            self._instruction.content = f"# {plain(state.instruction)}"
            self._say(state)
            if state.image is not None:
                add_cloud(scene, "/object", at_most(state.image, _MOST_PX), np.array(CURRENT))
            for name in ("/ghost", "/arrow"):
                scene.add_frame(name, show_axes=False, visible=estimate is not None)
            if estimate is not None:
                # the goal moved to the object: the inverse of the estimate
                R = estimate.R_goal_current.T
                at_m = -R @ estimate.t_goal_current_m
                scene.add_frame("/ghost", show_axes=False, wxyz=so3.quat_from_matrix(R), position=at_m)
                self._arrow(state, R @ self._middle_m + at_m)
        self.drawn += 1

    def _say(self, state: GuideState) -> None:
        """The bar and the angle."""
        angle_rad = state.angle_rad
        if angle_rad is None:
            self._bar.value, self._bar.color = 0.0, _FAR
            self._numbers.content = state.status.replace("_", " ")
            return
        angle_deg = float(np.degrees(angle_rad))
        colour = _MATCHED if angle_deg <= self._tolerance_deg else _CLOSE if angle_deg <= NEAR_DEG else _FAR
        self._bar.value, self._bar.color = 100 * (1 - np.sqrt(angle_deg / 180)), colour  # fine near the goal
        self._numbers.content = (
            f"**{angle_deg:.1f} deg** remaining; {state.status.replace('_', ' ')}; part {state.part + 1}"
        )

    def _arrow(self, state: GuideState, middle_m: np.ndarray) -> None:
        """An arc of the remaining angle about the axis, with an arrowhead, and the axis."""
        axis, angle_rad = state.axis, state.angle_rad
        assert axis is not None
        assert angle_rad is not None
        across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
        across *= 1.2 * self._radius_m / np.linalg.norm(across)
        arc_m = np.array(
            [middle_m + so3.exp(share * angle_rad * axis) @ across for share in np.linspace(0, 1, _ARC + 1)]
        )
        along = 1.4 * self._radius_m * axis
        segments = [*pairwise(arc_m), (middle_m - along, middle_m + along)]
        scene, thick_m = self.server.scene, 0.03 * self._radius_m
        scene.add_line_segments("/arrow/arc", np.array(segments), AXIS, thickness=thick_m)
        if angle_rad > 0.02:
            head = arc_m[-1] + 0.15 * self._radius_m * np.cross(axis, arc_m[-1] - middle_m) / np.linalg.norm(across)
            scene.add_arrows(
                "/arrow/head",
                np.array([[arc_m[-1], head]]),
                AXIS,
                shaft_radius=thick_m,
                head_radius=3 * thick_m,
                head_length=6 * thick_m,
            )

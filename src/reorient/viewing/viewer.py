"""A 3D view in the browser of a running loop or of a record: clouds, hypotheses, axis, camera, belief, images.

It is a subscriber of the loop. Steps are only put into a queue; a thread of the viewer draws them, so that the loop
waits for nothing that a browser does. All browsers show the same.
"""

import threading
from dataclasses import dataclass

import numpy as np

from reorient import so3
from reorient.controller import Step
from reorient.formatting import format_probability, format_share
from reorient.imaging import DepthImage
from reorient.registration import DepthView
from reorient.reporting.scenes import CLASSES, Compared, Hypothesis, at_most
from reorient.se3 import Transform
from reorient.viewing.showing import (
    AXIS,
    CURRENT,
    GHOST,
    GOAL,
    IMAGE_PX,
    LOOPBACK,
    PORT,
    View,
    add_cloud,
    look_at,
    picture,
    plain,
    point_m,
)

_GHOST_SCALE = 0.45
_PALETTE = np.array([each.colour for each in CLASSES], np.uint8)


@dataclass(frozen=True, eq=False)
class _Shown:
    """A step, and its hypotheses with their evidence."""

    step: Step
    image: DepthImage
    """The image of the step, shrunk where it is large."""
    hypotheses: list[Hypothesis]


class Viewer(View):
    """The view of one goal. ``viewer(step)`` adds a step, as the subscribers of ``orient`` do."""

    def __init__(
        self,
        goal: DepthImage,
        title: str,
        host: str = LOOPBACK[0],
        port: int = PORT,
        T_camera_base: Transform | None = None,
    ) -> None:
        """``T_camera_base``: the pose of the robot's base in camera axes, where it is known, to show its axes.

        Raises ReorientError where the extra ``view`` is not installed.
        """
        super().__init__(title, host, port)
        self._lock = threading.RLock()
        self._steps: list[_Shown] = []
        self._T_camera_base = T_camera_base
        self._gui()
        self.show_goal(goal)

    def __call__(self, step: Step) -> None:
        """Show a step."""
        self._inbox.put(step)

    decided = __call__  # before its move, too

    def say(self, text: str) -> None:
        """Show a line of text above the controls."""
        self._status.content = plain(text)

    def show_goal(self, goal: DepthImage) -> None:
        """Begin anew with this goal."""
        with self._lock:
            self.goal = at_most(goal)
            self._goal_view = DepthView(self.goal)
            self._steps = []
            self._middle_m, self._radius_m = look_at(self.server, self.goal)
            self._draw_fixed()

    def _gui(self) -> None:
        gui = self.server.gui
        self._status = gui.add_markdown("")
        self._scrub = gui.add_slider("step", min=0, max=1, step=1, initial_value=0, disabled=True)
        self._follow = gui.add_checkbox("follow the loop", initial_value=True)
        self._align = gui.add_slider("as captured - aligned", min=0.0, max=1.0, step=0.01, initial_value=1.0)
        self._colour = gui.add_dropdown("colour by", ("evidence", "image"))
        self._choice = gui.add_dropdown("hypothesis", ("answer",))
        self._read = gui.add_markdown("")
        with gui.add_folder("Images", expand_by_default=True):
            empty = np.zeros((IMAGE_PX, IMAGE_PX, 3), np.uint8)
            self._now_picture = gui.add_image(empty, label="current")
            self._goal_picture = gui.add_image(empty, label="goal")
        with gui.add_folder("Show", expand_by_default=False):
            self._boxes = {
                name: gui.add_checkbox(name, initial_value=name != "camera")
                for name in ("goal", "current", "axis", "alternatives", "camera", "belief")
            }
        self._scrub.on_update(lambda _: self._scrubbed())
        self._align.on_update(lambda _: self._move())
        for each in (self._colour, self._choice, *self._boxes.values()):
            each.on_update(lambda _: self._draw())

    def _draw_new(self, step: Step) -> None:
        """Add a step to those shown."""
        known = [shown for shown in self._steps if shown.step.image is step.image]
        if known:  # the same step after its move: only its words change
            with self._lock:
                self._steps[step.index] = _Shown(step, known[0].image, known[0].hypotheses)
                self._say_step(self._shown())
            return
        image = at_most(step.image)
        shown = _Shown(step, image, Compared(image, self.goal, self._goal_view).of(step.estimate))
        with self._lock:
            self._steps[step.index :] = [shown]
            last = len(self._steps) - 1
            self._scrub.max, self._scrub.disabled = max(last, 1), last == 0
            if self._follow.value:
                self._scrub.value = last
                self._draw_step()

    def _shown(self) -> _Shown:
        """The chosen step."""
        return self._steps[min(int(self._scrub.value), len(self._steps) - 1)]

    def _say_step(self, shown: _Shown) -> None:
        """The chosen step in words."""
        step, estimate = shown.step, shown.step.estimate
        confidence = "-" if estimate.confidence is None else format_probability(estimate.confidence)
        angle_deg = np.degrees(estimate.angle_rad)
        self.say(f"image {step.index}: {angle_deg:.2f} deg, confidence {confidence}. {step.message} {step.error}")

    def _scrubbed(self) -> None:
        if self._steps and self._scrub.value < len(self._steps) - 1:
            self._follow.value = False
        self._draw_step()

    def _draw_fixed(self) -> None:
        """The goal, the camera, the robot's axes."""
        scene = self.server.scene
        self._goal_picture.image = picture(self.goal)
        lens = self.goal.camera
        self._frustum = scene.add_camera_frustum(
            "/camera",
            fov=2 * float(np.arctan(lens.height / 2 / lens.fy)),
            aspect=lens.width / lens.height,
            scale=0.15 * float(self._middle_m[2]),
            color=GOAL,
            thickness=1.0,
            thickness_units="screen",
            visible=False,
        )
        if self._T_camera_base is not None:
            R, t_m = self._T_camera_base[:3, :3], self._T_camera_base[:3, 3]
            scene.add_frame("/robot base", wxyz=so3.quat_from_matrix(R), position=t_m, axes_length=0.15)
        for name in ("/current", "/alternatives", "/axis", "/belief"):
            scene.add_frame(name, show_axes=False)
        add_cloud(scene, "/goal", self.goal, np.array(GOAL))

    def _draw_step(self) -> None:
        """All of the chosen step."""
        with self._lock:
            if not self._steps:
                return
            shown = self._shown()
            step, names = shown.step, tuple(each.label for each in shown.hypotheses)
            if tuple(self._choice.options) != names:
                self._choice.options = names
            self._choice.value = names[0]
            self._now_picture.image = picture(step.image)
            self._say_step(shown)
            self._draw()

    def _draw(self) -> None:
        """The chosen hypothesis of the chosen step."""
        with self._lock, self.server.atomic():
            if not self._steps:
                return
            scene = self.server.scene
            shown = self._shown()
            names = [each.label for each in shown.hypotheses]
            chosen = names.index(self._choice.value) if self._choice.value in names else 0
            self._hypothesis = shown.hypotheses[chosen]
            evidence = self._colour.value == "evidence"
            colours = (
                (_PALETTE[self._hypothesis.goal_classes], _PALETTE[self._hypothesis.current_classes])
                if evidence
                else (np.array(GOAL), np.array(CURRENT))
            )
            add_cloud(scene, "/goal", self.goal, colours[0], visible=self._boxes["goal"].value)
            add_cloud(scene, "/current/points", shown.image, colours[1], visible=self._boxes["current"].value)
            self._here_m = shown.image.points().mean(axis=0)
            self._ghosts(shown, chosen)
            self._lines(shown.step)
            self._frustum.visible = self._boxes["camera"].value
            self._read.content = self._words(evidence)
            self._move()

    def _move(self) -> None:
        """The current cloud on its way: rotated about its middle by a share of the angle, its middle moved as far."""
        with self._lock:
            if not self._steps:
                return
            share, each = float(self._align.value), self._hypothesis
            R = so3.exp(share * so3.log(each.R_goal_current))
            end_m = each.R_goal_current @ self._here_m + each.t_goal_current_m
            at_m = (1 - share) * self._here_m + share * end_m - R @ self._here_m
            self.server.scene.add_frame("/current", show_axes=False, wxyz=so3.quat_from_matrix(R), position=at_m)

    def _ghosts(self, shown: _Shown, chosen: int) -> None:
        """The other hypotheses beside the goal, smaller; a click chooses one."""
        scene = self.server.scene
        scene.add_frame("/alternatives", show_axes=False).remove()
        scene.add_frame("/alternatives", show_axes=False, visible=self._boxes["alternatives"].value)
        others = [each for k, each in enumerate(shown.hypotheses) if k != chosen]
        for k, each in enumerate(others):
            place_m = self._middle_m + self._radius_m * np.array([1.75, k - (len(others) - 1) / 2, 0.0])
            points_m = (shown.image.points() - self._here_m) @ each.R_goal_current.T * _GHOST_SCALE
            size_m = _GHOST_SCALE * point_m(shown.image)
            name = f"/alternatives/{each.label}"
            scene.add_point_cloud(name, points_m, np.array(GHOST), point_size=size_m, position=place_m)
            ball = scene.add_icosphere(
                f"{name} ball", _GHOST_SCALE * self._radius_m, GHOST, opacity=0.12, position=place_m, subdivisions=2
            )
            ball.on_click(lambda _, label=each.label: setattr(self._choice, "value", label))

    def _lines(self, step: Step) -> None:
        """The axis of the chosen hypothesis, and the belief: a line along each axis, as long as the angle is large."""
        scene, radius_m = self.server.scene, self._radius_m
        along = 1.4 * radius_m * self._hypothesis.axis
        ends = np.array([[self._middle_m - along, self._middle_m + along]])
        scene.add_line_segments("/axis", ends, AXIS, thickness=0.01 * radius_m, visible=self._boxes["axis"].value)
        lines = [
            [self._middle_m, self._middle_m + 1.4 * radius_m / np.pi * (so3.log(R) + 1e-6)] for R, _ in step.hypotheses
        ]
        shown = bool(lines) and self._boxes["belief"].value
        scene.add_line_segments("/belief", np.array(lines or ends), GHOST, thickness=0.02 * radius_m, visible=shown)

    def _words(self, evidence: bool) -> str:
        """The chosen hypothesis, the legend, and the belief."""
        each, (x, y, z) = self._hypothesis, self._hypothesis.axis
        lines = [f"{each.angle_deg:.2f} deg about [{x:.2f} {y:.2f} {z:.2f}], camera axes"]
        if evidence:
            lines += [f"{_NAMES[c.label]} {c.label} {format_share(getattr(each.evidence, c.share))}" for c in CLASSES]
        else:
            lines += ["light blue: goal", "orange: current"]
        shown = self._shown()
        for R, log_odds in shown.step.hypotheses[:6]:
            probability = format_probability(float(1 / (1 + np.exp(-log_odds))))
            lines.append(f"belief {probability}: {np.degrees(so3.angle(R)):.1f} deg remaining")
        return "\n\n".join(lines)


_NAMES = dict(zip((each.label for each in CLASSES), ("green:", "red:", "yellow:", "blue:"), strict=True))

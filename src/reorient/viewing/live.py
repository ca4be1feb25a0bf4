"""A live cell in the view: the camera, the isolation of the object, and the robot by buttons, each move asked for."""

import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from reorient import se3, so3
from reorient.controller import Limits, Step, orient
from reorient.estimators import load_estimator
from reorient.estimators.base import as_estimate
from reorient.imaging import DepthImage, Isolation
from reorient.imaging.files import write_depth
from reorient.imaging.goal_files import read_goal
from reorient.plugins import USER_ERRORS, in_words
from reorient.reporting.inputs import coloured
from reorient.stations.robot import RobotStation, around_pivot
from reorient.stations.robot_file import read_robot_file
from reorient.viewing.asking import Asking
from reorient.viewing.box import box_in_frame
from reorient.viewing.robot_toml import write_isolation
from reorient.viewing.viewer import Viewer

FRAME_S = 0.3  # between two live frames
LIMITS = Limits(max_step_rad=float(np.radians(45)), max_rotation_rad=float(np.radians(720)))
"""As of ``reorient orient`` for a station of the user's own; each move is asked for besides."""
_GREY = (120, 126, 136)


class LiveStation:
    """A ``robot.toml`` in the view."""

    def __init__(self, path: Path, goal: Path, estimator: str) -> None:
        """Opens the camera. Raises ReorientError for a file or a camera that cannot be opened."""
        self._file, self._goal_path, self._estimator = read_robot_file(path), goal, load_estimator(estimator)
        self.isolation = self._file.isolation or Isolation()
        self._camera = self._file.open_camera()
        self._camera_lock = threading.Lock()
        self._station: RobotStation | None = None
        self._asking: Asking | None = None
        self.T_camera_base = None
        if self._file.calibration.is_file():
            self.T_camera_base = se3.inverse(self._file.read_calibration().T_base_camera)
        self._answer, self._stopped, self._ended = threading.Event(), False, threading.Event()
        self._work: threading.Thread | None = None
        self.raw = self.capture()

    def capture(self) -> DepthImage:
        """The camera's frame, whole; only one thread asks for one at a time."""
        with self._camera_lock:
            return self._camera.capture()

    def first_goal(self) -> DepthImage:
        """The goal image; where there is none yet, what the camera sees."""
        if self._goal_path.is_file():
            return read_goal(self._goal_path).image
        try:
            return self._isolate(self.raw)
        except USER_ERRORS:
            return self.raw

    def attach(self, viewer: Viewer) -> None:
        """Add the controls to a view, and show the camera."""
        self._viewer, gui = viewer, viewer.server.gui
        self._steps = 0
        with gui.add_folder("Camera"):
            self._picture = gui.add_image(np.zeros((3, 4, 3), np.uint8), label="green: object, orange: unknown")
            self._seen = gui.add_markdown("")
        with gui.add_folder("Isolation"):
            self._near = gui.add_number("near, m", self.isolation.near_m or 0.0, min=0.0, step=0.01)
            self._far = gui.add_number("far, m (0: none)", self.isolation.far_m or 0.0, min=0.0, step=0.01)
            self._plane = gui.add_checkbox("remove plane", self.isolation.remove_plane)
            self._box = gui.add_button("box by mouse", hint="Drag a rectangle over the grey frame in the 3D view.")
            no_box = gui.add_button("no box")
            empty = gui.add_button("background: take now", hint="With the object out of view.")
            no_empty = gui.add_button("no background")
            save = gui.add_button("save to robot.toml")
        with gui.add_folder("Robot"):
            buttons = {
                "teach goal": self.teach,
                "estimate": self.estimate,
                "dry run": self.dry_run,
                "next move": self.next_move,
            }
            for name, act in buttons.items():
                gui.add_button(name).on_click(lambda _, act=act: self._begin(act))
            gui.add_button("stop", color="red").on_click(lambda _: self.stop())
        for each in (self._near, self._far, self._plane):
            each.on_update(lambda _: self._set_range())
        self._box.on_click(lambda _: self._select())
        no_box.on_click(lambda _: self._set(box_px=None))
        empty.on_click(lambda _: self._take_background())
        no_empty.on_click(lambda _: self._set(background=None))
        save.on_click(lambda _: self.save())
        self._live_thread = threading.Thread(target=self._live, name="reorient camera", daemon=True)
        self._live_thread.start()

    def teach(self) -> None:
        """Write what the camera sees as the goal."""
        goal = self._isolate(self.capture())
        write_depth(self._goal_path, goal)
        self._steps = 0
        self._viewer.show_goal(goal)
        self._viewer.say(f"goal written to {self._goal_path}")

    def estimate(self) -> None:
        """Estimate the rotation from what the camera sees."""
        goal, image = read_goal(self._goal_path), self._isolate(self.capture())
        estimate = as_estimate(self._estimator.estimate(image, goal), image, goal.image)
        self._viewer(Step(self._steps, image, estimate, message="estimated by hand"))
        self._steps += 1

    def dry_run(self) -> None:
        """Say what the first move would be."""
        self._loop(replace(LIMITS, dry_run=True))

    def next_move(self) -> None:
        """Begin the loop, each move of which is asked for."""
        self._loop(LIMITS)

    def stop(self) -> None:
        """End the loop, and the motion, if there is one."""
        self._stopped = True
        self._answer.set()
        if self._station is not None and self._asking is not None and self._asking.moving:
            self._station.arm.stop()
            self._station = None  # a stopped arm is opened anew
        self._viewer.say("stopped")

    def close(self) -> None:
        """Stop, and show no more frames."""
        self.stop()
        self._ended.set()
        self._live_thread.join()

    def save(self) -> None:
        """Write the isolation to ``robot.toml``, whose comments stay."""
        write_isolation(self._file.path, self.isolation)
        self._viewer.say(f"isolation written to {self._file.path}")

    def _loop(self, limits: Limits) -> None:
        goal = read_goal(self._goal_path)
        if self._station is None:
            calibration = self._file.read_calibration()
            arm = self._file.open_arm(calibration.p_tool_object_m)
            self._station = RobotStation(self, arm, calibration, self._isolate)
        self._stopped, self._steps = False, 0
        self._viewer.show_goal(goal.image)
        self._asking = Asking(self._station, self._ask)
        result = orient(self._asking, goal, self._estimator, limits=limits, subscribers=[self._viewer])
        self._steps = len(result.steps)
        self._viewer.wait()
        reason = "the move was not allowed" if result.status == "interrupted" else result.reason
        self._viewer.say(f"{result.status.replace('_', ' ')}: {reason}")

    def _ask(self, R_step: Float[np.ndarray, "3 3"]) -> bool:
        """Show the move in a window of all browsers and wait for a button."""
        if self._stopped:
            return False
        self._answer.clear()
        gui, said = self._viewer.server.gui, []

        def answer(name: str) -> None:
            said.append(name)
            self._answer.set()

        rotvec = " ".join(f"{x:.1f}" for x in np.degrees(so3.log(R_step)))
        modal = gui.add_modal("Move the robot?")
        with modal:
            gui.add_markdown(f"rotate by {np.degrees(so3.angle(R_step)):.1f} deg ({rotvec} deg, camera axes)")
            for name in ("rotate", "do not rotate"):
                gui.add_button(name).on_click(lambda _, name=name: answer(name))
        self._answer.wait()
        modal.close()
        return said[:1] == ["rotate"] and not self._stopped

    def _begin(self, act: Callable[[], None]) -> None:
        """Do an act in a thread of its own, one at a time; an error is shown."""

        def work() -> None:
            try:
                act()
            except USER_ERRORS as error:
                self._viewer.say(in_words(error))

        if self._work is not None and self._work.is_alive():
            self._viewer.say("busy: expected stop, or the end of what runs")
            return
        self._work = threading.Thread(target=work, name="reorient act", daemon=True)
        self._work.start()

    def _isolate(self, image: DepthImage) -> DepthImage:
        """The object of a frame, by the present controls; a sphere follows the arm once there is a station."""
        if self._station is None or self.isolation.radius_m is None:
            return self.isolation(image)
        return around_pivot(self.isolation, self._station.pivot_m)(image)

    def _live(self) -> None:
        """Show the camera's frames until the view ends."""
        while not self._ended.wait(FRAME_S):
            try:
                self._show_frame(self.capture())
            except USER_ERRORS as error:
                self._seen.content = in_words(error)

    def _show_frame(self, raw: DepthImage) -> None:
        self.raw = raw
        isolated = None
        try:
            isolated = self._isolate(raw)
            words = f"object: {np.count_nonzero(isolated.valid)} pixels at {np.median(isolated.points()[:, 2]):.3f} m"
        except USER_ERRORS as error:
            words = in_words(error)
        self._picture.image = coloured(raw, isolated)
        self._seen.content = words

    def _set_range(self) -> None:
        self._set(near_m=self._near.value or None, far_m=self._far.value or None, remove_plane=self._plane.value)

    def _set(self, **values: Any) -> None:
        """Change fields of the isolation; what is refused is said."""
        try:
            self.isolation = replace(self.isolation, **values)
        except USER_ERRORS as error:
            self._viewer.say(in_words(error))

    def _take_background(self) -> None:
        path = self._file.path.parent / "background.npz"
        write_depth(path, self.raw)
        self._set(background=path)

    def _select(self) -> None:
        """The next rectangle that is dragged in the 3D view becomes the box."""
        scene, raw = self._viewer.server.scene, self.raw
        size_m = float(np.median(raw.depth_m[raw.valid]) / raw.camera.fx)
        frame = scene.add_point_cloud("/frame", raw.points().astype(np.float32), _GREY, point_size=size_m)
        self._viewer.say("drag a rectangle around the object in the grey frame")

        @scene.on_rect_select()  # type: ignore[untyped-decorator]
        def _(event: Any) -> None:
            scene.remove_rect_select_callback("all")
            frame.remove()
            camera = event.client.camera
            box = box_in_frame(raw, camera, np.array(event.screen_min), np.array(event.screen_max))
            self._set(box_px=box)
            self._viewer.say("the rectangle holds no point of the frame" if box is None else f"box of {box} px")

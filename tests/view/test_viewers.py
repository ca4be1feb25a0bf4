"""The views that a server shows, in a real browser: records, running loops, a live cell, the guide."""

import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from conftest import canvas_pixels
from reorient import so3
from reorient.cli.view_options import ViewOptions
from reorient.cli.viewing import show_all
from reorient.controller.guiding import GuideState
from reorient.errors import ReorientError
from reorient.imaging import Camera, DepthImage, Isolation
from reorient.perception.robot_calibration import RobotCalibration, write_robot_calibration
from reorient.stations.robot_file import read_robot_file
from reorient.stations.simulated import cell_of
from reorient.viewing.box import box_in_frame
from reorient.viewing.guide_view import GuideView
from reorient.viewing.live import LiveStation
from reorient.viewing.robot_toml import write_isolation
from reorient.viewing.viewer import Viewer

WAIT_MS = 60_000


def shown(page, text: str) -> None:
    page.get_by_text(text, exact=False).first.wait_for(timeout=WAIT_MS)


def until(true, seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end
        time.sleep(0.1)


@pytest.fixture
def viewer(loop):
    goal, result = loop
    opened = Viewer(goal, "test", port=8180)
    show_all(opened, result)
    yield opened
    opened.close()


def test_a_record_is_scrubbed_and_two_browsers_show_the_same(page, browser, viewer, loop):
    _, result = loop
    page.goto(viewer.address)
    shown(page, "converged: estimate")
    second = browser.new_page()
    second.goto(viewer.address)
    shown(second, "converged: estimate")
    field = page.get_by_role("textbox").first
    field.fill("0")
    field.press("Enter")
    words = result.steps[0].message.split(":")[0].split("(")[0].strip()
    for each in (page, second):
        shown(each, words)
    second.close()
    assert int(viewer._scrub.value) == 0  # a closed browser changes nothing
    page.wait_for_timeout(3000)
    assert canvas_pixels(page.locator("canvas").first).std() > 3


def test_the_slider_moves_the_cloud_and_a_hypothesis_is_chosen(viewer, loop):
    """By the controls' own callbacks, as a browser triggers them."""
    step = loop[1].steps[0]
    viewer._scrub.value = 0
    R = step.estimate.R_goal_current
    frame = viewer.server.scene.get_handle_by_name("/current")
    assert np.allclose(frame.wxyz, so3.quat_from_matrix(R), atol=1e-4)
    viewer._align.value = 0.0
    frame = viewer.server.scene.get_handle_by_name("/current")
    assert np.allclose(frame.wxyz, [1, 0, 0, 0], atol=1e-6)
    assert np.allclose(frame.position, 0, atol=1e-6)


def test_no_port_is_open_beyond_loopback_unless_asked(viewer, loop, capsys):
    port = viewer.server.get_port()
    addresses = {entry.split()[1] for entry in Path("/proc/net/tcp").read_text().splitlines()[1:]}
    listening = {each.split(":")[0] for each in addresses if each.endswith(f":{port:04X}")}
    assert listening == {"0100007F"}
    opened = ViewOptions("0.0.0.0", 8190).open(loop[0], "test")
    assert "warning: the view listens at 0.0.0.0" in capsys.readouterr().err
    opened.close()
    ViewOptions(port=8191).open(loop[0], "test").close()
    assert "warning" not in capsys.readouterr().err


def test_the_loop_never_waits_for_the_view(loop):
    """Steps are put into a queue: a view that draws nothing keeps the loop no longer."""
    goal, result = loop
    opened = Viewer(goal, "test", port=8185)
    with opened._lock:  # the view hangs
        began = time.monotonic()
        for step in result.steps:
            opened.decided(step)
            opened(step)
        assert time.monotonic() - began < 0.05
    opened.close()


# --- a live cell ----------------------------------------------------------------------------------------------------

TOML = """# my cell
[camera]
driver = "simulated"   # the camera
[arm]
driver = "simulated"
[isolation]            # what is the object
near_m = 0.1           # metres
remove_plane = true
[limits]
settle_s = 0.0
"""


@pytest.fixture
def cell(tmp_path):
    """A live station, in view."""
    path = tmp_path / "robot.toml"
    path.write_text(TOML)
    simulated = cell_of(0)
    simulated.table = False
    calibration = RobotCalibration(simulated.T_base_camera, simulated.T_tool_object[:3, 3])
    write_robot_calibration(tmp_path / "calibration.json", calibration)
    live = LiveStation(path, tmp_path / "goal.npz", "fast")
    opened = Viewer(live.first_goal(), "cell", port=8195, T_camera_base=live.T_camera_base)
    live.attach(opened)
    yield live, opened, simulated
    live.close()
    opened.close()


def test_teach_dry_run_move_and_stop(page, cell, tmp_path):
    live, opened, simulated = cell
    page.goto(opened.address)
    press = lambda name: page.get_by_role("button", name=name, exact=True).first.click(timeout=WAIT_MS)  # noqa: E731
    press("teach goal")
    shown(page, "goal written to")
    assert (tmp_path / "goal.npz").is_file()
    before = simulated.T_base_tool.copy()
    R = so3.exp(np.radians([0.0, 25.0, 0.0]))
    simulated.T_base_tool = before.copy()
    simulated.T_base_tool[:3, :3] = R @ before[:3, :3]
    held = before[:3, :3] @ simulated.T_tool_object[:3, 3] + before[:3, 3]
    simulated.T_base_tool[:3, 3] = held - simulated.T_base_tool[:3, :3] @ simulated.T_tool_object[:3, 3]
    away = simulated.T_base_tool.copy()
    press("dry run")
    shown(page, "dry run: would rotate by")
    assert np.array_equal(simulated.T_base_tool, away)
    press("next move")
    shown(page, "Move the robot?")
    assert np.array_equal(simulated.T_base_tool, away)
    press("rotate")
    until(lambda: not np.array_equal(simulated.T_base_tool, away))
    assert so3.angle(simulated.T_base_tool[:3, :3] @ before[:3, :3].T) < np.radians(5)
    live.stop()
    until(lambda: not live._work.is_alive())


def test_a_refused_move_moves_nothing(page, cell):
    live, _, simulated = cell
    live.teach()
    here = simulated.T_base_tool.copy()
    live.stop()
    assert not live._ask(np.eye(3))
    assert np.array_equal(simulated.T_base_tool, here)


def test_the_isolation_is_saved_and_the_comments_stay(cell, tmp_path):
    live, *_ = cell
    live._set(box_px=(1, 2, 300, 200), near_m=0.25, remove_plane=False)
    live._take_background()
    live.save()
    text = (tmp_path / "robot.toml").read_text()
    for comment in ("# my cell", "# the camera", "# what is the object", "# metres"):
        assert comment in text
    found = read_robot_file(tmp_path / "robot.toml").isolation
    assert found == Isolation((1, 2, 300, 200), 0.25, background=tmp_path / "background.npz")
    with pytest.raises(ReorientError, match="expected a file"):
        write_isolation(tmp_path / "robot.toml", Isolation(background=live.raw))


def test_a_wrong_range_is_said_and_not_taken(cell):
    live, opened, _ = cell
    before = live.isolation
    live._set(near_m=2.0, far_m=1.0)
    assert live.isolation == before
    assert "near below far" in opened._status.content


def test_a_rectangle_on_the_screen_becomes_the_box():
    """From the camera's own place the rectangle is the box itself."""
    camera = Camera(60, 40, 50.0, 50.0, 30.0, 20.0)
    image = DepthImage(np.full((40, 60), 0.7, np.float32), camera)
    eye = SimpleNamespace(wxyz=(1, 0, 0, 0), position=(0, 0, 0), fov=2 * np.arctan(20 / 50), aspect=1.5)
    assert box_in_frame(image, eye, np.array([0.25, 0.5]), np.array([0.5, 0.75])) == (15, 20, 15, 10)
    assert box_in_frame(image, eye, np.array([2.0, 2.0]), np.array([3.0, 3.0])) is None


# --- the guide ------------------------------------------------------------------------------------------------------


def test_the_guide_view_shows_the_rotation_that_remains(page, loop):
    goal, result = loop
    view = GuideView(goal, "guide", 1.0, port=8170)
    page.goto(view.address)
    step = result.steps[0]
    view(GuideState(0, 0.0, "rotate", "rotate 75 deg to the <left>", step.image, step.estimate))
    shown(page, "rotate 75 deg to the <left>")
    shown(page, f"{np.degrees(step.estimate.angle_rad):.1f} deg")
    ghost = view.server.scene.get_handle_by_name("/ghost")
    assert np.allclose(ghost.wxyz, so3.quat_from_matrix(step.estimate.R_goal_current.T), atol=1e-6)
    view(GuideState(1, 0.1, "no_object", "show the part to the camera"))
    shown(page, "no object")
    assert not view.server.scene.get_handle_by_name("/ghost").visible
    view(GuideState(2, 0.2, "matched", "matched", result.steps[-1].image, result.steps[-1].estimate))
    shown(page, "matched")
    view.close()
    assert view.drawn == 3


def test_the_guide_view_draws_15_states_a_second(loop):
    goal, result = loop
    step = result.steps[0]
    view = GuideView(goal, "guide", 1.0, port=8171)
    states = [GuideState(k, k / 30, "rotate", f"rotate {k}", step.image, step.estimate) for k in range(31)]
    began = time.process_time()
    for state in states:
        view._draw(state)
    assert time.process_time() - began < len(states) / 15
    view.close()

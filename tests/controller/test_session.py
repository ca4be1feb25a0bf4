"""Calls of a station that hang, exit, are interrupted or are wrong; subscribers before and after a move."""

import json
import threading
import time

import numpy as np
import pytest
from oracles import NOW, Always, Oracle, Wrapped
from oracles import cell as away_cell

from reorient import Algorithm1, Fusing, Limits, orient, so3
from reorient.errors import ReorientError
from reorient.stations.replay import RecordingStation, ReplayedStation


@pytest.fixture
def cell(mesh):
    return away_cell(mesh, 60.0)


class Faulty(Wrapped):
    """Does something else at its first capture or rotation."""

    def __init__(self, station, member, act):
        super().__init__(station)
        self.stopped = []
        setattr(self, member, act)

    def stop(self):
        self.stopped.append(True)


@pytest.mark.parametrize("member", ["capture", "rotate"])
def test_a_station_that_hangs_ends_the_loop(cell, member, tmp_path):
    station, goal, R_goal = cell
    ended = threading.Event()
    faulty = Faulty(station, member, lambda *_: ended.wait(20))
    recording = RecordingStation(faulty, tmp_path / "record", goal, {})
    begin = time.monotonic()
    limits = Limits(timeout_s=0.5, wait_s=0.0)
    result = orient(recording, goal, Oracle(station, R_goal), Fusing(), limits=limits)
    seconds = time.monotonic() - begin
    acts = json.loads((tmp_path / "record" / "record.json").read_text())["acts"]
    ended.set()
    assert seconds < 10
    assert (result.status, len(result.errors)) == ("station_failed", 1)
    assert "no answer within 0.5 s" in result.reason
    assert faulty.stopped == [True] * (member == "rotate")
    assert (next(iter(acts[-1])), acts[-1]["error"]) == (member, "did not end")
    assert [step.motion_unknown for step in result.steps] == [True] * (member == "rotate")


def test_a_time_limit_changes_nothing_else(mesh):
    def run(**limits):
        station, goal, R_goal = away_cell(mesh, 60.0)
        threads = set()

        class Watched(Wrapped):
            def rotate(self, R_step):
                threads.add(threading.current_thread())
                return self.station.rotate(R_step)

        result = orient(Watched(station), goal, Oracle(station, R_goal), limits=Limits(wait_s=0.0, **limits))
        return [step.message for step in result.steps], threads

    (messages, here), (again, other) = run(), run(timeout_s=1e300)
    assert again == messages
    assert here == {threading.current_thread()}
    assert len(other) == 1
    assert other != here
    other.pop().join(5)  # it ends with the loop
    with pytest.raises(ReorientError, match="expected at least 0.01 deg, and seconds above 0"):
        Limits(timeout_s=0)
    with pytest.raises(ReorientError, match="expected at least 0.01 deg"):
        Limits(max_step_rad=1e-9)


def raising(error):
    def act(*_):
        raise error

    return act


@pytest.mark.parametrize("member", ["capture", "rotate", "reachable", "clock_s"])
def test_a_driver_that_exits_does_not_end_the_program(cell, member):
    station, goal, R_goal = cell
    result = orient(Faulty(station, member, raising(SystemExit(0))), goal, Oracle(station, R_goal), limits=NOW)
    if member in ("capture", "rotate"):
        assert result.status == "station_failed"
        assert "SystemExit: 0" in result.reason
    else:
        assert result.converged


@pytest.mark.parametrize("limits", [NOW, Limits(timeout_s=20.0, wait_s=0.0)])
def test_an_interrupted_move_stops_the_robot(cell, limits):
    station, goal, R_goal = cell
    faulty = Faulty(station, "rotate", raising(KeyboardInterrupt()))
    result = orient(faulty, goal, Oracle(station, R_goal), limits=limits)
    assert (result.status, faulty.stopped, result.steps[-1].error) == (
        "interrupted",
        [True],
        "interrupted by the keyboard",
    )


@pytest.mark.parametrize("error", [TypeError("two"), AttributeError("depth"), KeyError("x"), NotImplementedError()])
@pytest.mark.parametrize("member", ["capture", "rotate"])
def test_a_programming_error_is_not_retried_and_names_its_line(cell, member, error):
    station, goal, R_goal = cell
    result = orient(Faulty(station, member, raising(error)), goal, Oracle(station, R_goal), Fusing(), limits=NOW)
    assert (result.status, len(result.errors)) == ("station_failed", 1)
    line = raising.__code__.co_firstlineno + 2
    assert f"{type(error).__name__}" in result.reason
    assert f"test_session.py, line {line}]" in result.reason


def test_a_programming_error_of_the_estimator_is_not_retried(cell):
    station, goal, _ = cell

    class Misspelt:
        def estimate(self, current, goal, pivot_m=None, history=()):
            return current.dept_m

    result = orient(station, goal, Misspelt(), Fusing(), limits=NOW)
    assert (result.status, len(result.errors)) == ("estimator_failed", 1)
    assert "AttributeError: 'DepthImage' object has no attribute 'dept_m' [" in result.reason


@pytest.mark.parametrize(("member", "wrong"), [("capture", None), ("rotate", None), ("rotate", 2 * np.eye(3))])
def test_a_wrong_result_is_not_asked_for_again(cell, member, wrong):
    station, goal, R_goal = cell
    result = orient(Faulty(station, member, lambda *_: wrong), goal, Oracle(station, R_goal), Fusing(), limits=NOW)
    assert (result.status, len(result.errors)) == ("station_failed", 1)


def test_a_subscriber_may_see_a_decision_before_its_move(cell):
    station, goal, _ = cell
    events = []

    class Watching:
        def decided(self, step):
            events.append((step.index, "decided", step.message != "", step.R_executed is None))

        def __call__(self, step):
            events.append((step.index, "moved", step.message != "", step.R_executed is None))

    def confirm(R_step):
        events.append("asked")
        return True

    limits = Limits(confirm=confirm, wait_s=0.0)
    strategy = Algorithm1(eta=1.0, max_images=2)
    orient(station, goal, Always(np.radians(20)), strategy, limits=limits, subscribers=[Watching()])
    assert events[:4] == [(0, "decided", True, True), "asked", (0, "moved", True, False), (1, "decided", True, True)]


def test_a_record_of_an_interrupted_act_is_replayed(cell, tmp_path):
    station, goal, R_goal = cell
    faulty = Faulty(station, "rotate", raising(SystemExit(3)))
    recording = RecordingStation(faulty, tmp_path / "record", goal, {})
    orient(recording, goal, Oracle(station, R_goal), Algorithm1(), limits=NOW)
    replayed = ReplayedStation(tmp_path / "record")
    result = orient(replayed, goal, Always(np.radians(60)), Algorithm1(eta=0.2), limits=NOW)
    assert result.status == "station_failed"
    assert float(so3.angle(np.array(replayed.record["acts"][1]["rotate"]))) > 0

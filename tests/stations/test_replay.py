"""A record of a loop, and the record as a station: the same decisions again, from the files alone."""

import json

import numpy as np
import pytest

from reorient import Algorithm1, Fusing, Limits, StationError, orient, so3
from reorient.errors import ReorientError
from reorient.estimators.base import RotationEstimate
from reorient.registration import Evidence
from reorient.stations.faulty import FaultyStation
from reorient.stations.rendered import RenderedStation
from reorient.stations.replay import RecordingStation, ReplayedStation
from reorient.world.rendering import load_world
from reorient.world.sensing import randomised

NOW = Limits(wait_s=0.0)


class ByNumber:
    """Answers by how often it was asked: the same on a replay as on the station."""

    def __init__(self, confidence=None):
        self.asked = 0
        self.confidence = confidence

    def estimate(self, current, goal, pivot_m=None, history=()):
        if np.count_nonzero(current.depth_m) < 20:
            raise ReorientError("current image has 1 returns")
        self.asked += 1
        R = so3.exp(np.array([0.9, 0.1, 0.0]) / self.asked**2)
        return RotationEstimate(R, np.zeros(3), Evidence(1, 0, 0, 0, 0.0), self.confidence)


@pytest.fixture
def station(mesh):
    return RenderedStation(mesh, load_world("benchmark"), randomised(0.001), np.random.default_rng(3))


def same(one, other):
    assert (one.status, one.confidence, one.moves) == (other.status, other.confidence, other.moves)
    assert len(one.steps) == len(other.steps)
    for a, b in zip(one.steps, other.steps, strict=True):
        np.testing.assert_array_equal(a.image.depth_m, b.image.depth_m)
        assert (a.message, a.phase) == (b.message, b.phase)
        for x, y in ((a.R_step, b.R_step), (a.R_executed, b.R_executed)):
            assert (x is None) == (y is None)
            if x is not None:
                np.testing.assert_array_equal(x, y)


@pytest.mark.slow
@pytest.mark.parametrize("strategy", [Fusing(), Algorithm1(eta=0.7)])
def test_a_replay_decides_as_the_loop_did(tmp_path, station, strategy):
    goal = station.capture_goal()
    recording = RecordingStation(station, tmp_path / "record", goal, {"note": "any"})
    first = orient(recording, goal, ByNumber(0.9), strategy, limits=NOW)
    recording.finish(first)
    replayed = ReplayedStation(tmp_path / "record")
    assert (replayed.record["status"], replayed.record["converged"]) == (first.status, first.converged)
    np.testing.assert_array_equal(replayed.goal().image.depth_m, goal.depth_m)
    same(orient(replayed, replayed.goal().image, ByNumber(0.9), strategy, limits=NOW), first)


@pytest.mark.slow
def test_failures_are_recorded_and_come_again(tmp_path, station):
    goal = station.capture_goal()
    faulty = FaultyStation(station, np.random.default_rng(0), planned=["refused", "gone", "stale", "empty"])
    recording = RecordingStation(faulty, tmp_path / "record", goal, {})
    first = orient(recording, goal, ByNumber(0.9), Fusing(), limits=NOW)
    assert len(first.errors) >= 4
    replayed = ReplayedStation(tmp_path / "record")
    again = orient(replayed, goal, ByNumber(0.9), Fusing(), limits=NOW)
    assert [x.replace("recorded error: StationError: ", "") for x in again.errors] == list(first.errors)
    assert again.moves == first.moves


def test_the_record_is_whole_after_every_act(tmp_path, station):
    goal = station.capture_goal()
    recording = RecordingStation(station, tmp_path / "record", goal, {})
    for act in range(3):
        recording.capture()
        recording.rotate(so3.exp(np.array([0.1, 0, 0])))
        record = json.loads((tmp_path / "record" / "record.json").read_text())
        assert len(record["acts"]) == 2 * act + 2
    assert not list((tmp_path / "record").glob(".*"))
    assert recording.clock_s() == station.clock_s()
    assert not hasattr(recording, "reachable")


def test_a_loop_that_leaves_the_record_is_told(tmp_path, station):
    goal = station.capture_goal()
    recording = RecordingStation(station, tmp_path / "record", goal, {})
    recording.capture()
    recording.rotate(so3.exp(np.array([0.1, 0, 0])))
    replayed = ReplayedStation(tmp_path / "record")
    replayed.capture()
    with pytest.raises(StationError, match="leaves the record at act 1: capture requested"):
        replayed.capture()
    with pytest.raises(StationError, match="a move 5.7 deg off"):
        replayed.rotate(so3.exp(np.array([0.2, 0, 0])))
    replayed.rotate(so3.exp(np.array([0.1, 0, 0])))
    with pytest.raises(StationError, match="the record ends here"):
        replayed.capture()


def test_records_are_neither_overwritten_nor_invented(tmp_path, station):
    goal = station.capture_goal()
    RecordingStation(station, tmp_path / "record", goal, {})
    with pytest.raises(ReorientError, match="holds a record: expected a new folder"):
        RecordingStation(station, tmp_path / "record", goal, {})
    with pytest.raises(ReorientError, match="no record.json in"):
        ReplayedStation(tmp_path)
    (tmp_path / "record" / "record.json").write_text("{}")
    with pytest.raises(ReorientError, match="cannot read .*record.json"):
        ReplayedStation(tmp_path / "record")


class Narrow:
    """Another station that reaches no rotation above 20 degrees, and has a clock that may fail or be odd."""

    def __init__(self, station, clock_s=None):
        self.station, self.pivot_m = station, station.pivot_m
        self.capture, self.rotate = station.capture, station.rotate
        if clock_s is not None:
            self.clock_s = clock_s

    def reachable(self, R_step):
        return np.bool_(so3.angle(R_step) < np.radians(20))


@pytest.mark.slow
def test_what_can_be_reached_is_replayed_too(tmp_path, station):
    goal = station.capture_goal()
    recording = RecordingStation(Narrow(station), tmp_path / "record", goal, {})
    first = orient(recording, goal, ByNumber(0.9), Fusing(), limits=NOW)
    assert first.errors  # of moves that were replaced by nearer ones
    assert first.moves
    replayed = ReplayedStation(tmp_path / "record")
    again = orient(replayed, goal, ByNumber(0.9), Fusing(), limits=NOW)
    same(again, first)
    assert again.errors == first.errors
    with pytest.raises(StationError, match="reachable\\(\\) of another move"):
        replayed.reachable(so3.exp(np.array([0, 0, 2.0])))
    RecordingStation(station, tmp_path / "other", goal, {})
    assert not hasattr(ReplayedStation(tmp_path / "other"), "reachable")


@pytest.mark.slow
def test_odd_clocks_and_values_do_not_spoil_a_record(tmp_path, station, unchecked):
    def broken():
        raise OSError("no clock")

    goal = station.capture_goal()
    for k, clock_s in enumerate((broken, lambda: np.float32(station.clock_s()))):
        recording = RecordingStation(Narrow(station, clock_s), tmp_path / str(k), goal, {})
        result = orient(recording, goal, ByNumber(0.9), Fusing(), limits=NOW)
        assert result.moves
        assert not any("clock" in error or "JSON" in error for error in result.errors)
        same(orient(ReplayedStation(tmp_path / str(k)), goal, ByNumber(0.9), Fusing(), limits=NOW), result)
    with pytest.raises(TypeError):
        recording._note({"capture": object()})
    recording.finish(result)
    assert json.loads((tmp_path / "1" / "record.json").read_text())["status"] == result.status


def test_a_station_that_cannot_tell_its_pivot_leaves_no_folder(tmp_path, station, unchecked):
    class Unhomed(Narrow):
        pivot_m = property(lambda self: 1 / 0, lambda self, value: None)

    goal = station.capture_goal()
    with pytest.raises(StationError, match="cannot read the station's pivot_m: ZeroDivisionError"):
        RecordingStation(Unhomed(station), tmp_path / "record", goal, {})
    assert not (tmp_path / "record").exists()
    with pytest.raises(StationError, match="cannot read the station's pivot_m: ZeroDivisionError"):
        orient(Unhomed(station), goal, ByNumber())


def test_an_interrupted_act_is_recorded(tmp_path, station):
    def interrupted(R_step):
        raise KeyboardInterrupt

    goal = station.capture_goal()
    station.rotate = interrupted
    recording = RecordingStation(station, tmp_path / "record", goal, {})
    result = orient(recording, goal, ByNumber(0.9), Fusing(), limits=NOW)
    assert (result.status, len(result.steps), result.steps[0].motion_unknown) == ("interrupted", 1, True)
    acts = json.loads((tmp_path / "record" / "record.json").read_text())["acts"]
    assert [act.get("error", "")[:17] for act in acts] == ["", "KeyboardInterrupt"]


@pytest.mark.parametrize("most_deg", [None, 300.0])
def test_settings_of_earlier_records_are_read(tmp_path, station, most_deg):
    goal = station.capture_goal()
    RecordingStation(station, tmp_path / "record", goal, {})
    file = tmp_path / "record" / "record.json"
    earlier = {"strategy": ["auto", 20, None, 0.5], "largest_step_deg": 180.0, "largest_total_deg": most_deg}
    file.write_text(json.dumps(json.loads(file.read_text()) | earlier))
    record = ReplayedStation(tmp_path / "record").record
    assert record["strategy"] == {"strategy": "auto", "max_images": 20, "eta": None, "delta_deg": 0.5}
    limits = {"max_step_deg": 180.0, "max_rotation_deg": most_deg, "dry_run": False}
    assert record["limits"] == limits

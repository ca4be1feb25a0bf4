"""MCAP files as MCAP's own reader has them."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from reorient import so3
from reorient.cli import main
from reorient.controller import OrientResult
from reorient.errors import ReorientError
from reorient.imaging import DepthImage
from reorient.viewing.mcap_file import write_mcap

STREAMS = {
    *(f"/{name}/{topic}" for name in ("goal", "current") for topic in ("depth", "unknown", "camera", "points")),
    *("/transform", "/estimate", "/belief", "/events"),
}


def messages(path: Path) -> dict[str, list]:
    """All messages by topic, decoded."""
    found: dict[str, list] = {}
    with path.open("rb") as stream:
        for schema, channel, message, decoded in _decoded(make_reader(stream, validate_crcs=True)):
            found.setdefault(channel.topic, []).append((schema, message, decoded))
    return found


def _decoded(reader):
    factory = DecoderFactory()
    for schema, channel, message in reader.iter_messages():
        if channel.message_encoding == "json":
            yield schema, channel, message, json.loads(message.data)
        else:
            yield schema, channel, message, factory.decoder_for(channel.message_encoding, schema)(message.data)


def test_all_streams_of_a_loop_survive(tmp_path, loop):
    goal, result = loop
    found = messages(write_mcap(tmp_path / "loop.mcap", goal, result))
    assert set(found) == STREAMS
    assert {len(found[topic]) for topic in STREAMS - {"/events"} if not topic.startswith("/goal")} == {
        len(result.steps)
    }
    for k, step in enumerate(result.steps):
        _, message, depth = found["/current/depth"][k]
        pixels = np.frombuffer(depth.data, "<f4").reshape(depth.height, depth.width)
        assert np.array_equal(pixels, step.image.depth_m)
        unknown = found["/current/unknown"][k][2]
        assert np.array_equal(np.frombuffer(unknown.data, np.uint8).reshape(pixels.shape) > 0, step.image.unknown)
        assert message.log_time == depth.timestamp.ToNanoseconds() == round(1e9 * step.image.stamp_s)
        camera = found["/current/camera"][k][2]
        assert (camera.K[0], camera.K[2]) == (step.image.camera.fx, step.image.camera.cx - 0.5)
        pose, points = found["/transform"][k][2], found["/current/points"][k][2]
        R = so3.matrix_from_quat(np.array([getattr(pose.rotation, x) for x in "wxyz"]))
        assert np.allclose(R, step.estimate.R_goal_current)
        assert points.frame_id == pose.child_frame_id
        places_m = np.frombuffer(points.data, "<f4").reshape(-1, 3)
        assert np.allclose(places_m, step.image.points(), atol=1e-6)
        schema, _, estimate = found["/estimate"][k]
        assert set(estimate) == set(json.loads(schema.data)["properties"])
        assert estimate["angle_deg"] == pytest.approx(np.degrees(step.estimate.angle_rad))
        assert len(found["/belief"][k][2]["hypotheses"]) == len(step.hypotheses) > 0
    texts = [event.message for _, _, event in found["/events"]]
    assert texts[0] == f"image 0: {result.steps[0].message}"
    assert texts[-1] == f"{result.status}: {result.reason}"
    assert {schema.name for schema, *_ in found["/current/depth"]} == {"foxglove.RawImage"}


def test_stamps_are_the_times(tmp_path, loop):
    goal, result = loop
    stamped = [
        replace(step, image=DepthImage(step.image.depth_m, step.image.camera, 100.5 + 2 * k))
        for k, step in enumerate(result.steps)
    ]
    found = messages(write_mcap(tmp_path / "a.mcap", goal, replace(result, steps=tuple(stamped))))
    times_s = [message.log_time / 1e9 for _, message, _ in found["/estimate"]]
    assert times_s == [100.5 + 2 * k for k in range(len(stamped))]
    backwards = replace(result, steps=tuple(stamped[::-1]))
    found = messages(write_mcap(tmp_path / "b.mcap", goal, backwards))
    assert [message.log_time for _, message, _ in found["/estimate"]][:2] == [0, 1_000_000_000]


def test_a_record_becomes_mcap_by_the_command_line(tmp_path, capsys, record):
    path = tmp_path / "run.mcap"
    main(["replay", str(record), "--mcap", str(path)])
    assert str(path) in capsys.readouterr().out
    images = len([act for act in json.loads((record / "record.json").read_text())["acts"] if act.get("capture")])
    assert len(messages(path)["/current/depth"]) == images


def test_refusals(tmp_path, loop):
    goal, result = loop
    with pytest.raises(ReorientError, match="without a step"):
        write_mcap(tmp_path / "a.mcap", goal, OrientResult((), "station_failed", "no camera"))
    with pytest.raises(ReorientError, match="existing folder"):
        write_mcap(tmp_path / "gone" / "a.mcap", goal, result)
    assert not list(tmp_path.iterdir())

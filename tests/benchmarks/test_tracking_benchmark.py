"""The sequences and the summary of the tracking benchmark."""

import numpy as np
import pytest
from tracking import summarise
from tracking_sequences import FARTHEST_RAD, FASTEST_RAD_S, KINDS, Sequence, motion

from reorient import so3
from reorient.world.objects import generated


def test_the_motion_keeps_its_limits(rng):
    R = so3.exp(motion(rng, 300, 30.0))
    assert so3.angle(R).max() <= FARTHEST_RAD + 1e-9
    speed = so3.angle_difference(R[1:], R[:-1]) * 30
    assert 0.5 * FASTEST_RAD_S < speed.max() <= 1.01 * FASTEST_RAD_S


@pytest.mark.slow
def test_sequences_are_what_they_are_called():
    objects = generated(2)
    for kind in KINDS:
        first, again = (list(Sequence(objects, objects.names[0], kind, 3, 12)) for _ in range(2))
        assert [x.image.depth_m.sum() for x in first] == [x.image.depth_m.sum() for x in again]
        there = [x.index for x in first if not x.there]
        assert there == (list(range(4, 8)) if kind in ("swap", "hidden") else [])
        steps = so3.angle_difference(
            *(np.stack([x.R_camera_object for x in first])[part] for part in (slice(1, None), slice(-1)))
        )
        assert (np.degrees(steps.max()) > 15) == (kind == "jump")
        returns = [np.count_nonzero(x.image.depth_m) for x in first]
        if kind == "hidden":
            assert max(returns[4:8]) < 0.2 * min(returns[:4])


def row(kind, image, error, there=1, **more):
    cells = {"sequence": kind, "kind": kind, "image": image, "event": 1, "there": there, "state": "tracked"}
    cells |= {"error_deg": error, "confidence": "0.9" if error else "", "seconds": "0.01", "estimate_error_deg": ""}
    return {key: str(value) for key, value in (cells | more).items()}


def test_the_summary_counts_unknown_rotations_as_errors():
    rows = [row("plain", k, error) for k, error in enumerate(("0.5", "", "1.5", "3"))]
    rows += [row("swap", k, error, there=0) for k, error in enumerate(("9", "9", "9", "9", ""))]
    text = summarise(rows)
    assert "plain: 4 images, median 2.25 deg, 25.0% within 1, 50.0% within 2, 75.0% within 5" in text
    assert "swap: flagged from the 3rd image on in 50.00% of 2" in text
    assert "false alarms (plain, crossing; after the first estimate): 25.00% of 4" in text
    assert "confidence 0.8-0.95: mean 0.900, 42.86% of 7" in text

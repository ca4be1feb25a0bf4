"""Whether the object moved as the station reported: the reported rotation, compared with others in the images.

A station that reports another motion than it makes has a kind of error that repeats: a camera that repeats a frame and
a background in the image show no motion; ``R_step`` in other axes is the same angle about another axis, or the inverse;
degrees for radians is another angle about the same axis. Registration aligns the images before and after a move under
all of these. A slip of the object in the gripper contradicts a report, too, but in no such way, or only once: so two
moves are needed, and an observation that agrees with its report forgets what was before.
"""

from dataclasses import dataclass, replace
from functools import cache
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from reorient import so3
from reorient.controller.agreed_symmetry import AgreedSymmetry
from reorient.controller.base import Step, degrees
from reorient.imaging import DepthImage
from reorient.registration import Hypotheses, Problem, build_problem, measure_evidence, refine

COARSE = (0.06, 0.05, 0.04, 0.03, 0.025, 0.02)
"""Tolerances of the Gauss-Newton steps of all hypotheses, relative to the object diameter. Not tuned."""
FINE = (0.03, 0.025, 0.02, 0.015, 0.012, 0.012)
"""The same for those with the highest scores."""
POINTS = 300
"""Points of each image in scores and fine steps; coarse steps take half. Not tuned."""
AXES = 60
"""Other axes that are tried; about 20 degrees apart, which Gauss-Newton bridges."""
ANGLES = 18
"""Other angles about the reported axis that are tried."""
NEARER = (0.0, 0.25, 0.5, 0.75)
"""Shifts towards the camera, relative to the object diameter, from which the reported rotation is aligned: after a
flip the object is thicker than it appeared, and translation alone hardly moves across a face."""
REPORTED = len(NEARER) + 1
"""Alignments of the reported rotation."""
KEPT = 6
"""Hypotheses with the highest scores that are refined, of those that a slip explains and of the others each."""
FEWEST_RETURNS = 50
"""Images with fewer show no motion."""
LEAST_SHARE = 0.5
"""An image with a smaller share of the other's returns shows too little: of 240 right reports 44 were contradicted
where the second image had 45% of its returns, and 5% of tuning pairs differ by so much without losses."""

Verdict = Literal["confirmed", "undecided", "slip", "contradicted", "beyond slip"]


AGAINST = ("contradicted", "beyond slip")
"""Verdicts that two moves must not have."""


@dataclass(frozen=True, eq=False)
class MeasuredMotion:
    """A reported rotation and the one that the images show best (camera axes, left)."""

    R_reported: Float[np.ndarray, "3 3"]
    R_measured: Float[np.ndarray, "3 3"]
    verdict: Verdict
    """``confirmed``: only rotations near the reported one match. ``slip``: contradicted, as by an accidental slip.
    ``contradicted``: in a way that repeats. ``beyond slip``: no rotation that a slip may lead to matches."""

    @property
    def still(self) -> bool:
        """Whether the images show no motion, or hardly any."""
        return float(so3.angle(self.R_measured)) < 0.25 * float(so3.angle(self.R_reported))

    def __str__(self) -> str:
        shown = "no rotation" if self.still else _in_words(self.R_measured)
        return f"reported {_in_words(self.R_reported)}, the images show {shown}"


@dataclass(frozen=True, kw_only=True)
class MotionTest:
    """The settings of the test; call it with two images and the rotation that was reported between them.

    Chosen on pairs of generated objects and of household objects of the tuning half, with reports that are right, with
    slips, and with wrong ones of all kinds (docs/tuning.md).
    """

    least_rad: float = float(np.radians(5))
    """Smaller reported rotations add up until they are larger."""
    score_gain: float = 0.2
    """Score by which another rotation must exceed the reported one to contradict it."""
    least_score: float = 0.0
    """Score that it must exceed itself: of a thin object that shows its edge no rotation matches."""
    violation_gain: float = 0.1
    """Share of violations that it must have less: occluded points alone contradict nothing."""
    covisible_gain: float = 0.17
    """The same among the points that are not occluded: of a body of revolution many more are, and none contradicts."""
    near: float = 0.25
    """A rotation within this share of the reported angle agrees with the report; at least ``near_rad``."""
    far: float = 0.4
    """A rotation that contradicts the report differs by this share of the reported angle; at least ``near_rad``."""
    near_rad: float = float(np.radians(4))
    """Registration errs by less."""
    confirmed_rad: float = float(np.radians(8))
    """A rotation that confirms a report is within ``near`` of it, and within this."""
    largest_rad: float = float(np.radians(100))
    """Larger reported angles count as this in the two shares."""
    slip_rad: float = float(np.radians(45))
    """A slip may change a rotation by so much."""
    same_angle: float = 0.15
    """Two angles that differ by this share, or 3 degrees, are the same."""
    same_axis_rad: float = float(np.radians(12))
    """Two axes that differ by this are the same."""
    agree_from: float = 0.5
    """Confidence of estimates that can agree with a report."""

    def __call__(self, before: DepthImage, after: DepthImage, R_reported: Float[np.ndarray, "3 3"]) -> MeasuredMotion:
        """The comparison of one move."""
        fewer, more = sorted(np.count_nonzero(image.valid) for image in (before, after))
        if fewer < max(FEWEST_RETURNS, LEAST_SHARE * more):
            return MeasuredMotion(R_reported, R_reported, "undecided")
        found = self._aligned(build_problem(before, after, None), R_reported)
        away_rad = so3.angle_difference(found.R, R_reported)
        least_rad = min(float(so3.angle(R_reported)), self.largest_rad)
        agrees = away_rad <= max(self.near_rad, self.near * least_rad)
        agrees[:REPORTED] = True
        differs = away_rad >= max(self.near_rad, self.far * least_rad)
        best, highest = int(np.argmax(found.score)), float(found.score.max())
        if away_rad[best] <= max(self.near_rad, min(self.near * least_rad, self.confirmed_rad)) and not np.any(
            found.score[differs] > highest - self.score_gain
        ):
            return MeasuredMotion(R_reported, found.R[best], "confirmed")
        if not self._beats(found, differs, agrees):
            return MeasuredMotion(R_reported, found.R[best], "undecided")
        R_measured = found.R[found.best(differs)]
        beyond = away_rad > self.slip_rad
        if self._beats(found, beyond, ~beyond):
            return MeasuredMotion(R_reported, found.R[found.best(beyond)], "beyond slip")
        return MeasuredMotion(
            R_reported, R_measured, "contradicted" if self._repeats(R_reported, R_measured) else "slip"
        )

    def estimates_agree(self, last: Step, now: Step) -> bool:
        """Whether the rotations to the goal that the estimates before and after a move name differ by the reported one.

        A near symmetry may show the image before again where the object moved as reported: that contradicts nothing.
        """
        if last.R_executed is None or min(x.estimate.confidence or 0 for x in (last, now)) < self.agree_from:
            return False
        symmetry = AgreedSymmetry.of([last.estimate, now.estimate])
        predicted = last.estimate.R_goal_current @ last.R_executed.T
        away_rad = symmetry.nearest(now.estimate.R_goal_current[None], predicted)[1]
        return away_rad <= min(self.near * float(so3.angle(last.R_executed)), self.confirmed_rad)

    def _aligned(self, problem: Problem, R_reported: Float[np.ndarray, "3 3"]) -> "_Aligned":
        """The reported rotation, aligned by translation alone, and then all others with the highest scores."""
        start = problem.start(np.repeat(R_reported[None], REPORTED, axis=0))
        start.t_m[:-1, 2] -= np.array(NEARER) * problem.diameter_m
        start.t_m[-1] = problem.prior.translations(R_reported[None])[0]  # about the middle: right for another side
        reported = refine(problem, start, (*COARSE, *FINE), POINTS, rotate=False)
        tried = refine(problem, problem.start(_tried(R_reported)), COARSE, POINTS // 2)
        score = problem.image_score(tried, TOLERANCE, POINTS)
        beyond = so3.angle_difference(tried.R, R_reported) > self.slip_rad
        ranked = np.argsort(-score)
        kept = np.concatenate([ranked[beyond[ranked]][:KEPT], ranked[~beyond[ranked]][:KEPT]])
        refined = refine(problem, tried[kept], FINE, POINTS)
        R, t_m = (np.concatenate([a, b]) for a, b in ((reported.R, refined.R), (reported.t_m, refined.t_m)))
        return _Aligned.of(problem, Hypotheses(R, t_m))

    def _beats(self, found: "_Aligned", these: Bool[np.ndarray, " k"], those: Bool[np.ndarray, " k"]) -> bool:
        """Whether the best of these hypotheses matches clearly better than all of those."""
        if not these.any():
            return False
        one = found.best(these)
        return bool(
            found.score[one] > self.least_score
            and found.score[one] - found.score[those].max() > self.score_gain
            and found.violations[those].min() - found.violations[one] > self.violation_gain
            and found.covisible_violations[those].min() - found.covisible_violations[one] > self.covisible_gain
        )

    def _repeats(self, R_reported: Float[np.ndarray, "3 3"], R_measured: Float[np.ndarray, "3 3"]) -> bool:
        """Whether a difference is of a kind that repeats: no motion, the same angle or the same axis."""
        reported, measured = so3.log(R_reported), so3.log(R_measured)
        angle_rad, other_rad = float(np.linalg.norm(reported)), float(np.linalg.norm(measured))
        if other_rad < self.near * angle_rad:
            return True
        if abs(other_rad - angle_rad) <= max(self.same_angle * angle_rad, np.radians(3)):
            return True
        return bool(abs(reported @ measured) >= np.cos(self.same_axis_rad) * angle_rad * other_rad)


TOLERANCE = 0.015
"""Depth difference of an inlier, relative to the object diameter: that of all evidence."""


@dataclass(frozen=True, eq=False)
class _Aligned:
    """Aligned hypotheses, with scores and shares of violations; the first are the reported rotation."""

    R: Float[np.ndarray, "k 3 3"]
    score: Float[np.ndarray, " k"]
    violations: Float[np.ndarray, " k"]
    covisible_violations: Float[np.ndarray, " k"]
    """The same among the points that are not occluded."""

    @classmethod
    def of(cls, problem: Problem, hypotheses: Hypotheses) -> "_Aligned":
        evidence = [
            measure_evidence(problem.current, problem.goal, R, t_m, TOLERANCE * problem.diameter_m)
            for R, t_m in zip(hypotheses.R, hypotheses.t_m, strict=True)
        ]
        violations = np.array([x.free_space_violation + x.silhouette_violation for x in evidence])
        visible = np.array([max(1 - x.occluded, 1e-9) for x in evidence])
        return cls(hypotheses.R, np.array([x.score for x in evidence]), violations, violations / visible)

    def best(self, chosen: Bool[np.ndarray, " k"]) -> int:
        """The hypothesis with the highest score of some."""
        return int(np.argmax(np.where(chosen, self.score, -np.inf)))


def _tried(R_reported: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "k 3 3"]:
    """Rotations to compare with a reported one: no motion, the inverse, other axes, other angles, slips."""
    rotvec = so3.log(R_reported)
    angle_rad = float(np.linalg.norm(rotvec))
    turns = 2 * np.pi * np.arange(ANGLES) / ANGLES  # the first is no motion
    slips = so3.exp(np.radians(25) * _axes(AXES // 3)) @ R_reported
    same_axis = so3.exp(turns[:, None] * rotvec / angle_rad)
    return np.concatenate([R_reported[None], R_reported.T[None], same_axis, so3.exp(angle_rad * _axes(AXES)), slips])


@cache
def _axes(n: int) -> Float[np.ndarray, "n 3"]:
    """Unit vectors evenly spread over the sphere (Fibonacci lattice)."""
    k = np.arange(n) + 0.5
    z, around = 1 - 2 * k / n, np.pi * (1 + np.sqrt(5)) * k
    across = np.sqrt(1 - z**2)
    return np.stack([across * np.cos(around), across * np.sin(around), z], axis=1)


@dataclass(frozen=True, eq=False)
class MotionRecord:
    """The moves since the images last agreed with a report; immutable, folded over the steps."""

    before: DepthImage
    """The image that the next one is compared with."""
    R_now_before: Float[np.ndarray, "3 3"]
    """The reported rotation since then."""
    unconfirmed: tuple[MeasuredMotion, ...] = ()
    """Moves that no image confirmed, since one was."""
    test: MotionTest = MotionTest()

    @classmethod
    def start(cls, image: DepthImage) -> "MotionRecord":
        """Of the first image."""
        return cls(image, np.eye(3))

    def updated(self, last: Step, now: Step) -> "MotionRecord":
        """After the move of a step, and the observation that followed."""
        if last.motion_unknown:
            return replace(self, before=now.image, R_now_before=np.eye(3))
        R = self.R_now_before if last.R_executed is None else last.R_executed @ self.R_now_before
        if float(so3.angle(R)) < self.test.least_rad:
            return replace(self, R_now_before=R)
        measured = self.test(self.before, now.image, R)
        unconfirmed = () if measured.verdict == "confirmed" else (*self.unconfirmed, measured)
        if measured.verdict in AGAINST and self.test.estimates_agree(last, now):
            unconfirmed = self.unconfirmed
        return replace(self, before=now.image, R_now_before=np.eye(3), unconfirmed=unconfirmed)

    @property
    def contradiction(self) -> str:
        """The message where the images contradict the reports; empty where they do not, or not yet."""
        beyond = [x for x in self.unconfirmed if x.verdict == "beyond slip"]
        against = [x for x in self.unconfirmed if x.verdict in AGAINST]
        if len(self.unconfirmed) < 2 or not (beyond or len(against) >= 2):
            return ""
        last = (beyond or against)[-1]
        cure = (
            "is the background in the image, or does the camera repeat an old frame?"
            if last.still
            else "is R_step converted to the robot's axes (camera axes, left multiplication, radians)?"
        )
        return f"the images contradict the reported rotations: {last}: {cure}"


def _in_words(R: Float[np.ndarray, "3 3"]) -> str:
    rotvec = so3.log(R)
    angle_rad = float(np.linalg.norm(rotvec))
    axis = " ".join(f"{x:.2f}" for x in rotvec / max(angle_rad, 1e-9))
    return f"{degrees(angle_rad, 1)} about [{axis}] (camera axes)"

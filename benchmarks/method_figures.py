"""The figures of docs/method.md, from generated objects and fixed seeds.

python benchmarks/method_figures.py docs/method
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import trimesh
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from reorient import Camera, DepthImage, Fusing, load_estimator, orient, so3
from reorient.cli.arguments import Positional, parse
from reorient.estimators.polish import polish, uncertainty
from reorient.estimators.search import EFFORTS, Effort, perturb_and_select, propose, search
from reorient.estimators.verifier import features, load_verifier
from reorient.registration import (
    INLIER_TOLERANCE,
    DepthView,
    Hypotheses,
    PivotPrior,
    Problem,
    build_problem,
    non_maximum_suppression,
    refine,
)
from reorient.registration.depth_view import Warped
from reorient.registration.gauss_newton import WEIGHTS
from reorient.reporting.pictures import shade
from reorient.runs.files import make_folder, replacing
from reorient.stations.rendered import RenderedStation
from reorient.world.objects import generated
from reorient.world.pairs import Pair, sample_pair
from reorient.world.rendering import Renderer, load_world
from reorient.world.sensing import randomised
from reorient.world.symmetry import rotation_group, symmetric_error

# Okabe and Ito's colours, which colour-blind people can tell
INLIER, FREE_SPACE, SILHOUETTE, OCCLUDED, OTHER = "#009E73", "#D55E00", "#E69F00", "#0072B2", "#999999"
CLASSES = {
    "inlier": INLIER,
    "free-space violation": FREE_SPACE,
    "silhouette violation": SILHOUETTE,
    "occluded": OCCLUDED,
}
WIDTH_IN, DPI, COLOURS = 7.6, 110, 128
STYLE: Any = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "legend.frameon": False}
OBJECT, SEED = 6, 3  # of the generator's sequence 0; of the pair
LOOP = 1  # object and seed of the closed loop


@dataclass(frozen=True)
class MethodFigures:
    """The figures of docs/method.md, from generated objects and fixed seeds."""

    out: Positional[Path] = Path("docs/method")
    """Folder for the PNG files."""


def main(config: MethodFigures) -> None:
    """Draw all figures."""
    make_folder(config.out)
    for draw in DRAWINGS:
        path = config.out / f"{figure_name(draw)}.png"
        with mpl.rc_context(STYLE):
            save(draw(), path)
        print(path)


def figure_name(draw: Callable[[], Figure]) -> str:
    return draw.__name__.removeprefix("draw_").replace("_", "-")


def _figure(columns: int, height_in: float) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(WIDTH_IN, height_in), layout="constrained")
    axes = figure.subplots(1, columns, squeeze=False)[0]
    return figure, list(axes)


def save(figure: Figure, path: Path) -> None:
    canvas = FigureCanvasAgg(figure)
    figure.set_dpi(DPI)
    canvas.draw()
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB").quantize(COLOURS)
    with replacing(path) as temporary:
        picture.save(temporary, format="PNG", optimize=True)


@cache
def _mesh(index: int) -> trimesh.Trimesh:
    objects = generated(index + 1)
    return objects.load(objects.names[index])


@cache
def _pair(index: int = OBJECT, seed: int = SEED, low_deg: float = 50, high_deg: float = 50) -> Pair:
    renderer = Renderer(_mesh(index))
    low, high = np.radians([low_deg, high_deg])
    rng = np.random.default_rng(seed)
    return sample_pair(rng, renderer, load_world("benchmark"), randomised(0.001), float(low), float(high))


def _classes(warped: Warped, tolerance_m: float) -> dict[str, np.ndarray]:
    return {
        "inlier": warped.inlier(tolerance_m),
        "free-space violation": warped.free_space_violation(tolerance_m),
        "silhouette violation": warped.silhouette_violation(),
        "occluded": warped.occluded(tolerance_m),
    }


def _near_truth(problem: Problem, off_deg: float) -> Hypotheses:
    """The motion of the pair, refined from the true rotation, then rotated by some degrees."""
    R = _pair().R_goal_current[None]
    refined = refine(problem, problem.start(R), (0.05, 0.03, 0.02, 0.015, 0.01), 1000)
    away = so3.exp(np.radians(off_deg) * np.array([[0.3, 1.0, 0.1]]) / np.linalg.norm([0.3, 1.0, 0.1]))
    return refined.perturbed(problem.prior.goal_m, away, np.zeros((1, 3)))


# --- the figures ----------------------------------------------------------------------------------------------------


def draw_classes() -> Figure:
    """Current image, goal image, and the classes of current's points under a motion that is 6 degrees wrong."""
    pair = _pair()
    problem = build_problem(pair.current, pair.goal, pair.pivot_m)
    goal = problem.goal
    moved = _near_truth(problem, 6).move(problem.current.points_m.T)[0]
    figure, axes = _figure(3, 2.5)
    for axis, image, title in ((axes[0], problem.current.image, "current"), (axes[1], goal.image, "goal")):
        axis.imshow(np.asarray(shade(image, 256)))
        axis.set_title(title)
    camera = goal.image.camera
    u, v = camera.fx * moved[0] / moved[2] + camera.cx, camera.fy * moved[1] / moved[2] + camera.cy
    axes[2].contourf(goal.image.valid, levels=[0.5, 1.5], colors=["#dddddd"])
    for name, chosen in _classes(goal.warp(moved), INLIER_TOLERANCE * problem.diameter_m).items():
        axes[2].plot(u[chosen], v[chosen], ".", ms=2.2, color=CLASSES[name], label=f"{name} {chosen.mean():.0%}")
    axes[2].set_aspect("equal")
    axes[2].invert_yaxis()
    axes[2].set_title("current's points in the goal view")
    figure.legend(loc="outside lower center", fontsize=8, markerscale=4, ncols=4)
    for axis in axes:
        axis.set_axis_off()
    return figure


def _profile(camera: Camera) -> DepthImage:
    """A body that is the same in every row: an ellipse, and a step behind it."""
    x = 0.6 * (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    body = 0.6 - 0.03 * np.sqrt(np.maximum(1 - ((x + 0.015) / 0.03) ** 2, 0))
    depth_m = np.where(np.abs(x + 0.015) <= 0.03, body, np.where((x > 0) & (x < 0.045), 0.6, 0.0))
    return DepthImage(np.tile(depth_m, (camera.height, 1)), camera)


def draw_residuals() -> Figure:
    """A section through a goal's surface: warped points, and the planes that they are drawn to."""
    camera = Camera(width=128, height=128, fx=331.0, fy=331.0, cx=64.0, cy=64.0)
    goal = DepthView(_profile(camera))
    row = goal.points_m[np.abs(goal.points_m[:, 1]) < 0.001].T
    row = row[:, np.argsort(row[0], kind="stable")]
    centre = np.array([0, 0, 0.6])
    R = so3.exp(np.array([[0.0, np.radians(14), 0.0]]))
    motion = Hypotheses(R, (centre - R @ centre) + np.array([-0.008, 0.0, 0.0])).single()
    points = motion.move(row)[0][:, ::2]
    warped = goal.warp(points)
    *components, offset_m = goal.planes(warped.pixel)
    normal = np.stack(components)
    foot = points - (np.sum(normal * points, axis=0) - offset_m) / np.sum(normal**2, axis=0) * normal
    figure, (axis,) = _figure(1, 3.1)
    axis.plot(*(1000 * row[[0, 2]]), ".", ms=3, color="black", label="goal's returns")
    for edge in (row[:, 0], row[:, -1]):
        ray = np.array([0.55, 0.63])[:, None] * edge / edge[2]
        axis.plot(*(1000 * ray[:, [0, 2]].T), ":", color="black", lw=0.8)
    for name, chosen in _classes(warped, INLIER_TOLERANCE * goal.diameter_m).items():
        for start, end in zip(points[:, chosen].T, foot[:, chosen].T, strict=True):
            axis.plot(*(1000 * np.stack([start, end])[:, [0, 2]].T), color=CLASSES[name], lw=0.9)
        axis.plot(*(1000 * points[[0, 2]][:, chosen]), "o", ms=3.5, color=CLASSES[name], label=name)
    axis.set_aspect("equal")
    axis.invert_yaxis()
    axis.set_xlabel("x / mm")
    axis.set_ylabel("z / mm (camera above)")
    axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8)
    return figure


def draw_weights() -> Figure:
    """Weights of the residuals, and the forces that they exert."""
    r = np.linspace(-5, 5, 401)  # in tolerances
    bounded = 1 / (1 + r**2)
    curves = {
        "inlier": (bounded**2, INLIER),
        "occluded (one tolerance behind)": (bounded**2 / 2, OCCLUDED),
        "free-space violation": (WEIGHTS.free_space * np.sqrt(bounded), FREE_SPACE),
        "silhouette violation": (WEIGHTS.silhouette * np.sqrt(bounded), SILHOUETTE),
    }
    figure, axes = _figure(2, 2.5)
    for name, (weight, colour) in curves.items():
        axes[0].plot(r, weight, color=colour)
        axes[1].plot(r, weight * r, color=colour, label=name)
    axes[0].set_ylabel("weight $w$")
    axes[1].set_ylabel(r"force $w\,r/\tau$")
    for axis in axes:
        axis.set_xlabel(r"residual $r/\tau$")
    figure.legend(loc="outside lower center", fontsize=8, ncols=4)
    return figure


def draw_pivot_prior() -> Figure:
    """How far a rotation may move an uncertain pivot: two standard deviations, across and along the axis."""
    figure, axes = _figure(2, 2.7)
    prior = PivotPrior(0.2, np.array([0, 0, 0.6]), np.array([0, 0, 0.6]), True)
    circle = np.stack([np.cos(np.linspace(0, 2 * np.pi, 181)), np.sin(np.linspace(0, 2 * np.pi, 181))])
    for degrees, colour in ((10, OTHER), (45, OCCLUDED), (90, INLIER), (180, FREE_SPACE)):
        R = so3.exp(np.array([[0.0, np.radians(degrees), 0.0]]))
        covariance = np.linalg.inv(prior.information(R, prior.translations(R))[0][0])
        x, z = 1000 * 2 * np.linalg.cholesky(covariance[:2, :2]) @ circle
        axes[0].plot(x, z, color=colour, label=f"{degrees}°")
    axes[0].set_aspect("equal")
    axes[0].set_ylim(-14, 14)
    axes[0].set_xlabel("across the axis / mm")
    axes[0].set_ylabel("along the axis / mm")
    axes[0].legend(title="rotation", fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5))
    angle_deg = np.linspace(0, 180, 91)
    R = so3.exp(np.radians(angle_deg)[:, None] * np.array([0.0, 1.0, 0.0]))
    for shift_mm, colour in ((5, INLIER), (10, SILHOUETTE), (20, FREE_SPACE)):
        t_m = prior.translations(R) + np.array([shift_mm / 1000, 0, 0])
        axes[1].plot(angle_deg, prior.mahalanobis2(R, t_m), color=colour, label=f"{shift_mm} mm")
    axes[1].set_xlabel("rotation / degrees")
    axes[1].set_ylabel("$d^2$")
    axes[1].set_yscale("log")
    axes[1].legend(title="pivot moved by", fontsize=7)
    return figure


def _stages(problem: Problem, effort: Effort) -> list[tuple[str, Hypotheses, np.ndarray]]:
    """The hypotheses after each part of ``search``, with their scores at the tolerance of inliers."""
    rng = np.random.default_rng(0)
    grid = problem.start(so3.grid(effort.grid))
    hypotheses = propose(problem, effort)
    found = [("grid", grid), ("modes", hypotheses)]
    for number, stage in enumerate(effort.stages, start=1):
        hypotheses = refine(problem, hypotheses, stage.tolerances, stage.points)
        score = problem.score(hypotheses, stage.scored_tolerance, stage.scored_points)
        radius_rad = float(np.radians(stage.radius_deg))
        hypotheses = hypotheses[non_maximum_suppression(hypotheses.R, score, radius_rad, stage.keep)]
        found.append((f"stage {number}", hypotheses))
        if stage.copies:
            hypotheses = perturb_and_select(problem, hypotheses, rng, stage)
    return [(name, each, problem.score(each, INLIER_TOLERANCE, 1000)) for name, each in found]


def draw_search() -> Figure:
    """Score against error of all hypotheses after each stage."""
    pair = _pair(low_deg=120, high_deg=120)
    problem = build_problem(pair.current, pair.goal, None)
    found = _stages(problem, EFFORTS["normal"])
    figure = Figure(figsize=(WIDTH_IN, 3.6), layout="constrained")
    axes = figure.subplots(2, 3, sharex=True, sharey=True).ravel()
    for axis, (name, hypotheses, score) in zip(axes, found, strict=True):
        error = np.degrees(so3.angle_difference(hypotheses.R, pair.R_goal_current))
        axis.plot(error, score, ".", ms=2 if len(error) > 1000 else 6, color=OCCLUDED, mew=0)
        best = int(np.argmax(score))
        axis.plot(error[best], score[best], "o", ms=8, mfc="none", color=FREE_SPACE)
        axis.set_title(f"{name}: {len(hypotheses)}, nearest {error.min():.1f}°", fontsize=8)
    figure.supxlabel("error of the rotation / degrees", fontsize=9)
    figure.supylabel("score", fontsize=9)
    return figure


@cache
def _searched() -> list[tuple[Problem, Hypotheses, Float[np.ndarray, " k"], Float[np.ndarray, " k"], Pair]]:
    """Of 40 pairs of different objects: the hypotheses of the search, their errors (degrees), their log-odds."""
    found = []
    for index in range(40):
        pair = _pair(index, index, 0, 180)
        problem = build_problem(pair.current, pair.goal, pair.pivot_m)
        hypotheses = search(problem, EFFORTS["normal"]).hypotheses
        found.append((problem, hypotheses, _errors_deg(index, pair, hypotheses), _log_odds(problem, hypotheses), pair))
    return found


def _errors_deg(index: int, pair: Pair, hypotheses: Hypotheses) -> Float[np.ndarray, " k"]:
    """Symmetry-aware."""
    group = rotation_group(_mesh(index))
    errors = [symmetric_error(group, R, pair.R_goal_current, pair.R_camera_object) for R in hypotheses.R]
    return np.asarray(np.degrees(np.array(errors)))


def _log_odds(problem: Problem, hypotheses: Hypotheses) -> Float[np.ndarray, " k"]:
    return load_verifier().log_odds(features(problem, hypotheses))


def draw_verifier() -> Figure:
    """Log-odds of the verifier against the error of hypotheses, and its calibration."""
    figure, axes = _figure(2, 2.9)
    for _, _, error, log_odds, _ in _searched():
        best = int(np.argmax(log_odds))
        axes[0].plot(np.maximum(error, 0.05), log_odds, ".", ms=4, color=OTHER, mew=0)
        axes[0].plot(max(error[best], 0.05), log_odds[best], ".", ms=7, color=OCCLUDED, zorder=3)
    axes[0].axvline(5, color="black", lw=0.8, ls=":")
    axes[0].plot([], [], ".", color=OTHER, label="hypotheses")
    axes[0].plot([], [], ".", ms=7, color=OCCLUDED, label="selected")
    axes[0].set_xscale("log")
    axes[0].set_xlabel("symmetry-aware error / degrees")
    axes[0].set_ylabel(r"log-odds $\ell$ of the trees")
    axes[0].legend(fontsize=7, loc="lower left")
    line, verifier = np.linspace(-8, 8, 161), load_verifier()
    for effort, colour in (("fast", SILHOUETTE), ("normal", OCCLUDED)):
        scale, shift = verifier.calibration[effort]
        label = f"{effort}: a = {scale:.2f}, b = {shift:.2f}"
        axes[1].plot(line, verifier.probability(line, effort), color=colour, label=label)
    axes[1].set_xlabel(r"log-odds $\ell$ of the selected hypothesis")
    axes[1].set_ylabel(r"confidence $\sigma(a\ell+b)$")
    axes[1].legend(fontsize=7, loc="lower right")
    return figure


def draw_polish() -> Figure:
    """The selected hypotheses before and after the polish, and the standard error from the curvature."""
    before, after, predicted = [], [], []
    for index, (problem, hypotheses, error, log_odds, pair) in enumerate(_searched()):
        best = int(np.argmax(log_odds))
        if error[best] > 5:
            continue
        polished = polish(problem, hypotheses[np.array([best])])
        before.append(error[best])
        after.append(_errors_deg(index, pair, polished.hypothesis)[0])
        predicted.append(np.degrees(np.sqrt(np.trace(uncertainty(problem, polished)[0]))))
    figure, axes = _figure(2, 2.9)
    for axis, x, y in ((axes[0], before, after), (axes[1], predicted, after)):
        axis.plot([0.1, 5], [0.1, 5], color="black", lw=0.8, ls=":")
        axis.plot(x, y, ".", ms=6, color=OCCLUDED, mew=0)
        axis.set_xscale("log")
        axis.set_yscale("log")
        axis.set_ylabel("error after the polish / degrees")
    axes[0].set_xlabel("error before the polish / degrees")
    axes[1].set_xlabel(r"$\sqrt{\mathrm{tr}\,\Sigma}$ / degrees")
    return figure


def draw_belief() -> Figure:
    """Log-odds of the hypotheses over the images of one loop, and the remaining angle with its standard error."""
    strategy, rng = Fusing(), np.random.default_rng(LOOP)
    station = RenderedStation(_mesh(LOOP), load_world("benchmark"), randomised(0.001), rng)
    goal, R_goal = station.capture_goal(), station.R_camera_object
    station.R_camera_object = so3.sample_uniform(rng, 1)[0] @ R_goal
    R_goal_start = R_goal @ station.R_camera_object.T
    result = orient(station, goal, load_estimator(), strategy)
    belief = strategy.start(goal)
    tracks: list[tuple[np.ndarray, list[tuple[int, float]]]] = []
    angles: list[tuple[int, float, float, float]] = []
    for step in result.steps:
        belief = belief.updated(step)
        for hypothesis in belief.hypotheses:
            away = [float(so3.angle_difference(hypothesis.R_goal_start, R)) for R, _ in tracks]
            if not away or min(away) > belief.settings.same_rad:
                tracks.append((hypothesis.R_goal_start, []))
                away.append(0.0)
            tracks[int(np.argmin(away))][1].append((step.index, hypothesis.log_odds))
        true_rad = float(so3.angle(R_goal_start @ belief.viewpoint_now.R_then_start.T))
        R_goal_now, error_rad = belief.fused(belief.hypotheses[0])
        angles.append((step.index, true_rad, float(so3.angle(R_goal_now)), error_rad))
    figure, axes = _figure(2, 3.0)
    for (R, track), line, width in zip(tracks, ("-", "-", "--", ":"), (2, 2, 2, 3), strict=False):
        off_deg = float(np.degrees(so3.angle_difference(R, R_goal_start)))
        colour = INLIER if off_deg < 15 else FREE_SPACE if line == "-" else OTHER
        axes[0].plot(*np.array(track).T, line, lw=width, color=colour, label=f"{off_deg:.0f}°")
    axes[0].set_ylabel(r"log-odds $\ell_h$")
    axes[0].legend(title="error of the hypothesis", fontsize=7, loc="center right", bbox_to_anchor=(1.0, 0.6), ncols=2)
    index, true_rad, fused_rad, error_rad = np.array(angles).T
    axes[1].plot(index, np.degrees(true_rad), ".-", color=INLIER, label="true")
    axes[1].plot(index, np.degrees(fused_rad), ".-", color=OCCLUDED, label="fused, likeliest hypothesis")
    axes[1].plot(index, np.degrees(error_rad), ".:", color=OTHER, label="standard error")
    axes[1].set_yscale("log")
    axes[1].set_ylabel("remaining angle / degrees")
    axes[1].legend(fontsize=7)
    for axis in axes:
        axis.set_xlabel("image")
    for step in result.steps:
        axes[1].text(step.index, 1.02, step.phase, transform=axes[1].get_xaxis_transform(), rotation=60, fontsize=7)
    return figure


DRAWINGS = (
    *(draw_classes, draw_residuals, draw_weights, draw_pivot_prior, draw_search, draw_verifier, draw_polish),
    draw_belief,
)

if __name__ == "__main__":
    main(parse(MethodFigures, "benchmarks/method_figures.py", sys.argv[1:]))

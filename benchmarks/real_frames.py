"""Estimators on what real frames of a held object have: unknown pixels, static parts, stray returns, holes.

    python benchmarks/real_frames.py out/real-generated --count 300 --object-seed 1700 --estimators default gicp
    python benchmarks/real_frames.py out/real-household --meshes FOLDER --only results/household-reporting.txt

Every pair is measured without its loss ("none") and with it, by all estimators. One raw row for each estimator, pair
and condition; an interrupted run continues where it stopped. Groups of conditions:

- ``unknown``: a tenth to four tenths of the object's pixels are lost in each image, to the gripper that holds it, to a
  shadow or to dark patches; or a tenth to four tenths are beyond the frame of one image. "known": they are unknown
  pixels; otherwise they have depth 0, as in recordings that tell no loss from background.
- ``stray``: 1 to 5 stray returns in both images.
- ``static``: a table's fragment, or a gripper, that does not move makes 10 to 75% of the returns (``level``).
- ``holes``: pairs of the preset ``in_hand`` of which, at the true rotation, 25 to 50% of the points land where the
  other image has no return (``level``).
- ``in_hand``: the preset as it is.
- ``pivot``: the same pair without a pivot, and with the nominal one shifted by 0 to 100 cm.

The noise is that of the structured-light sensor, without the paper's rectangle. The summary has a line for each
condition, range and estimator: right answers (symmetry-aware error below 5 degrees) and answers with a confidence of at
least 0.9, with Wilson's 95% intervals.
"""

import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import Generator
from scipy.stats import binomtest

from reorient import DepthImage, so3
from reorient.cli.arguments import Positional, parse
from reorient.cli.progress import show_progress
from reorient.errors import ReorientError, check_range, unknown_name
from reorient.estimators import load_estimator
from reorient.experiments.cached import cached_estimator, cached_object
from reorient.experiments.cells import COLUMNS as MEASURED
from reorient.experiments.cells import estimate_cells
from reorient.reporting.rows import numbers, read_table
from reorient.runs.pool import Pool
from reorient.runs.run import Row, RowStore, Tables, resumable
from reorient.world.gripper import grip
from reorient.world.in_hand import InHand
from reorient.world.losses import LOSSES, with_losses, with_stray_returns
from reorient.world.objects import ObjectSource
from reorient.world.pairs import Pair, sample_pair, scene_of, share_on_holes
from reorient.world.rendering import Renderer, World, load_world
from reorient.world.sensing import randomised
from reorient.world.static_parts import with_static_part

Range = tuple[float, float]
SURE = 0.9
RIGHT_DEG = 5.0
UNKNOWN_SHARE = (0.1, 0.4)
STATIC_SHARE = (0.10, 0.75)
STATIC_BINS = ((0.10, 0.33), (0.33, 0.50), (0.50, 0.75))
ON_HOLES = (0.25, 0.50)
DRAWS = 40
# ranges of the losses from which shares of a tenth to four tenths are drawn
LARGE = InHand(baseline_m=(0.1, 0.6), patch_count=(1, 4), patch_radius=(0.15, 0.5))
LEFT = ("group", "condition", "known", "noise_mm", "low_deg", "high_deg", "level", "object", "pair", "pivot")
COLUMNS = (*LEFT, *(name for name in MEASURED if name not in (*LEFT, "world", "overlap")))


@dataclass(frozen=True)
class Condition:
    """A pair as an estimator gets it."""

    name: str
    known: str
    """1 or 0: whether its losses are unknown pixels; empty without losses."""
    level: float
    """Share that the condition is about."""
    pair: Pair
    with_pivot: bool = False
    """Give the pair's pivot to the estimators, whatever the options."""


Conditions = Iterator[Condition]


def unknown(rng: Generator, renderer: Renderer, pair: Pair, noise_m: float) -> Conditions:
    """The same pair without loss, and with each kind of loss, known and not known."""
    yield Condition("none", "", 0, pair)
    scene = scene_of(renderer, pair)
    for name in ("gripper", "shadow", "patches"):
        for _ in range(DRAWS):
            gripper = grip(rng, renderer, pair.placement, scene.R_camera_object, LARGE.hand)
            masks = LOSSES[name](rng, scene, gripper, LARGE)
            if UNKNOWN_SHARE[0] <= scene.share(masks).min() <= scene.share(masks).max() <= UNKNOWN_SHARE[1]:
                break
        else:
            continue  # no such loss is possible here, such as a shadow on a sphere
        for known in (1, 0):
            current, goal = scene.without({name: masks}, frozenset({name} if known else ()))
            yield Condition(name, str(known), scene.share(masks).mean(), replace(pair, current=current, goal=goal))
    share = rng.uniform(*UNKNOWN_SHARE)
    cut = _beyond_frame(rng, pair.goal, share)
    yield Condition("frame", "1", share, replace(pair, goal=cut))
    left, top = round(pair.goal.camera.cx - cut.camera.cx), round(pair.goal.camera.cy - cut.camera.cy)
    beyond = np.ones_like(pair.goal.valid)
    beyond[top : top + cut.camera.height, left : left + cut.camera.width] = False
    masks = np.stack([np.zeros_like(beyond), beyond])
    yield Condition("frame", "0", share, replace(pair, goal=scene.without({"frame": masks}, frozenset())[1]))


def _beyond_frame(rng: Generator, image: DepthImage, share: float) -> DepthImage:
    """The image cut at one of its sides, so that this share of its returns is beyond it."""
    rows, columns = np.nonzero(image.valid)
    width, height = image.camera.width, image.camera.height
    side = rng.integers(4)
    if side < 2:
        cut = round(float(np.quantile(columns, share if side == 0 else 1 - share)))
        return image.cropped(cut, 0, width - cut, height) if side == 0 else image.cropped(0, 0, cut, height)
    cut = round(float(np.quantile(rows, share if side == 2 else 1 - share)))
    return image.cropped(0, cut, width, height - cut) if side == 2 else image.cropped(0, 0, width, cut)


def stray(rng: Generator, renderer: Renderer, pair: Pair, noise_m: float) -> Conditions:
    """The same pair with stray returns in both images."""
    yield Condition("none", "", 0, pair)
    count = int(rng.integers(1, 5, endpoint=True))
    current, goal = (with_stray_returns(rng, image, count) for image in (pair.current, pair.goal))
    yield Condition("stray", "", count, replace(pair, current=current, goal=goal))


def static(rng: Generator, renderer: Renderer, pair: Pair, noise_m: float) -> Conditions:
    """The same pair with a static part: a table's fragment, and a gripper where one reaches the share."""
    yield Condition("none", "", 0, pair)
    scene = scene_of(renderer, pair)
    shares = STATIC_BINS[rng.integers(len(STATIC_BINS))]
    for kind in ("table", "gripper"):
        try:
            part = with_static_part(rng, scene, kind, shares, noise_m)
        except ReorientError:
            continue
        current, goal = part.images
        yield Condition(kind, "", part.share, replace(pair, current=current, goal=goal))


def in_hand(rng: Generator, renderer: Renderer, pair: Pair, noise_m: float) -> Conditions:
    """The same pair without and with the losses of the preset."""
    yield Condition("none", "", share_on_holes(pair), pair)
    current, goal = with_losses(rng, scene_of(renderer, pair), InHand())
    lost = replace(pair, current=current, goal=goal)
    yield Condition("in_hand", "", share_on_holes(lost), lost)


def holes(rng: Generator, renderer: Renderer, pair: Pair, noise_m: float) -> Conditions:
    """The same pair without losses, and with the same losses known and not known, many points on holes."""
    scene = scene_of(renderer, pair)
    for _ in range(DRAWS):
        seed = rng.integers(2**31)
        drawn = []
        for known in (1, 0):
            numbers = InHand(all_known=known, none_known=1 - known, stray=0, least_kept=0.25)
            current, goal = with_losses(np.random.default_rng(seed), scene, numbers)
            drawn.append(Condition("holes", str(known), 0, replace(pair, current=current, goal=goal)))
        level = share_on_holes(drawn[0].pair)
        if ON_HOLES[0] <= level <= ON_HOLES[1]:
            yield Condition("none", "", share_on_holes(pair), pair)
            yield from (replace(condition, level=level) for condition in drawn)
            return
    raise ReorientError("no losses with a quarter to a half of the points on holes: expected another pair")


def pivot(rng: Generator, renderer: Renderer, pair: Pair, noise_m: float) -> Conditions:
    """The same pair without a pivot, and with one that is shifted in one direction, away from the camera."""
    yield Condition("none", "", 0, pair)
    away = so3.sample_axes(rng, 1)[0]
    away *= 1 if away[2] > 0 else -1
    for off_cm in (0, 3, 8, 15, 100):
        shifted = replace(pair, pivot_m=pair.pivot_m + off_cm / 100 * away)
        yield Condition(f"{off_cm} cm off", "", off_cm, shifted, with_pivot=True)


@dataclass(frozen=True)
class Group:
    """Conditions that share their pairs."""

    conditions: Callable[[Generator, Renderer, Pair, float], Conditions]
    world: str
    """Preset of camera, size and distance."""
    ranges_deg: tuple[Range, ...]


GROUPS = {
    "unknown": Group(unknown, "benchmark", ((0, 30), (30, 60))),
    "stray": Group(stray, "benchmark", ((0, 30), (30, 60), (60, 90))),
    "static": Group(static, "in_hand", ((10, 60),)),
    "holes": Group(holes, "in_hand", ((33, 60), (60, 90))),
    "in_hand": Group(in_hand, "in_hand", ((0, 33), (33, 60), (60, 90), (90, 180))),
    "pivot": Group(pivot, "benchmark", ((0, 60), (60, 180))),
}


@dataclass(frozen=True)
class RealFrames:
    """Pairs and estimators to measure."""

    objects: ObjectSource = field(default_factory=lambda: ObjectSource(count=300, object_seed=1700))
    """Objects of the pairs."""
    estimators: tuple[str, ...] = ("default", "gicp")
    """Names of estimators, each with a row for every pair and condition."""
    groups: tuple[str, ...] = tuple(GROUPS)
    """Groups of conditions: unknown, stray, static, holes, in_hand, pivot."""
    noise_mm: tuple[float, ...] = (0.0, 1.0)
    """Standard deviation of the sensor's depth noise."""
    pairs: int = 300
    """Number of pairs for each group, range and noise, spread over the objects."""
    pivot: bool = False
    """Give the estimators the nominal pivot, up to 1 cm wrong along each axis."""
    seed: int = 17
    """Seed of the pairs."""

    def __post_init__(self) -> None:
        """Raises ReorientError for an unknown group or estimator, and for values out of range."""
        for name in self.groups:
            if name not in GROUPS:
                raise unknown_name("group", name, list(GROUPS))
        for name in self.estimators:
            load_estimator(name)
        check_range(self, "noise_mm", "seed")
        check_range(self, "pairs", low=1)


@dataclass(frozen=True)
class Run:
    """Estimators on what real frames of a held object have. Prints the summary as a Markdown table."""

    out: Positional[Path]
    """Folder for config.json and rows.csv.gz."""
    config: RealFrames = field(default_factory=RealFrames)
    pool: Pool = field(default_factory=Pool)


def measure(config: RealFrames, out: Path, pool: Pool | None = None) -> Iterator[tuple[int, int]]:
    """Run; yields (pairs done, pairs in all). The rows are in ``out/rows.csv.gz`` when it ends."""
    names = config.objects.open().names
    tasks = {str(index): (config, names[index % len(names)], index) for index in range(config.pairs)}
    yield from resumable(out, config, tasks, _measure_pair, RowStore(), pool)


def _measure_pair(task: tuple[RealFrames, str, int]) -> Tables:
    config, name, index = task
    mesh, group = cached_object(config.objects, name)
    renderer = Renderer(mesh)
    rows: list[Row] = []
    for key in config.groups:
        for low, high in GROUPS[key].ranges_deg:
            for noise_mm in config.noise_mm:
                for condition in _drawn(config, renderer, index, key, (low, high), noise_mm):
                    pair = condition.pair
                    about = {
                        "group": key,
                        "condition": condition.name,
                        "known": condition.known,
                        "noise_mm": noise_mm,
                        "low_deg": low,
                        "high_deg": high,
                        "level": f"{condition.level:.4f}",
                        "object": name,
                        "pair": index,
                        "pivot": int(config.pivot or condition.with_pivot),
                        "angle_deg": f"{np.degrees(so3.angle(pair.R_goal_current)):.4f}",
                    }
                    for estimator in config.estimators:
                        pivot_m = pair.pivot_m if config.pivot or condition.with_pivot else None
                        cells = estimate_cells(cached_estimator(estimator), pair, group, pivot_m)
                        row: dict[str, Any] = dict.fromkeys(COLUMNS, "") | cells | about | {"estimator": estimator}
                        rows.append({column: str(row[column]) for column in COLUMNS})
    return {"rows": rows}


def _drawn(
    config: RealFrames, renderer: Renderer, index: int, key: str, range_deg: Range, noise_mm: float
) -> list[Condition]:
    """The conditions of one pair; a pair that does not allow them is drawn again."""
    low, high = range_deg
    group = GROUPS[key]
    world: World = replace(load_world(group.world), in_hand=None)
    sensor = replace(randomised(noise_mm / 1000), rectangle=False)
    rng = np.random.default_rng(
        [config.seed, index, list(GROUPS).index(key), *map(round, (low, high, 1000 * noise_mm))]
    )
    for _ in range(DRAWS):
        pair = sample_pair(rng, renderer, world, sensor, np.radians(low), np.radians(high))
        try:
            return list(group.conditions(rng, renderer, pair, noise_mm / 1000))
        except ReorientError:
            continue
    raise ReorientError(f"no pair of an object allows {key}: expected larger objects")


HEAD = (
    *("group", "condition", "known", "noise", "range", "estimator", "pairs", "median°", "p90°"),
    *("< 5° (95%)", "less none", "sure", "sure and right (95%)", "failures found"),
)


def summarise(rows: Sequence[Row]) -> str:
    """The table: a line for each condition (static parts by their share), noise, range and estimator."""
    none = {_pair_key(row): float(row["error_sym_deg"]) < RIGHT_DEG for row in rows if row["condition"] == "none"}
    cells: dict[tuple[str, ...], list[Row]] = {}
    for row in rows:
        cells.setdefault(_cell(row), []).append(row)
    lines = [HEAD, ["---"] * 6 + ["---:"] * (len(HEAD) - 6)]
    for cell, chosen in sorted(cells.items(), key=lambda item: _order(item[0])):
        error_deg = numbers(chosen, "error_sym_deg")
        right = error_deg < RIGHT_DEG
        confidence = np.array([float(row["confidence"] or "nan") for row in chosen])
        sure = confidence >= SURE
        rated = bool(np.isfinite(confidence).all())
        less = 100 * float(np.mean(right.astype(float) - [none[_pair_key(row)] for row in chosen]))
        found = f"{np.count_nonzero(~right & (confidence < 0.5))} of {np.count_nonzero(~right)}"
        lines.append(
            [
                *cell,
                str(len(chosen)),
                f"{np.median(error_deg):.2f}",
                f"{np.percentile(error_deg, 90):.2f}",
                share(right),
                "" if cell[1] == "none" else f"{less:+.1f}",
                f"{sure.mean():.1%}" if rated else "–",
                share(right[sure]) if rated else "–",
                found if rated else "–",
            ]
        )
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _pair_key(row: Row) -> tuple[str, ...]:
    return tuple(row[name] for name in ("group", "noise_mm", "low_deg", "high_deg", "pair", "estimator"))


def _cell(row: Row) -> tuple[str, ...]:
    condition = row["condition"]
    if row["group"] == "static" and condition != "none":
        low, high = next(limits for limits in STATIC_BINS if float(row["level"]) <= limits[1])
        condition += f" {100 * low:.0f}–{100 * high:.0f}%"
    known = {"1": "known", "0": "as 0", "": ""}[row["known"]]
    span = f"{float(row['low_deg']):g}–{float(row['high_deg']):g}°"
    return row["group"], condition, known, f"{float(row['noise_mm']):g} mm", span, row["estimator"]


def _order(cell: tuple[str, ...]) -> tuple[Any, ...]:
    group, condition, known, noise, span, estimator = cell
    return list(GROUPS).index(group), float(span.split("–")[0]), noise, condition != "none", condition, known, estimator


def share(right: np.ndarray) -> str:
    """A share with its count and Wilson's interval."""
    if not len(right):
        return "0 of 0"
    low, high = binomtest(int(right.sum()), len(right)).proportion_ci(method="wilson")
    return f"{right.mean():.1%} of {len(right)} ({100 * low:.1f}–{100 * high:.1f})"


def main(run: Run) -> None:
    """Measure, then print the table."""
    show_progress("pairs", measure(run.config, run.out, run.pool))
    print(summarise(read_table(run.out / "rows.csv.gz", COLUMNS)))


if __name__ == "__main__":
    main(parse(Run, "benchmarks/real_frames.py", sys.argv[1:]))

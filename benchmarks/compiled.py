"""What a just-in-time compiler would gain: the two kernels of ``default`` in numba, against the numpy they replace.

    pip install numba
    python benchmarks/compiled.py --meshes FOLDER --only NAMES

Processor time of one thread: of the kernels, and of whole estimates with both replaced. The compiled kernels do the
same sums in the same precision, point by point without intermediate arrays.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from math import sqrt
from typing import Any

import numba
import numpy as np
import tyro

from reorient.estimators import evidence, refine
from reorient.estimators.default import Default
from reorient.estimators.refine import FRONT_WEIGHT, HIDDEN_REACH, OUTSIDE_WEIGHT
from reorient.objects import ObjectSource
from reorient.pairs import sample_pair
from reorient.rendering import Renderer, load_world
from reorient.sensing import randomised

NOWHERE_M = float(evidence.NOWHERE_M)


@numba.njit(inline="always", fastmath=True)
def _pixel(x, y, z, camera):  # type: ignore[no-untyped-def]
    inverse = np.float32(1) / max(z, np.float32(1e-6))
    u = min(max(x * inverse * camera[0] + camera[2], np.float32(0)), camera[4] - np.float32(1))
    v = min(max(y * inverse * camera[1] + camera[3], np.float32(0)), camera[5] - np.float32(1))
    return np.int32(v) * np.int32(camera[4]) + np.int32(u)


@numba.njit(fastmath=True)
def _agreement_one_way(points, R, t, surface_m, camera, tolerance, score):  # type: ignore[no-untyped-def]
    n = points.shape[1]
    for k in range(len(R)):
        r, s, total = R[k], t[k], np.int32(0)
        for i in range(n):
            a, b, c = points[0, i], points[1, i], points[2, i]
            x = r[0, 0] * a + r[0, 1] * b + r[0, 2] * c + s[0]
            y = r[1, 0] * a + r[1, 1] * b + r[1, 2] * c + s[1]
            z = r[2, 0] * a + r[2, 1] * b + r[2, 2] * c + s[2]
            beyond = z - surface_m[_pixel(x, y, z, camera)]
            total += np.int32(beyond <= tolerance) - 2 * np.int32(beyond < -tolerance)
        score[k] += np.float32(total) / np.float32(2 * n)


@numba.njit(fastmath=True)
def _moments_one_way(points, R, t, normal, offset_m, surface_m, camera, tolerance, center, half, back, out):  # type: ignore[no-untyped-def]
    n = points.shape[1]
    J = np.empty(7, np.float32)
    for k in range(len(R)):
        r, s = R[k], t[k]
        sums = np.zeros((7, 7), np.float32)
        for i in range(n):
            a, b, c = points[0, i], points[1, i], points[2, i]
            x = r[0, 0] * a + r[0, 1] * b + r[0, 2] * c + s[0]
            y = r[1, 0] * a + r[1, 1] * b + r[1, 2] * c + s[1]
            z = r[2, 0] * a + r[2, 1] * b + r[2, 2] * c + s[2]
            place = _pixel(x, y, z, camera)
            nx, ny, nz = normal[0, place], normal[1, place], normal[2, place]
            residual = nx * x + ny * y + nz * z - offset_m[place]
            behind = z - surface_m[place]
            ratio = residual / tolerance
            bounded = np.float32(1) / (np.float32(1) + ratio * ratio)
            if behind < -tolerance:
                force = OUTSIDE_WEIGHT if behind < np.float32(-NOWHERE_M / 2) else FRONT_WEIGHT
                weight = force * np.float32(sqrt(bounded))
            else:
                far = max(behind, np.float32(0)) / (HIDDEN_REACH * tolerance)
                weight = bounded * bounded / (np.float32(1) + far * far)
            if back:  # the lever is the goal's own point, the plane turns with the current
                x, y, z = a, b, c
                nx, ny, nz = (
                    -(r[0, 0] * nx + r[1, 0] * ny + r[2, 0] * nz),
                    -(r[0, 1] * nx + r[1, 1] * ny + r[2, 1] * nz),
                    -(r[0, 2] * nx + r[1, 2] * ny + r[2, 2] * nz),
                )
            x, y, z = x - center[0], y - center[1], z - center[2]
            J[0], J[1], J[2] = y * nz - z * ny, z * nx - x * nz, x * ny - y * nx
            J[3], J[4], J[5], J[6] = nx * half, ny * half, nz * half, residual
            weight /= np.float32(n)
            for p in range(7):
                wj = weight * J[p]
                for q in range(p, 7):
                    sums[p, q] += wj * J[q]
        for p in range(7):
            for q in range(p, 7):
                out[k, p, q] += sums[p, q]
                if p != q:
                    out[k, q, p] += sums[p, q]


def _camera(view: Any) -> np.ndarray:
    return np.array([*view._focal, *view._centre, view._width, view._height], np.float32)


def _inverse(R: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    back = np.ascontiguousarray(np.swapaxes(R, 1, 2))
    return back, -(back @ t[:, :, None])[:, :, 0]


def agreement(current: Any, goal: Any, R: np.ndarray, t_m: np.ndarray, tolerance_m: float, points: int) -> np.ndarray:
    """As ``evidence.agreement``."""
    R, t = R.astype(np.float32), t_m.astype(np.float32)
    score = np.zeros(len(R), np.float32)
    for source, target, (turn, shift) in ((current, goal, (R, t)), (goal, current, _inverse(R, t))):
        _agreement_one_way(
            source.sample(points), turn, shift, target._surface_m, _camera(target), np.float32(tolerance_m), score
        )
    return score


def moments(look: Any, goal: Any, hypotheses: Any, frame: Any, tolerance_m: float, points: int) -> np.ndarray:
    """As ``refine._moments``."""
    then = hypotheses.after(look.R_now_then, look.t_now_then_m)
    R, t = then.R.astype(np.float32), then.t_m.astype(np.float32)
    out = np.zeros((len(R), 7, 7), np.float32)
    for source, view, (turn, shift), back in (
        (look.surface, goal, (R, t), False),
        (goal, look.surface, _inverse(R, t), True),
    ):
        _moments_one_way(
            source.sample(points),
            turn,
            shift,
            view._normal,
            view._offset_m,
            view._surface_m,
            _camera(view),
            np.float32(tolerance_m),
            frame.center_m.astype(np.float32),
            np.float32(frame.size_m / 2),
            back,
            out,
        )
    return out


@dataclass(frozen=True)
class Compiled:
    """What to run."""

    source: tyro.conf.OmitArgPrefixes[ObjectSource] = field(default_factory=ObjectSource)
    pairs: int = 30
    effort: str = "normal"


def main(config: Compiled) -> None:
    """Estimates with and without, in turn, on the same pairs."""
    plain: dict[str, Callable[..., Any]] = {"agreement": refine.agreement, "_moments": refine._moments}
    compiled = {"agreement": agreement, "_moments": moments}
    objects, world, estimator = config.source.open(), load_world("benchmark"), Default(config.effort)
    spent: dict[str, list[float]] = {"numpy": [], "numba": []}
    inside: dict[str, float] = {}
    apart = []

    def timed(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def run(*arguments: Any) -> Any:
            begin = time.process_time()
            result = function(*arguments)
            inside[name] = inside.get(name, 0.0) + time.process_time() - begin
            return result

        return run

    for index in range(config.pairs + 1):  # the first compiles
        renderer = Renderer(objects.load(objects.names[index % len(objects.names)]))
        rng = np.random.default_rng([5, index])
        pair = sample_pair(rng, renderer, world, randomised(0.001), 0.5, np.pi)
        answers = []
        for name, kernels in (("numpy", plain), ("numba", compiled)):
            for key, function in kernels.items():
                setattr(refine, key, timed(f"{name} {key.strip('_')}", function))
            begin = time.process_time()
            answers.append(estimator.estimate(pair.current, pair.goal, pair.pivot_m).R_goal_current)
            spent[name].append(time.process_time() - begin)
        if index == 0:
            print(f"compiling: {spent['numba'][0]:.1f} s")
            spent = {"numpy": [], "numba": []}
            inside.clear()
        apart.append(np.degrees(np.arccos(min(1, (np.trace(answers[0] @ answers[1].T) - 1) / 2))))
    for name, seconds in spent.items():
        parts = ", ".join(
            f"{key} {1000 * total / config.pairs:.1f}" for key, total in inside.items() if key.startswith(name)
        )
        print(f"{name}: {1000 * np.median(seconds):.0f} ms an estimate, of which {parts}")
    print(f"ratio {np.median(spent['numpy']) / np.median(spent['numba']):.2f}")
    print(f"answers within 1 degree of each other: {np.mean(np.array(apart) < 1):.0%}")


if __name__ == "__main__":
    main(tyro.cli(Compiled, description=__doc__))

"""Simulated sequences for tracking: an object that a hand moves before a camera, with 1 mm of noise.

The object rotates within 0-60 degrees of the goal, in minimum-jerk moves between random orientations, at up to 90
degrees a second, with tremor; it shifts by some millimetres all the time. The kinds of a sequence:

- ``plain``: nothing else happens;
- ``crossing``: a bar passes in front of the object again and again. Its pixels are unknown or, in half of the
  sequences, empty, as where a mask left them out;
- ``jump``: after a third of the images the object is rotated by 20-40 degrees from one image to the next;
- ``swap``: for the middle third another object is in its place;
- ``hidden``: for the middle third all but a tenth of its returns are missing.
"""

import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from reorient import DepthImage, so3
from reorient.errors import ReorientError
from reorient.world.meshes import bounding_radius
from reorient.world.objects import ObjectSet
from reorient.world.rendering import Placement, Renderer, load_world
from reorient.world.sensing import randomised, sense
from reorient.world.symmetry import rotation_group, symmetric_error

KINDS = ("plain", "crossing", "jump", "swap", "hidden")
WORLD = load_world("benchmark")
SENSOR = replace(randomised(0.001), rectangle=False)
FARTHEST_RAD, FASTEST_RAD_S = np.radians(60), np.radians(90)
JUMP_RAD = np.radians(20), np.radians(40)
TREMOR_RAD, SHIFT_M, SHIFT_TREMOR_M = np.radians(0.15), 0.006, 0.0007
CROSSING_S, PAUSE_S, BAR_PX = 1.0, 0.5, (10.0, 30.0)
LEFT_OF_HIDDEN = 0.1


@dataclass(frozen=True)
class Frame:
    """An image of a sequence and the truth about it."""

    index: int
    image: DepthImage
    R_camera_object: np.ndarray
    t_goal_current_m: np.ndarray
    there: bool
    """Whether the object is to be seen: False while it is swapped or hidden."""


class Sequence:
    """The images of one object under one motion; the same for the same arguments."""

    def __init__(self, objects: ObjectSet, name: str, kind: str, seed: int, frames: int = 90, fps: float = 30.0):
        self.kind, self.length, self.fps = kind, frames, fps
        self._rng = rng = np.random.default_rng([seed, KINDS.index(kind), zlib.crc32(name.encode())])
        mesh = objects.load(name)
        self.renderer, self.group = Renderer(mesh), rotation_group(mesh)
        others = [each for each in objects.names if each != name]
        self._other = Renderer(objects.load(others[rng.integers(len(others))]))
        self.placement = WORLD.place(rng, self.renderer.mesh)
        self.R_goal = so3.sample_uniform(rng, 1)[0]
        self.goal = sense(rng, self.renderer, WORLD.camera, self.R_goal, self.placement, SENSOR, WORLD.quantum_m)
        path = motion(rng, frames, fps)
        self.event, self.event_end = frames // 3, 2 * frames // 3 if kind in ("swap", "hidden") else frames
        R = so3.exp(rng.standard_normal((frames, 3)) * TREMOR_RAD) @ so3.exp(path)
        if kind == "jump":
            R[self.event :] = _jump(rng, R[self.event]) @ R[self.event :]
        self._R = R @ self.R_goal
        self._shift_m = _wander(rng, frames, fps) + rng.standard_normal((frames, 3)) * SHIFT_TREMOR_M
        self._marked, self._bar_px = bool(rng.integers(2)), rng.uniform(*BAR_PX)
        self._across_rad = rng.uniform(0, 2 * np.pi, frames)

    def __iter__(self) -> Iterator[Frame]:
        for index in range(self.length):
            during = self.event <= index < self.event_end
            R, center_m = self._R[index], self.placement.center_m + self._shift_m[index]
            renderer, scale_m = self.renderer, self.placement.scale_m
            if self.kind == "swap" and during:
                renderer, scale_m = self._other, (WORLD.radius_m or 0.1) / bounding_radius(self._other.mesh)
            try:
                image = sense(
                    self._rng, renderer, WORLD.camera, R, Placement(scale_m, center_m), SENSOR, WORLD.quantum_m
                )
                if self.kind == "crossing" or (self.kind == "hidden" and during):
                    image = self._covered(image, self._bar(index) if self.kind == "crossing" else _most(image))
            except ReorientError:  # nothing is left of it
                continue
            t_m = self.placement.center_m - self.truth(R) @ center_m
            there = not (during and self.kind in ("swap", "hidden"))
            yield Frame(index, image, R, t_m, there)

    def truth(self, R_camera_object: np.ndarray) -> np.ndarray:
        """R_goal_current of an orientation."""
        return np.asarray(self.R_goal @ R_camera_object.T)

    def error_deg(self, R_goal_current: np.ndarray, frame: Frame) -> float:
        """Symmetry-aware error of an estimate."""
        truth = self.truth(frame.R_camera_object)
        return float(np.degrees(symmetric_error(self.group, R_goal_current, truth, frame.R_camera_object)))

    def _covered(self, image: DepthImage, mask: np.ndarray) -> DepthImage:
        depth_m = np.where(mask, 0, image.depth_m)
        return DepthImage(depth_m, image.camera, unknown=mask & self._marked)

    def _bar(self, index: int) -> np.ndarray:
        """The pixels that the bar covers."""
        turn, phase_s = divmod(index / self.fps, CROSSING_S + PAUSE_S)
        angle = self._across_rad[int(turn)]
        rows, columns = np.mgrid[: WORLD.camera.height, : WORLD.camera.width]
        along = (columns - WORLD.camera.cx) * np.cos(angle) + (rows - WORLD.camera.cy) * np.sin(angle)
        return np.asarray(np.abs(along - 80 * (2 * phase_s / CROSSING_S - 1)) <= self._bar_px / 2)


def _most(image: DepthImage) -> np.ndarray:
    """All pixels but the left ones, which hold a tenth of the returns."""
    columns = np.nonzero(image.valid)[1]
    return np.broadcast_to(np.arange(image.camera.width) > np.quantile(columns, LEFT_OF_HIDDEN), image.depth_m.shape)


def _jump(rng: np.random.Generator, R: np.ndarray) -> np.ndarray:
    """A rotation by 20-40 degrees that leaves R within reach of the goal, as far as 100 draws have one."""
    draws = so3.matrix_from_quat(so3.sample_bounded(rng, 100, *JUMP_RAD))
    return np.asarray(draws[np.argmin(np.maximum(so3.angle(draws @ R) - FARTHEST_RAD / 2, 0))])


def motion(rng: np.random.Generator, frames: int, fps: float) -> np.ndarray:
    """Rotation vectors (frames, 3): minimum-jerk moves between random points within 60 degrees of the goal."""
    vectors: list[np.ndarray] = []
    start = so3.sample_axes(rng, 1)[0] * rng.uniform(0, FARTHEST_RAD)
    while len(vectors) < frames:
        end = so3.sample_axes(rng, 1)[0] * rng.uniform(0, FARTHEST_RAD)
        fastest = rng.uniform(0.3, 1) * FASTEST_RAD_S  # 1.875 times the mean speed of such a move
        steps = max(int(np.ceil(1.875 * np.linalg.norm(end - start) / fastest * fps)), 2)
        s = np.arange(steps)[:, None] / steps
        vectors += list(start + (10 * s**3 - 15 * s**4 + 6 * s**5) * (end - start))
        start = end
    return np.array(vectors[:frames])


def _wander(rng: np.random.Generator, frames: int, fps: float) -> np.ndarray:
    """Smooth shifts, metres, that change within half a second."""
    times_s = np.arange(frames) / fps
    knots_s = np.arange(0, times_s[-1] + 1.5, 0.5)
    return np.asarray(CubicSpline(knots_s, rng.standard_normal((len(knots_s), 3)) * SHIFT_M)(times_s))

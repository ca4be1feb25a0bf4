"""A simulated person who rotates an object by hand before a camera, as a guide instructs: for tests and trials.

The hand sees each state of the guide after 0.3 s, misjudges axis and angle, trembles, sometimes moves the wrong way,
and stays still on instruction. Time passes by images alone, so a trial runs as fast as the machine, and the same
seed gives the same trial.
"""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy.random import Generator

from reorient import so3
from reorient.controller.guiding import GuideState
from reorient.imaging import DepthImage
from reorient.world.meshes import Mesh
from reorient.world.rendering import Placement, Renderer, World
from reorient.world.sensing import Sensor, sense


@dataclass(frozen=True, kw_only=True)
class Hand:
    """How a simulated person moves; none of it is measured on people."""

    delay_s: float = 0.3
    """From an image to the motion that answers it."""
    gain_hz: float = 1.5
    """Rotation speed relative to the angle that remains."""
    fastest_rad_s: float = float(np.radians(90))
    """Largest rotation speed."""
    misjudged: float = 0.25
    """Standard deviation of the error of each component of the motion, relative to the motion."""
    tremor_rad: float = float(np.radians(0.2))
    """Standard deviation of the tremor about each axis."""
    tremor_s: float = 0.1
    """Time within which the tremor changes."""
    wrong_every_s: float = 4.0
    """Mean time between wrong moves while rotating."""
    wrong_s: float = 0.5
    """Duration of a wrong move."""
    wrong_rad_s: float = float(np.radians(40))
    """Speed of a wrong move, and of the motion that shows another side."""
    wander_m_s: float = 0.02
    """Standard deviation of the speed along each axis; the object is drawn back to its place within a second."""


class RenderedHand:
    """A hand that follows a guide: pass it to the guide as a subscriber, and ``frames`` as its images.

    ``R_camera_object`` is the true orientation, ``error_rad`` the true angle to the goal; only an evaluation may read
    them. The goal is the pose of the start without ``start_rad``: that of a ``RenderedStation`` of the same seed.
    """

    def __init__(
        self,
        mesh: Mesh,
        world: World,
        sensor: Sensor,
        rng: Generator,
        start_rad: float = 0.0,
        hand: Hand | None = None,
        fps: float = 30.0,
    ) -> None:
        """``start_rad``: angle by which the object is rotated from the goal at first, about a random axis."""
        self.hand, self._rng, self._step_s = hand or Hand(), rng, 1 / fps
        self._renderer, self._world = Renderer(mesh), world
        self._sensor = replace(sensor, rectangle=False)
        self._placement = world.place(rng, self._renderer.mesh)
        self.R_goal = so3.sample_uniform(rng, 1)[0]
        self._R = so3.matrix_from_quat(so3.sample_bounded(rng, 1, start_rad, start_rad))[0] @ self.R_goal
        self._tremor, self._shift_m = np.zeros(3), np.zeros(3)
        self._wrong_until_s, self._velocity = -1.0, np.zeros(3)
        self._seen: deque[GuideState] = deque()
        self._latest: GuideState | None = None
        self.time_s = 0.0

    @property
    def R_camera_object(self) -> Float[np.ndarray, "3 3"]:
        """The true orientation."""
        return np.asarray(so3.exp(self._tremor) @ self._R)

    @property
    def error_rad(self) -> float:
        """The true angle between object and goal."""
        return float(so3.angle_difference(self.R_camera_object, self.R_goal))

    def goal(self) -> DepthImage:
        """The object in the goal pose."""
        return self._sense(self.R_goal, self._placement)

    def frames(self) -> Iterator[tuple[float, DepthImage]]:
        """Images without end, with their times; the hand moves between them."""
        while True:
            shifted = replace(self._placement, center_m=self._placement.center_m + self._shift_m)
            yield self.time_s, self._sense(self.R_camera_object, shifted)
            self._move()

    def __call__(self, state: GuideState) -> None:
        """Take notice of a state; it acts after the delay."""
        self._seen.append(state)

    def _sense(self, R: Float[np.ndarray, "3 3"], placement: Placement) -> DepthImage:
        return sense(self._rng, self._renderer, self._world.camera, R, placement, self._sensor, self._world.quantum_m)

    def _move(self) -> None:
        """The motion of one image's time."""
        hand, step_s = self.hand, self._step_s
        self.time_s += step_s
        while self._seen and self._seen[0].time_s + hand.delay_s <= self.time_s:
            self._latest = self._seen.popleft()
        self._R = so3.exp(self._wanted() * step_s) @ self._R
        decay = np.exp(-step_s / hand.tremor_s)
        noise, drift = self._rng.standard_normal((2, 3))
        self._tremor = decay * self._tremor + np.sqrt(1 - decay**2) * hand.tremor_rad * noise
        self._shift_m = (1 - step_s) * self._shift_m + hand.wander_m_s * np.sqrt(step_s) * drift * 0.5

    def _wanted(self) -> Float[np.ndarray, "3"]:
        """The rotation speed that the hand aims at, as a vector."""
        hand, state = self.hand, self._latest
        if state is None or state.instruction.startswith(("hold", "matched", "show")):
            return np.zeros(3)
        if self.time_s < self._wrong_until_s:
            return self._velocity
        if state.R_goal_current is None or self._rng.random() < self._step_s / hand.wrong_every_s:
            self._wrong_until_s = self.time_s + hand.wrong_s
            self._velocity = so3.sample_axes(self._rng, 1)[0] * hand.wrong_rad_s
            return self._velocity
        speed = hand.gain_hz * so3.log(state.R_goal_current)
        speed = speed + hand.misjudged * np.linalg.norm(speed) / np.sqrt(3) * self._rng.standard_normal(3)
        return np.asarray(speed * min(1.0, hand.fastest_rad_s / max(float(np.linalg.norm(speed)), 1e-9)))

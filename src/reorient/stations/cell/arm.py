"""Geometry of a robot arm from MJCF: forward and inverse kinematics, collisions, shapes.

Transforms are (4, 4) ``T_a_b``, from b to a, metres. World axes are those of the robot's base: x forward, y left, z up.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import mink
import mujoco
import numpy as np
import trimesh
from jaxtyping import Float

from reorient import se3, so3
from reorient.errors import ReorientError, StationError
from reorient.se3 import Transform

YUMI = Path(__file__).with_name("yumi.xml")
_SLOWEST_RAD_S = 1.0  # joint speed if the MJCF has none
_STEPS = 100  # iterations of the inverse kinematics from one start
_NEAR_M, _NEAR_RAD = 1e-4, 2e-4  # tolerance of the inverse kinematics
_STARTS = 6  # random starts of the inverse kinematics, besides the present and the home position
_SWEEP_RAD = 0.1  # distance of the collision-checked points of a path


@dataclass(frozen=True, eq=False)
class Part:
    """A rigid shape of the cell."""

    name: str
    """Name of its body."""
    mesh: trimesh.Trimesh
    """In the frame of the part, metres."""
    rgb: Float[np.ndarray, "3"]
    """In [0, 1]."""
    T_world_part: Transform


class Arm:
    """The arm's geometry. Joints are the hinges from the base to the site ``tcp``, in radians."""

    def __init__(self, mjcf: str | Path = YUMI) -> None:
        self.mjcf = Path(mjcf)
        if not self.mjcf.is_file():
            raise ReorientError(f"no arm file {str(mjcf)!r}: expected an MJCF (.xml) with a site 'tcp'")
        try:
            self.model = mujoco.MjModel.from_xml_path(str(self.mjcf))
        except ValueError as error:
            raise ReorientError(f"cannot read arm {str(mjcf)!r} ({_line(error)}): expected MJCF") from error
        self.data = mujoco.MjData(self.model)
        self._tcp = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_SITE, "tcp")
        home = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_KEY, "home")
        if min(self._tcp, home) < 0:
            raise ReorientError(f"arm {str(mjcf)!r} has no site 'tcp' or no keyframe 'home': expected both")
        self.hand = int(self.model.site_bodyid[self._tcp])
        self.joints, self.fingers = self._chain()
        self._address = self.model.jnt_qposadr[self.joints]
        self._finger_address = self.model.jnt_qposadr[self.fingers]
        self.low_rad, self.high_rad = self.model.jnt_range[self.joints].T
        self.stroke_m = float(self.model.jnt_range[self.fingers, 1].min())
        self.home_rad = self.model.key_qpos[home][self._address]
        speed = self.model.numeric("speed").data if "speed" in _numerics(self.model) else [_SLOWEST_RAD_S]
        self.speed_rad_s = np.broadcast_to(speed, len(self.joints))
        self._shapes = [_part(self.model, geom) for geom in range(self.model.ngeom)]
        self._configuration = mink.Configuration(self.model)
        self._limits = [mink.ConfigurationLimit(self.model)]

    def _chain(self) -> tuple[list[int], list[int]]:
        """Indices of the hinges from the base to the hand, and of the slides of the fingers."""
        joints: list[int] = []
        body = self.hand
        while body:
            first, count = self.model.body_jntadr[body], self.model.body_jntnum[body]
            joints = [*range(first, first + count), *joints]
            body = self.model.body_parentid[body]
        hinges = [j for j in joints if self.model.jnt_type[j] == mujoco.mjtJoint.mjJNT_HINGE]
        fingers = [
            j
            for j in range(self.model.njnt)
            if self.model.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE
            and self.model.body_parentid[self.model.jnt_bodyid[j]] == self.hand
        ]
        if hinges != joints or len(hinges) < 3 or not fingers or not np.all(self.model.jnt_limited[hinges + fingers]):
            raise ReorientError(
                f"arm {str(self.mjcf)!r}: expected at least 3 hinges on the way to site 'tcp', slides for the fingers "
                "on its body, and a range for each"
            )
        return hinges, fingers

    # --- kinematics -------------------------------------------------------------------------------------------------

    def tcp(self, joints_rad: Float[np.ndarray, " n"]) -> Transform:
        """T_world_tcp at these joint positions."""
        self._place(joints_rad, 0.0)
        return se3.transform(self.data.site_xmat[self._tcp].reshape(3, 3), self.data.site_xpos[self._tcp])

    def solve(
        self, T_world_tcp: Transform, near_rad: Float[np.ndarray, " n"], fingers_m: float = 0.0
    ) -> Float[np.ndarray, " n"]:
        """Joint positions for a pose of the tool centre, within limits, on a free straight path in joint space.

        ``near_rad``: the present positions, the first start of the iteration, so that small moves stay small. Raises
        StationError if there is no solution.
        """
        rng = np.random.default_rng(0)
        starts = [near_rad, self.home_rad, *rng.uniform(self.low_rad, self.high_rad, (_STARTS, len(self.joints)))]
        solved = False
        for start in starts:
            joints_rad = self._inverse_kinematics(T_world_tcp, np.clip(start, self.low_rad, self.high_rad))
            if joints_rad is None:
                continue
            solved = True
            if not self._sweep_collides(near_rad, joints_rad, fingers_m):
                return joints_rad
        raise StationError(
            "out of reach: every way there hits the table or the arm itself"
            if solved
            else "out of reach: no joint positions within the limits bring the gripper there"
        )

    def _inverse_kinematics(
        self, T_world_tcp: Transform, start_rad: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, " n"] | None:
        """Inverse kinematics from one start; None if it does not converge."""
        configuration = self._configuration
        q = self.data.qpos * 0
        q[self._address] = start_rad
        configuration.update(q)
        reach = mink.FrameTask("tcp", "site", position_cost=10.0, orientation_cost=1.0, lm_damping=1e-3)
        reach.set_target(mink.SE3.from_matrix(T_world_tcp))
        for _ in range(_STEPS):
            error = reach.compute_error(configuration)
            if np.linalg.norm(error[:3]) < _NEAR_M and np.linalg.norm(error[3:]) < _NEAR_RAD:
                return np.asarray(np.clip(configuration.q[self._address], self.low_rad, self.high_rad))
            velocity = mink.solve_ik(configuration, [reach], 1.0, "daqp", damping=1e-6, limits=self._limits)
            configuration.integrate_inplace(velocity, 1.0)
        return None

    # --- collisions and shapes --------------------------------------------------------------------------------------

    def collides(self, joints_rad: Float[np.ndarray, " n"], fingers_m: float) -> bool:
        """Whether the arm touches the table or itself (contacts of the fingers are ignored)."""
        self._place(joints_rad, fingers_m)
        for contact in self.data.contact[: self.data.ncon]:
            bodies = {int(self.model.geom_bodyid[geom]) for geom in (contact.geom1, contact.geom2)}
            if not bodies <= {int(self.model.jnt_bodyid[joint]) for joint in self.fingers}:
                return True
        return False

    def _sweep_collides(
        self, start_rad: Float[np.ndarray, " n"], end_rad: Float[np.ndarray, " n"], fingers_m: float
    ) -> bool:
        n = int(np.ceil(np.abs(end_rad - start_rad).max() / _SWEEP_RAD)) + 1
        return any(self.collides(start_rad + t * (end_rad - start_rad), fingers_m) for t in np.linspace(1, 0, n)[:-1])

    def parts(self, joints_rad: Float[np.ndarray, " n"], fingers_m: float) -> list[Part]:
        """All parts in world axes; fixed ones (a table) belong to the body ``world``."""
        self._place(joints_rad, fingers_m)
        return self.posed(self.data)

    def posed(self, data: mujoco.MjData) -> list[Part]:
        """All parts for a state of this model, or of a model derived from it with the same geoms."""
        return [
            replace(shape, T_world_part=se3.transform(data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom]))
            for geom, shape in enumerate(self._shapes)
        ]

    def _place(self, joints_rad: Float[np.ndarray, " n"], fingers_m: float) -> None:
        self.data.qpos[self._address] = joints_rad
        self.data.qpos[self._finger_address] = fingers_m
        mujoco.mj_fwdPosition(self.model, self.data)


def merged(parts: Sequence[Part]) -> trimesh.Trimesh:
    """All parts as one mesh in world axes, with the faces in the order of the parts."""
    vertices = [se3.apply(part.T_world_part, part.mesh.vertices) for part in parts]
    first = np.cumsum([0, *(len(v) for v in vertices)])
    faces = [part.mesh.faces + offset for part, offset in zip(parts, first, strict=False)]
    return trimesh.Trimesh(np.concatenate(vertices), np.concatenate(faces), process=False)


def _part(model: mujoco.MjModel, geom: int) -> Part:
    """A geom as a part in its own frame."""
    body = model.body(model.geom_bodyid[geom]).name
    return Part(body, _mesh(model, geom), np.asarray(model.geom_rgba[geom, :3], float), np.eye(4))


def _mesh(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh:
    mesh: trimesh.Trimesh
    kind, size, types = model.geom_type[geom], model.geom_size[geom], mujoco.mjtGeom
    if kind == types.mjGEOM_BOX:
        mesh = trimesh.creation.box(2 * size)
    elif kind == types.mjGEOM_CAPSULE:
        capsule = trimesh.creation.capsule(2 * size[1], size[0], count=[24, 24])
        mesh = capsule.apply_translation(-capsule.bounds.mean(axis=0))
    elif kind == types.mjGEOM_CYLINDER:
        mesh = trimesh.creation.cylinder(size[0], 2 * size[1], sections=32)
    elif kind == types.mjGEOM_SPHERE:
        mesh = trimesh.creation.icosphere(3, size[0])
    elif kind == types.mjGEOM_MESH:
        index = model.geom_dataid[geom]
        vertices = slice(model.mesh_vertadr[index], model.mesh_vertadr[index] + model.mesh_vertnum[index])
        faces = slice(model.mesh_faceadr[index], model.mesh_faceadr[index] + model.mesh_facenum[index])
        mesh = trimesh.Trimesh(model.mesh_vert[vertices], model.mesh_face[faces], process=False)
    else:
        raise ReorientError(
            f"a geom of body {model.body(model.geom_bodyid[geom]).name!r} is of a kind that cannot be drawn: expected "
            "boxes, capsules, cylinders, spheres or meshes"
        )
    return mesh


def rotated_pose(T_world_tcp: Transform, R_step: Float[np.ndarray, "3 3"], at_m: Float[np.ndarray, "3"]) -> Transform:
    """The pose rotated by R_step from the left (world axes), with its origin at ``at_m``."""
    R = so3.matrix_from_quat(so3.quat_from_matrix(R_step @ T_world_tcp[:3, :3]))  # stays a rotation over many moves
    return se3.transform(R, at_m)


def _numerics(model: mujoco.MjModel) -> set[str]:
    return {model.numeric(index).name for index in range(model.nnumeric)}


def _line(error: Exception) -> str:
    return " ".join(str(error).split())

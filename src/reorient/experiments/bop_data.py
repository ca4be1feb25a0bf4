"""Datasets in the layout of BOP (https://bop.felk.cvut.cz): views of objects, their poses, models and symmetries.

As documented in bop_toolkit's "Format of BOP datasets" (scene-wise): a folder for each scene of a split with
``scene_camera.json``, ``scene_gt.json``, ``depth/`` and ``mask_visib/``; ``models_eval/`` or ``models/`` with
``models_info.json``. Lengths in the files are millimetres.
"""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, QhullError

from reorient import se3, so3
from reorient.errors import ReorientError, reason_of
from reorient.imaging import DepthImage, isolate
from reorient.imaging.documents import read_document
from reorient.imaging.files import read_depth, read_mask
from reorient.imaging.intrinsics import intrinsics_from
from reorient.se3 import Transform
from reorient.world.meshes import load_mesh

LEAST_VISIBLE = 0.1  # share of an object's silhouette; BOP's targets have at least this much
_SPINS = 315  # of a continuous symmetry: bop_toolkit's max_sym_disc_step of 0.01


@dataclass(frozen=True)
class View:
    """One object in one image."""

    folder: Path
    """Of the scene."""
    image: int
    annotation: int
    """Place in the image's list of ``scene_gt.json``, ``gt_id``."""
    obj_id: int

    @property
    def scene(self) -> int:
        """Number of the scene."""
        return int(self.folder.name)

    def pose(self) -> Transform:
        """T_camera_model, (4, 4), metres. Raises ReorientError for a pose that is no rigid transform."""
        with _expected(self.folder / "scene_gt.json", f"cam_R_m2c and cam_t_m2c in image {self.image}"):
            stated = _scene(self.folder, "scene_gt.json")[str(self.image)][self.annotation]
            R = np.array(stated["cam_R_m2c"], float).reshape(3, 3)
            t_m = np.array(stated["cam_t_m2c"], float).reshape(3) / 1000
        if not so3.is_rotation(R, tolerance=1e-2):
            raise ReorientError(f"pose of image {self.image} in {str(self.folder)!r}: expected a rotation")
        return se3.transform(so3.matrix_from_quat(so3.normalize(so3.quat_from_matrix(R))), t_m)  # files are rounded

    def depth(self) -> DepthImage:
        """The object alone, by its ``mask_visib``. Raises ReorientError for missing or broken files."""
        files = [self.folder / "depth" / f"{self.image:06d}{suffix}" for suffix in (".png", ".tif")]
        file = next((file for file in files if file.is_file()), files[0])
        cameras = _scene(self.folder, "scene_camera.json")
        image = read_depth(file, intrinsics_from(cameras.get(str(self.image)), str(self.folder / "scene_camera.json")))
        mask = read_mask(self.folder / "mask_visib" / f"{self.image:06d}_{self.annotation:06d}.png")
        return isolate(image, mask, allow_touching=True)  # the masks are exact: a flat object touches its table


@dataclass(frozen=True, eq=False)
class Model:
    """A model's extent and symmetries. Symmetric poses are ``T @ S``."""

    vertices_m: Float[np.ndarray, "n 3"]
    """Of its convex hull, where every largest distance is found."""
    diameter_m: float
    discrete: Float[np.ndarray, "k 4 4"]
    """Discrete symmetries, the identity first."""
    axes: Float[np.ndarray, "m 3"]
    """Unit axes of continuous symmetries."""
    offsets_m: Float[np.ndarray, "m 3"]
    """A point on each axis."""

    def rotation_error(self, R: Float[np.ndarray, "3 3"], R_true: Float[np.ndarray, "3 3"]) -> float:
        """Least angle, radians, between a camera_model rotation and the true one times any symmetry."""
        left = so3.quat_from_matrix(R_true.T @ R @ np.swapaxes(self.discrete[:, :3, :3], 1, 2))
        # the nearest spin about an axis keeps, of a quaternion, the real part and the part along the axis
        cosines = [np.abs(left[:, 0]), *(np.hypot(left[:, 0], left[:, 1:] @ axis) for axis in self.axes)]
        return float(2 * np.arccos(np.clip(np.max(cosines), 0, 1)))

    def mssd_m(self, T: Transform, T_true: Transform) -> float:
        """Maximum symmetry-aware surface distance (Hodan et al., BOP Challenge 2020), metres."""
        moved = self._placed(T[None])
        return float(np.linalg.norm(self._placed(T_true @ self._symmetries()) - moved, axis=2).max(axis=1).min())

    def _placed(self, T: Float[np.ndarray, "k 4 4"]) -> Float[np.ndarray, "k n 3"]:
        return np.asarray(self.vertices_m @ np.swapaxes(T[:, :3, :3], 1, 2) + T[:, None, :3, 3])

    def _symmetries(self) -> Float[np.ndarray, "k 4 4"]:
        """Discrete and, in small steps, continuous symmetries."""
        if not len(self.axes):
            return self.discrete
        angles = 2 * np.pi * np.arange(_SPINS) / _SPINS
        spins = []
        for axis, offset in zip(self.axes, self.offsets_m, strict=True):
            T = np.tile(np.eye(4), (_SPINS, 1, 1))
            T[:, :3, :3] = so3.exp(angles[:, None] * axis)
            T[:, :3, 3] = offset - T[:, :3, :3] @ offset
            spins.append(T)
        return np.asarray((np.concatenate(spins)[:, None] @ self.discrete).reshape(-1, 4, 4))


def views(dataset: Path, split: str, objects: tuple[int, ...]) -> list[View]:
    """All views of the objects (all objects where none is named) that show at least a tenth of the silhouette.

    Raises ReorientError where the folder is no split in BOP's layout, and for an object without views.
    """
    root = dataset / split
    folders = sorted(path.parent for path in root.glob("*/scene_gt.json") if path.parent.name.isdecimal())
    if not folders:
        found = sorted(path.name for path in dataset.glob("*") if any(path.glob("*/scene_gt.json")))
        raise ReorientError(
            f"no scenes in {str(root)!r}: expected folders with scene_gt.json and scene_camera.json, as BOP has them"
            + (f" (--split {' or '.join(found)})" if found else "")
        )
    every = [view for folder in folders for view in _views_of_scene(folder)]
    known = {view.obj_id for view in every}
    if missing := sorted(set(objects) - known):
        raise ReorientError(f"no views of object {missing[0]} in {str(root)!r}: expected some of {sorted(known)}")
    return [view for view in every if not objects or view.obj_id in objects]


def _views_of_scene(folder: Path) -> list[View]:
    annotations = _scene(folder, "scene_gt.json")
    visible = _scene(folder, "scene_gt_info.json") if (folder / "scene_gt_info.json").is_file() else {}
    found = []
    with _expected(folder / "scene_gt.json", "obj_id of each instance, as many as scene_gt_info.json has, by image"):
        for image, instances in annotations.items():
            shares = [info.get("visib_fract", 1.0) for info in visible.get(image, [])] or [1.0] * len(instances)
            for place, (instance, share) in enumerate(zip(instances, shares, strict=True)):
                if share >= LEAST_VISIBLE:
                    found.append(View(folder, int(image), place, int(instance["obj_id"])))
    return found


@contextmanager
def _expected(file: Path, contents: str) -> Iterator[None]:
    """Report what is missing or wrong in the contents of a file as a ReorientError."""
    try:
        yield
    except ReorientError:
        raise
    except Exception as error:
        raise ReorientError(
            f"{str(file)!r} is not in BOP's layout ({reason_of(error)}): expected {contents}"
        ) from error


@lru_cache(maxsize=64)
def _scene(folder: Path, name: str) -> Any:
    document = read_document(folder / name) if (folder / name).is_file() else None
    if not isinstance(document, dict):
        raise ReorientError(f"no {name} in {str(folder)!r}: expected a scene in BOP's layout")
    return document


@lru_cache(maxsize=64)
def load_model(dataset: Path, obj_id: int) -> Model:
    """The model of an object. Raises ReorientError for a missing or broken one."""
    folder = next(
        (dataset / name for name in ("models_eval", "models") if (dataset / name).is_dir()), dataset / "models"
    )
    info = _scene(folder, "models_info.json").get(str(obj_id))
    if info is None:
        raise ReorientError(f"no object {obj_id} in {str(folder / 'models_info.json')!r}: expected its diameter")
    vertices_m = np.asarray(load_mesh(folder / f"obj_{obj_id:06d}.ply").vertices, float) / 1000
    with suppress(QhullError):  # a flat model has no hull
        vertices_m = vertices_m[ConvexHull(vertices_m).vertices]
    with _expected(folder / "models_info.json", f"diameter and symmetries of object {obj_id}"):
        discrete = np.array([np.eye(4).ravel(), *info.get("symmetries_discrete", [])], float).reshape(-1, 4, 4)
        discrete[:, :3, 3] /= 1000
        continuous = info.get("symmetries_continuous", [])
        axes = np.array([one["axis"] for one in continuous], float).reshape(-1, 3)
        offsets_m = np.array([one.get("offset", [0, 0, 0]) for one in continuous], float).reshape(-1, 3) / 1000
        axes /= np.linalg.norm(axes, axis=1, keepdims=True)
        return Model(vertices_m, float(info["diameter"]) / 1000, discrete, axes, offsets_m)

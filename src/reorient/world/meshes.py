"""Meshes: load, check, centre and scale. A mesh is a ``trimesh.Trimesh``; lengths are metres once scaled."""

import io
import os
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Float

from reorient.errors import ReorientError, in_short, reason_of

Mesh = trimesh.Trimesh
MOST_VERTICES = 500  # vertices of an object kept for ShapeMatch (paper, "Training Details")


def load_mesh(path: str | Path) -> trimesh.Trimesh:
    """A surface from a file: .npz with ``v`` (n, 3) and ``f`` (m, 3), or any format that trimesh loads.

    Lengths are in the unit of the file. Raises ReorientError for a missing, broken or truncated file, and for a mesh
    that is no surface.
    """
    path = Path(path)
    if not os.path.isfile(path):
        raise ReorientError(f"no mesh file {str(path)!r}: expected an existing .stl, .obj, .ply, .dae, .npz, ... file")
    mesh: object
    try:
        if path.suffix.lower() == ".npz":
            with np.load(path) as arrays:
                mesh = trimesh.Trimesh(arrays["v"].astype(float), arrays["f"].astype(int), process=False)
        else:
            mesh = _loaded(path)
            _require_complete(path, len(getattr(mesh, "faces", ())))
    except ReorientError:
        raise
    except ImportError as error:
        raise ReorientError(
            f"cannot read mesh {str(path)!r} ({in_short(error)}): expected that package, which trimesh needs for "
            f"{path.suffix.lower()} files, or another format"
        ) from error
    except Exception as error:  # the loaders of a dozen formats raise many kinds of errors
        raise ReorientError(
            f"cannot read mesh {str(path)!r} ({reason_of(error)}): expected a complete file that trimesh "
            "loads, or .npz with v (n, 3) and f (m, 3)"
        ) from error
    return check_surface(mesh, str(path))


def _loaded(path: Path) -> object:
    """What trimesh loads. Text with comments in Latin-1 goes to it in UTF-8, or it asks for a further package."""
    data, suffix = path.read_bytes(), path.suffix.lower()
    if suffix == ".obj" or (suffix == ".stl" and data[:5] == b"solid" and b"facet" in data[:1000]):
        try:
            data.decode()
        except UnicodeDecodeError:
            text = io.BytesIO(data.decode("latin-1").encode())
            return trimesh.load(text, file_type="stl_ascii" if suffix == ".stl" else "obj", force="mesh", process=False)
    return trimesh.load(path, force="mesh", process=False)


def _require_complete(path: Path, loaded: int) -> None:
    """Raise ValueError for truncated text files of which trimesh silently loads the rest; ``loaded``: faces it found.

    .off and .ply state their number of rows; in .obj only an incomplete last line is detectable.
    """
    if path.suffix.lower() == ".off":
        bare = "\n".join(line.partition("#")[0] for line in path.read_text("utf-8", "replace").splitlines())
        lines = [words for line in bare.partition("OFF")[2].splitlines() if (words := line.split())]
        vertices, faces = int(lines[0][0]), int(lines[0][1])
        whole = sum(len(face) > int(face[0]) for face in lines[1 + vertices : 1 + vertices + faces])
        if whole < faces:
            raise ValueError(f"{whole} of {faces} faces")
    if path.suffix.lower() == ".ply":
        header, _, body = path.read_bytes().partition(b"end_header")
        stated = dict(line.split()[1:3] for line in header.splitlines() if line.startswith(b"element"))
        rows = sum(map(int, stated.values()))
        missing = len(body.split(b"\n")) <= rows or loaded < int(
            stated.get(b"face", 0)
        )  # the first line ends the header
        if b"format ascii" in header and missing:
            raise ValueError(f"fewer than {rows} whole lines")
    if path.suffix.lower() == ".obj":
        last = path.read_bytes().rpartition(b"\n")[2].split()
        if last and last[0] in (b"v", b"vn", b"f") and len(last) < 4:
            raise ValueError("the last line ends early")


def check_surface(mesh: object, name: str = "mesh") -> trimesh.Trimesh:
    """The mesh itself. Raises ReorientError for no faces, wrong shapes or indices, NaN, and zero area."""
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
        raise ReorientError(f"{name!r} has no faces: expected a triangle mesh, not points or curves")
    if mesh.vertices.shape[1:] != (3,) or mesh.faces.shape[1:] != (3,):
        raise ReorientError(
            f"{name!r} has vertices of shape {mesh.vertices.shape} and faces of shape {mesh.faces.shape}: "
            "expected (n, 3) and (m, 3)"
        )
    if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
        raise ReorientError(
            f"{name!r} has faces that name missing vertices: expected indices below {len(mesh.vertices)}"
        )
    if not np.all(np.isfinite(mesh.vertices)):
        raise ReorientError(f"{name!r} has NaN or infinite vertices: expected finite coordinates")
    if not mesh.area > 1e-12 * mesh.scale**2:
        raise ReorientError(f"{name!r} has no area: expected a surface, all its triangles are degenerate")
    return mesh


def center(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """A copy whose bounding box is centred on the origin, without vertices that no face uses."""
    used, faces = np.unique(mesh.faces, return_inverse=True)
    vertices = np.asarray(mesh.vertices, float)[used]
    vertices = vertices - (vertices.max(axis=0) + vertices.min(axis=0)) / 2
    return trimesh.Trimesh(vertices, faces.reshape(-1, 3), process=False, metadata=dict(mesh.metadata))


def bounding_radius(mesh: trimesh.Trimesh) -> float:
    """Largest distance of a vertex from the origin."""
    return float(np.linalg.norm(mesh.vertices, axis=1).max())


def scale_to_radius(mesh: trimesh.Trimesh, radius_m: float) -> trimesh.Trimesh:
    """A centred copy with this bounding radius around the origin."""
    centred = center(mesh)
    centred.apply_scale(radius_m / bounding_radius(centred))
    return centred


def scale_to_diagonal(mesh: trimesh.Trimesh, diagonal_m: float) -> trimesh.Trimesh:
    """A centred copy whose bounding box has this diagonal."""
    centred = center(mesh)
    centred.apply_scale(diagonal_m / float(np.linalg.norm(np.ptp(centred.vertices, axis=0))))
    return centred


def some_vertices(mesh: trimesh.Trimesh, rng: np.random.Generator) -> Float[np.ndarray, "n 3"]:
    """At most 500 distinct vertices of the centred mesh, drawn at random, over the bounding radius."""
    mesh = center(mesh)
    vertices = np.unique(mesh.vertices, axis=0)
    if len(vertices) > MOST_VERTICES:
        vertices = rng.permutation(vertices)[:MOST_VERTICES]
    return vertices / bounding_radius(mesh)

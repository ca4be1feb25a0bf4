"""Meshes: what loads, what is refused and why, centring and scaling."""

import numpy as np
import pytest
import trimesh

from reorient.errors import ReorientError
from reorient.world.meshes import bounding_radius, center, check_surface, load_mesh, scale_to_diagonal, scale_to_radius


def save(mesh, path):
    if path.suffix == ".npz":
        np.savez(path, v=mesh.vertices, f=mesh.faces)
    else:
        mesh.export(path)
    return path


@pytest.mark.parametrize("suffix", [".npz", ".stl", ".obj", ".ply", ".STL"])
def test_formats_load_with_the_same_surface(suffix, mesh, tmp_path):
    loaded = load_mesh(save(mesh, tmp_path / f"part{suffix}"))
    assert loaded.triangles.shape == mesh.triangles.shape
    assert loaded.area == pytest.approx(mesh.area, rel=1e-5)
    assert loaded.volume == pytest.approx(mesh.volume, rel=1e-5)
    assert np.allclose(loaded.bounds, mesh.bounds, atol=1e-6)


def test_vertices_keep_their_order(mesh, tmp_path):
    loaded = load_mesh(save(mesh, tmp_path / "part.npz"))
    assert np.array_equal(loaded.vertices, mesh.vertices)
    assert np.array_equal(loaded.faces, mesh.faces)


# --- refusals -------------------------------------------------------------------------------------------------------


def test_missing_files_are_refused(tmp_path):
    for path in (tmp_path / "nowhere.stl", tmp_path):
        with pytest.raises(ReorientError, match=r"no mesh file .* expected an existing"):
            load_mesh(path)


@pytest.mark.parametrize("suffix", [".npz", ".stl", ".ply"])
@pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
def test_truncated_files_are_refused(suffix, share, mesh, tmp_path):
    path = save(mesh, tmp_path / f"part{suffix}")
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(ReorientError, match=r"(cannot read mesh|has no faces).* expected ") as caught:
        load_mesh(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("suffix", [".off", ".obj", ".ply"])
def test_text_that_was_cut_off_is_refused_where_it_shows(suffix, mesh, tmp_path):
    """Lines that are missing do not show in .obj, which does not state their number."""
    path = tmp_path / f"part{suffix}"
    mesh.export(path, **({"encoding": "ascii"} if suffix == ".ply" else {}))
    whole = path.read_text().rstrip()
    for text in (whole, f"{whole}\n\n") if suffix == ".ply" else (whole, f"# OFF by hand\n{whole}\n\n"):
        path.write_text(text)
        assert len(load_mesh(path).faces) == len(mesh.faces)
    short = [whole[: whole.rindex(" ")], whole[: whole.rindex("\n") + 2]]
    for text in short + [whole[: whole.rindex("\n") + 1]] * (suffix != ".obj"):
        path.write_text(text)
        with pytest.raises(ReorientError, match="cannot read mesh .*expected a complete file"):
            load_mesh(path)


@pytest.mark.parametrize("header", ["OFF\n4 1 0", "OFF 4 1 0", "COFF\n# four\n4 1 4"])
def test_headers_of_off_files(header, tmp_path):
    (tmp_path / "square.off").write_text(f"{header}\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3 255 0 0")
    assert len(load_mesh(tmp_path / "square.off").faces) == 2


@pytest.mark.parametrize(
    ("name", "text"), [("part.obj", ""), ("part.obj", "v 0 0 0\nf 1 2 3\n"), ("part.xyzzy", "?"), ("part.npz", "?")]
)
def test_files_without_a_mesh_are_refused(name, text, tmp_path):
    (tmp_path / name).write_text(text)
    with pytest.raises(ReorientError, match=f"{name}'.* expected"):
        load_mesh(tmp_path / name)


def test_archives_that_hold_something_else_are_refused(tmp_path):
    np.savez(tmp_path / "image.npz", depth_m=np.zeros((3, 3)))
    with pytest.raises(ReorientError, match="cannot read mesh"):
        load_mesh(tmp_path / "image.npz")


def test_points_are_no_surface(tmp_path, rng):
    trimesh.PointCloud(rng.random((20, 3))).export(tmp_path / "cloud.ply")
    with pytest.raises(ReorientError, match="has no faces: expected a triangle mesh, not points or curves"):
        load_mesh(tmp_path / "cloud.ply")


TRIANGLE = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        (TRIANGLE, np.zeros((0, 3)), "has no faces"),
        (np.zeros((0, 3)), np.zeros((0, 3)), "has no faces"),
        (TRIANGLE, [[0, 1, 3]], "faces that name missing vertices: expected indices below 3"),
        (TRIANGLE, [[0, 1, -1]], "faces that name missing vertices: expected indices below 3"),
        (np.where(TRIANGLE == 1, np.nan, TRIANGLE), [[0, 1, 2]], "NaN or infinite vertices: expected finite"),
        (np.where(TRIANGLE == 1, np.inf, TRIANGLE), [[0, 1, 2]], "NaN or infinite vertices: expected finite"),
        (TRIANGLE, [[0, 1, 1]], "has no area: expected a surface"),
        (TRIANGLE * (1, 0, 0), [[0, 1, 2]], "has no area: expected a surface"),
        (TRIANGLE * 0, [[0, 1, 2]], "has no area: expected a surface"),
        (TRIANGLE[:, :2], [[0, 1, 2]], r"vertices of shape \(3, 2\) .* expected \(n, 3\) and \(m, 3\)"),
        (TRIANGLE.ravel(), [[0, 1, 2]], r"vertices of shape \(9,\) .* expected \(n, 3\) and \(m, 3\)"),
        (TRIANGLE, [0, 1, 2], r"faces of shape \(3,\): expected \(n, 3\) and \(m, 3\)"),
    ],
)
def test_what_is_no_surface_is_refused(vertices, faces, message, tmp_path):
    np.savez(tmp_path / "part.npz", v=vertices, f=np.asarray(faces, int))
    with pytest.raises(ReorientError, match=message):
        load_mesh(tmp_path / "part.npz")


def test_other_objects_are_no_surface():
    with pytest.raises(ReorientError, match="'thing' has no faces"):
        check_surface(TRIANGLE, "thing")


def test_a_flat_or_small_mesh_is_a_surface():
    for factor in (1e-6, 1.0, 1e6):
        mesh = trimesh.Trimesh(TRIANGLE * factor, [[0, 1, 2]], process=False)
        assert check_surface(mesh) is mesh


# --- centre and size ------------------------------------------------------------------------------------------------


def test_center_moves_the_middle_of_the_box_to_the_origin(mesh):
    far = mesh.copy().apply_translation((3, -2, 7))
    centred = center(far)
    assert np.allclose(centred.bounds.sum(axis=0), 0, atol=1e-12)
    assert np.allclose(centred.triangles - far.triangles, centred.triangles[0, 0] - far.triangles[0, 0])
    assert np.allclose(far.vertices, np.add(mesh.vertices, (3, -2, 7)))  # untouched


def test_center_drops_vertices_that_no_face_uses(mesh):
    stray = trimesh.Trimesh(np.vstack([[[99.0, 99, 99]], mesh.vertices]), mesh.faces + 1, process=False)
    assert len(center(stray).vertices) == len(np.unique(mesh.faces))
    assert np.allclose(center(stray).triangles, center(mesh).triangles)


@pytest.mark.parametrize("unit", [0.001, 1.0, 25.4])
def test_scaling_forgets_the_unit_and_keeps_the_shape(unit, mesh):
    other = mesh.copy().apply_scale(unit).apply_translation((1, 2, 3))
    by_radius, by_diagonal = scale_to_radius(other, 0.1), scale_to_diagonal(other, 0.25)
    assert bounding_radius(by_radius) == pytest.approx(0.1)
    assert np.linalg.norm(by_diagonal.extents) == pytest.approx(0.25)
    for scaled in (by_radius, by_diagonal):
        assert np.allclose(scaled.bounds.sum(axis=0), 0, atol=1e-12)
        assert np.allclose(scaled.extents / scaled.extents[0], mesh.extents / mesh.extents[0])
    assert np.allclose(by_radius.vertices, scale_to_radius(mesh, 0.1).vertices)


def test_the_name_of_an_object_survives(mesh):
    named = mesh.copy()
    named.metadata["name"] = "corner"
    assert scale_to_radius(named, 0.1).metadata["name"] == "corner"

"""Sets of objects from every source."""

import numpy as np
import pytest

from reorient.errors import ReorientError
from reorient.world.objects import ObjectSource, folder, generated, package, split


def test_generated():
    objects = generated(5, seed=2)
    assert len(set(objects.names)) == 5
    np.testing.assert_array_equal(
        objects.load(objects.names[3]).vertices, generated(9, 2).load(objects.names[3]).vertices
    )


def test_folder(tmp_path, mesh):
    (tmp_path / "deep").mkdir()
    mesh.export(tmp_path / "deep" / "a.stl")
    np.savez(tmp_path / "b.npz", v=mesh.vertices, f=mesh.faces)
    (tmp_path / "notes.txt").write_text("not a mesh")
    objects = folder(tmp_path)
    assert objects.names == ("b", "deep/a")
    assert all(len(objects.load(name).faces) == len(mesh.faces) for name in objects.names)


def test_pybullet_package(tmp_path, mesh, monkeypatch):
    """Its data lie in a module of another name; a stand-in with the same layout is found like it."""
    module = tmp_path / "pybullet_data"
    (module / "random_urdfs" / "000").mkdir(parents=True)
    (module / "__init__.py").touch()
    mesh.export(module / "random_urdfs" / "000" / "000.obj")
    monkeypatch.syspath_prepend(tmp_path)
    assert package("pybullet").names == ("000/000",)


def test_splits_are_disjoint_whole_and_stable():
    names = [f"object-{i}" for i in range(872)]
    parts = split(names)
    assert (len(parts.train), len(parts.validation), len(parts.test)) == (628, 70, 174)
    assert sorted(parts.train + parts.validation + parts.test) == list(range(872))
    shuffled = list(reversed(names))
    assert {shuffled[i] for i in split(shuffled).test} == {names[i] for i in parts.test}
    assert len(split(names[:100], 81).test) == 81


def test_a_split_with_an_empty_part_is_refused():
    with pytest.raises(ReorientError, match=r"3 objects, 2 for testing: expected some for training, validation and"):
        split(["a", "b", "c"], 2)


def test_refusals(tmp_path):
    with pytest.raises(ReorientError, match="no folder .* expected a folder"):
        folder(tmp_path / "none")
    with pytest.raises(ReorientError, match="no meshes in"):
        folder(tmp_path)
    with pytest.raises(ReorientError, match="unknown mesh package 'rtbdata': .*did you mean 'rtb-data'"):
        package("rtbdata")
    with pytest.raises(ReorientError, match="expected at least 1"):
        generated(0)
    with pytest.raises(ReorientError, match="unknown object 'x'"):
        generated(3).only(["x"])


def test_names_with_spaces_and_like_stems(tmp_path, mesh):
    mesh.export(tmp_path / "my part.stl")
    mesh.export(tmp_path / "my part.ply")
    objects = folder(tmp_path)
    assert len(objects.names) == 2
    assert "my part" in objects.names
    (tmp_path / "only.txt").write_text("my part\n\n")
    assert ObjectSource(meshes=tmp_path, only=tmp_path / "only.txt").open().names == ("my part",)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (None, "expected object names, one a line"),
        (b"\n \n", "expected object names, one a line"),
        (b"\xff\xfe", "unknown object"),
    ],
)
def test_lists_of_names_that_name_nothing(content, said, tmp_path):
    if content is not None:
        (tmp_path / "only.txt").write_bytes(content)
    with pytest.raises(ReorientError, match=said):
        ObjectSource(only=tmp_path / "only.txt").open()

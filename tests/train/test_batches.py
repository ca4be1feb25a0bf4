"""Splits by object; labels that follow their images through the virtual camera, the mirror and the rotated start."""

import numpy as np
import pytest

from reorient import so3
from reorient.imaging.virtual_camera import rotated
from reorient.learning.batches import Augmentation, Batches, prepare
from reorient.learning.pair_reader import PairReader


def depth_of(images):
    """Network input back to relative depth, in widths of the view; nearer is larger."""
    return np.where(images > 0, 10 - images, 0).astype(np.float32)


@pytest.mark.parametrize("augmentation", [None, Augmentation(), Augmentation(rotated=1.0), Augmentation(noise=0.005)])
def test_labels_rotate_the_start_into_the_goal(small_set, augmentation):
    """The start, rotated by its label, covers the goal better than rotated by the inverse or not at all."""
    reader = PairReader(small_set)
    batch = reader.read(np.arange(48))
    rng = None if augmentation is None else np.random.default_rng(3)
    images, quat_wxyz, _ = prepare(batch, reader, rng, augmentation or Augmentation())
    R = so3.matrix_from_quat(quat_wxyz)
    far = so3.angle(R) > np.radians(5)
    assert far.sum() > 10
    depth = depth_of(images[far])
    tangent = np.full(len(depth), 1 / 18)  # depths are in widths of the view, 9 of them away
    middle = np.array([0.0, 0.0, 9.0])[None].repeat(len(depth), 0)

    def misfit(R):
        seen = rotated(depth[:, 0], tangent, R, middle, middle)
        return np.mean((seen > 0) != (depth[:, 1] > 0), axis=(1, 2))

    stays, by_label, by_inverse = (misfit(x) for x in (np.eye(3)[None] + 0 * R[far], R[far], np.swapaxes(R[far], 1, 2)))
    assert by_label.mean() < stays.mean() < by_inverse.mean()


def elongation(points):
    """Which way a flat cloud is long: (cos, sin) of twice the angle."""
    (xx, xy), (_, yy) = np.cov(points.T)
    return np.array([(xx - yy) / 2, xy]) / np.hypot((xx - yy) / 2, xy)


def test_vertices_are_posed_as_the_start_shows_them(small_set):
    """Where the start image is long, so are the posed vertices, mirrored or not; not so by the inverse pose."""
    reader = PairReader(small_set)
    images, _, pose = prepare(reader.read(np.arange(48)), reader, np.random.default_rng(0))
    assert 10 < np.sum(np.linalg.det(pose) < 0) < 38
    right, wrong = [], []
    for k in range(48):
        x = reader.vertices[k // 6][: reader.vertex_count[k // 6]]
        rows, columns = np.nonzero(images[k, 0])
        seen = elongation(np.stack([columns, rows], axis=1))
        right.append(seen @ elongation((x @ pose[k].T)[:, :2]))
        wrong.append(seen @ elongation((x @ pose[k])[:, :2]))
    assert np.mean(right) > 0.75
    assert np.mean(wrong) < 0.4


def test_batches_are_the_same_from_any_of_them_on(small_set):
    reader = PairReader(small_set)
    whole = list(Batches(reader, range(8), 8, (0, 1), augmentation=Augmentation(rotated=0.5)))
    late = list(Batches(reader, range(8), 8, (0, 1), first=4, augmentation=Augmentation(rotated=0.5)))
    assert len(whole) == 6
    for a, b in zip(whole[4:], late, strict=True):
        assert all((a[key] == b[key]).all() for key in a)


def test_processes_share_out_each_step(small_set):
    reader = PairReader(small_set)
    alone = next(iter(Batches(reader, range(8), 8, (0, 1))))
    two = [next(iter(Batches(reader, range(8), 4, (0, 1), process=(rank, 2)))) for rank in (0, 1)]
    joined = np.concatenate([part["images"] for part in two])
    assert (alone["images"].numpy() == joined).all()

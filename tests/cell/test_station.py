import numpy as np
import pytest

from reorient import Algorithm1, Station, load_estimator, orient, se3, so3
from reorient.errors import ReorientError, StationError
from reorient.perception.calibration import Calibration
from reorient.perception.colour import ColourRange
from reorient.perception.segmentation import object_mask
from reorient.stations.cell import SimulatedCell
from reorient.stations.cell.station import CellConfig

from .conftest import holding

ROTATION = so3.exp(np.radians([6.0, -8.0, 5.0]))  # camera axes


def truly(cell):
    """The object's true orientation in the true camera's axes."""
    return cell.plant.depth.T_world_camera[:3, :3].T @ cell.plant.R_world_object


def test_it_is_a_station(cell):
    assert isinstance(cell, Station)
    image = cell.capture()
    assert image.depth_m.shape == (128, 128)
    assert image.stamp_s is not None
    assert image.stamp_s > 0


def test_without_errors_it_rotates_as_commanded_on_the_left_in_camera_axes(perfect):
    before = truly(perfect)
    R_executed = perfect.rotate(ROTATION)
    done = truly(perfect) @ before.T
    assert so3.angle_difference(done, ROTATION) < np.radians(0.2)  # the servos sag
    assert so3.angle_difference(done, R_executed) < np.radians(0.02)


def test_it_reports_what_was_done_by_encoders(cell):
    before = truly(cell)
    R_executed = cell.rotate(ROTATION)
    done = truly(cell) @ before.T
    assert 0 < so3.angle_difference(done, R_executed) < np.radians(0.3)
    assert so3.angle_difference(done, ROTATION) < np.radians(0.4)


def test_the_pivot_stays_and_is_where_the_object_rotates(cell):
    true_m = se3.apply(cell.plant.depth.T_camera_world, cell.plant.tool_m)
    assert np.linalg.norm(cell.pivot_m - true_m) < 0.01
    cell.rotate(ROTATION)
    assert np.linalg.norm(cell.pivot_m - true_m) < 0.01


def test_it_moves_the_object_in_camera_axes_and_rotates_it_where_it_is_then(perfect):
    shift_m = np.array([0.01, -0.02, 0.015])
    before_m = perfect.pivot_m
    executed = perfect.move(se3.transform(np.eye(3), shift_m))
    assert np.linalg.norm(perfect.pivot_m - before_m - shift_m) < 0.003  # the servos sag
    assert np.linalg.norm(executed[:3, 3] + executed[:3, :3] @ before_m - perfect.pivot_m) < 0.001
    perfect.rotate(ROTATION)
    assert np.linalg.norm(perfect.pivot_m - before_m - shift_m) < 0.003
    with pytest.raises(StationError, match="out of reach"):
        perfect.move(se3.transform(np.eye(3), np.array([2.0, 0.0, 0.0])))


def test_out_of_reach_is_refused_before_anything_moves(cell):
    axes = so3.sample_axes(np.random.default_rng(0), 40)
    refused = [R for R in so3.exp(3.1 * axes) if not cell.reachable(R)]
    assert refused  # no arm reaches every rotation
    before = cell.plant.R_world_object
    with pytest.raises(StationError, match="out of reach"):
        cell.rotate(refused[0])
    with pytest.raises(StationError, match=r"expected a \(3, 3\) rotation matrix"):
        cell.rotate(2 * np.eye(3))
    np.testing.assert_array_equal(cell.plant.R_world_object, before)
    assert cell.reachable(ROTATION)


def test_masks_agree_with_the_pixels_whose_ray_hits_the_object(cell):
    frame = cell.frame(colour=True)
    truth = cell.plant.shows_object()
    for name, segmentation in cell.segmentations.items():
        mask = object_mask(frame, cell.calibration, segmentation)
        for where, least in ((frame.depth.valid, 0.95), (np.ones_like(mask), 0.9)):
            assert (mask & truth & where).sum() / ((mask | truth) & where).sum() > least, name


def test_an_object_is_placed_where_camera_and_projector_see_it(cell):
    assert cell.plant.is_visible(cell.plant.read(), 0.65)  # placed at 0.7, then servos sag
    assert not cell.plant.is_visible(cell.plant.read(), 1.5)


def test_capturing_and_rotating_never_read_the_truth(cell, monkeypatch):
    def forbidden(*_):
        raise AssertionError("the truth was read")

    for name in ("R_world_object", "shows_object", "is_visible"):
        monkeypatch.setattr(type(cell.plant), name, property(forbidden))
    cell.capture()
    cell.rotate(ROTATION)
    assert cell.pivot_m.shape == (3,)
    assert not any(np.array_equal(cell.calibration.depth.T_world_camera, m.T_world_camera) for m in (cell.plant.depth,))


@pytest.mark.parametrize("segmentation", ["shape", "colour"])
def test_the_loop_closes(mesh, segmentation):
    cell = holding(mesh, seed=1, segmentation=segmentation)
    goal, R_goal = cell.capture(), cell.plant.R_world_object
    axes = so3.sample_axes(np.random.default_rng(2), 50)
    cell.rotate(next(R for R in so3.exp(np.radians(30) * axes) if cell.reachable(R)))
    assert so3.angle_difference(cell.plant.R_world_object, R_goal) > np.radians(29)
    result = orient(cell, goal, load_estimator("gicp"), Algorithm1(max_images=8, eta=1.0))
    assert so3.angle_difference(cell.plant.R_world_object, R_goal) < np.radians(1.5), result.reason
    assert result.converged, result.reason


def test_frames_are_newer_than_the_move_before_them(mesh):
    cell = holding(mesh, seed=4)
    first, second = cell.frame(colour=False).depth.stamp_s, cell.frame(colour=False).depth.stamp_s
    assert first < second
    cell.rotate(np.eye(3))
    moved_s = cell.clock_s()
    assert second <= moved_s < cell.frame(colour=False).depth.stamp_s


def test_the_same_seed_makes_the_same_cell(mesh):
    one, two = holding(mesh, seed=3), holding(mesh, seed=3)
    np.testing.assert_array_equal(one.capture().depth_m, two.capture().depth_m)


def test_what_cannot_be_is_refused(mesh, rng):
    with pytest.raises(ReorientError, match="did you mean 'colour'"):
        CellConfig(segmentation="color")
    cell = SimulatedCell(rng)
    with pytest.raises(ReorientError, match="the gripper is empty"):
        cell.plant.R_world_object  # noqa: B018
    with pytest.raises(ReorientError, match="expected 'color' in the calibration"):
        SimulatedCell(rng, CellConfig(segmentation="colour", calibration=Calibration(cell.plant.depth)))
    with pytest.raises(ReorientError, match="the segmentation leaves nothing"):
        holding(mesh, segmentation="colour", gripper_colour=ColourRange()).capture()

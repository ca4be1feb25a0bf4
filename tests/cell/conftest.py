"""One cell for all tests that only look at it; moving ones make their own."""

import numpy as np
import pytest

from reorient.stations.cell import CellConfig, PlantConfig, SimulatedCell
from reorient.stations.cell.arm import Arm
from reorient.stations.cell.drive import Errors


@pytest.fixture(scope="session")
def arm():
    return Arm()


def holding(mesh, seed=0, **config):
    cell = SimulatedCell(np.random.default_rng(seed), CellConfig(**config))
    cell.plant.hold(mesh)
    return cell


@pytest.fixture
def cell(mesh):
    """The usual cell, holding the corner of three arms."""
    return holding(mesh)


@pytest.fixture
def perfect(mesh):
    """A cell without any error."""
    plant = PlantConfig(noise_m=0.0, errors=Errors(0.0, 0.0, 0.0))
    return holding(mesh, plant=plant, calibration_error_m=0.0, calibration_error_rad=0.0)

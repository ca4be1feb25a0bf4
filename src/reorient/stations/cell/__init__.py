"""A simulated robot cell: a YuMi arm moved by MuJoCo, and cameras by the package's ray caster (extra ``cell``)."""

from reorient.stations.cell.plant import PlantConfig
from reorient.stations.cell.station import CellConfig, SimulatedCell

__all__ = ["CellConfig", "PlantConfig", "SimulatedCell"]

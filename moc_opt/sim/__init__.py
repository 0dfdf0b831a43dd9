"""The simulated plant: arm, trocar, sensors. Knows torques, and nothing of controllers or solvers."""

from moc_opt.sim.mismatch import Mismatch
from moc_opt.sim.plant import Plant
from moc_opt.sim.sensors import Measurement, ToolLoad
from moc_opt.sim.settings import PlantSettings

__all__ = ["Measurement", "Mismatch", "Plant", "PlantSettings", "ToolLoad"]

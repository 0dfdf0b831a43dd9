"""The simulated plant (``plant``) and the closed loop (``loop``). docs/plant.md explains the settings."""

from moc_opt.sim.plant import Plant
from moc_opt.sim.sensors import Measurement
from moc_opt.sim.settings import Mismatch, PlantSettings

__all__ = ["Measurement", "Mismatch", "Plant", "PlantSettings"]

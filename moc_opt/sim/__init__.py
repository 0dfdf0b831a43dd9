"""The simulated plant and the closed loop: arm, trocar, sensors, faults. The package has no solver and no control law.

Read first: ``loop`` (the closed loop of plant, sensors, safety filter and controller), with ``protocols`` (interfaces
of controllers) and ``record`` (one row per tick). Then read ``plant`` (MuJoCo) with ``joints`` and ``sensors``.
``mjcf`` builds the MuJoCo model, and compares it with the controller's arm. ``faults`` disturb the plant.
docs/plant.md explains ``settings``.
"""

from moc_opt.sim.plant import Plant
from moc_opt.sim.sensors import Measurement
from moc_opt.sim.settings import Mismatch, PlantSettings

__all__ = ["Measurement", "Mismatch", "Plant", "PlantSettings"]

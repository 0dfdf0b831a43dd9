"""The simulated plant and the closed loop: arm, trocar, sensors, faults. It knows no solver and no control law.

Read first: ``loop`` (the one closed loop: plant, sensors, safety filter, controller), with ``protocols`` (interfaces
of its parts) and ``record`` (its rows); then ``plant`` (MuJoCo), built by ``mjcf``. ``joints`` and ``sensors`` are the
plant's parts, ``faults`` disturb it, ``mjcf`` also compares it with the controller's arm; docs/plant.md explains
``settings``.
"""

from moc_opt.sim.plant import Plant
from moc_opt.sim.sensors import Measurement
from moc_opt.sim.settings import Mismatch, PlantSettings

__all__ = ["Measurement", "Mismatch", "Plant", "PlantSettings"]

"""The simulated plant and the closed loop: arm, trocar, sensors, faults. Imports no controller and no solver.

Read first: ``closed_loop`` (the one tick of every closed loop) and ``loop`` (``simulate``, which records), then
``plant`` (MuJoCo), built by ``mjcf``. ``protocols`` defines a controller. ``joints`` and ``sensors`` are the plant's
parts; ``faults`` disturb it; docs/plant.md lists ``settings``. Imported by realtime, vision and scenario.
"""

from moc_opt.sim.plant import Plant
from moc_opt.sim.sensors import Measurement
from moc_opt.sim.settings import Mismatch, PlantSettings

__all__ = ["Measurement", "Mismatch", "Plant", "PlantSettings"]

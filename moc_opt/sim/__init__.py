"""The simulated plant and the closed loop: arm, trocar, sensors, faults. Knows torques; no controller and no solver.

Read first: ``loop`` (``simulate``) and ``safe`` (controller and guard as every closed loop calls them:
protocols), then ``plant`` (MuJoCo), built by ``mjcf``. ``contact``, ``sensors``, ``actuation``, ``elastic``
and ``mismatch`` are its parts; ``faults`` and ``packets`` disturb it; docs/plant.md lists ``settings``.
Imported by procedure, vision and scenario.
"""

from moc_opt.sim.mismatch import Mismatch
from moc_opt.sim.plant import Plant
from moc_opt.sim.sensors import Measurement, ToolLoad
from moc_opt.sim.settings import PlantSettings

__all__ = ["Measurement", "Mismatch", "Plant", "PlantSettings", "ToolLoad"]

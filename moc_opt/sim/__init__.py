"""The simulated plant and the closed loop: arm, trocar, sensors, faults. Imports no controller and no solver.

Read first: ``closed_loop`` (the one step of every closed loop), ``filtered`` (controller behind its safety filter) and
``loop`` (``simulate``, which records), then ``plant`` (MuJoCo), built by ``mjcf``, and ``period``, its compiled step.
``protocols`` defines a controller. ``contact``, ``sensors``, ``actuation``, ``elastic``
and ``mismatch`` are its parts; ``faults`` and ``packets`` disturb it; docs/plant.md lists ``settings``.
Imported by realtime, procedure, vision, scenario and commissioning.
"""

from moc_opt.sim.mismatch import Mismatch
from moc_opt.sim.plant import Plant
from moc_opt.sim.sensors import Measurement
from moc_opt.sim.settings import PlantSettings
from moc_opt.sim.tool_load import ToolLoad

__all__ = ["Measurement", "Mismatch", "Plant", "PlantSettings", "ToolLoad"]

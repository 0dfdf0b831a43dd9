"""A plant's period, bound once to MuJoCo's memory: attributes of MjData cost more than arithmetic."""

from __future__ import annotations

from functools import partial

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from moc_opt.errors import PlantError
from moc_opt.numerics.arrays import Array
from moc_opt.robots import RobotData
from moc_opt.sim import period
from moc_opt.sim.actuation import Drives
from moc_opt.sim.contact import Pushes
from moc_opt.sim.joints import Joints
from moc_opt.sim.mismatch import Mismatch
from moc_opt.sim.mjcf import FORCE_SENSOR, MOUNT_SITE, TOOL_BODY
from moc_opt.sim.sensors import Encoders
from moc_opt.sim.settings import PlantSettings


class Bindings:
    """Views on MuJoCo's arrays, and the arguments of a period's kernels.

    Attributes:
        joints, drives, pushes: the arm's joints, their drives, and external forces held on links.
        tip, wrist: (3,) true points [m].
        mount, wrench: (3, 3) orientation of the wrench sensor, and (6,) its reading.
        truth: (2 n + 9,) as ``period.write_truth`` fills it, of now.
        tissue: (2,) stiffness [N/m] and damping [N s/m] of the trocar in the last period; 0 without one.
        tell: brings `truth` up to date outside of a period.
    """

    def __init__(
        self, data: RobotData, settings: PlantSettings, mismatch: Mismatch, model: mujoco.MjModel, state: mujoco.MjData
    ) -> None:
        """Bind them; the arrays must stay MuJoCo's.

        Raises:
            PlantError: the URDF lacks a link of the tool.
        """
        bodies = {model.body(i).name: i for i in range(1, model.nbody)}
        frames = (TOOL_BODY, data.tip_frame, data.wrist_frame)
        missing = [name for name in frames if name not in bodies]
        if missing:
            raise PlantError(
                f"robot {data.name!r}: its URDF has no links {missing}: load it with "
                "moc_opt.robots.load_data, which adds them"
            )
        tool, tip, wrist = (bodies[name] for name in frames)
        joints = self.joints = Joints(data, settings, mismatch, model, state)
        drives = self.drives = Drives(data.tau_max, settings.delay_ticks, joints.torque)
        self.tip, self.wrist = state.xpos[tip], state.xpos[wrist]
        self.truth, self.tissue, self._told = np.zeros(2 * data.n + 9), np.zeros(2), np.zeros((2, 3))
        self.mount = state.site_xmat[model.site(MOUNT_SITE).id].reshape(3, 3)
        # MuJoCo's sensor shows what the mount exerts on the tool; ours, as real ones do, the reaction.
        first = model.sensor(FORCE_SENSOR).adr[0]
        self.wrench = state.sensordata[first : first + 6]
        self.pushes = Pushes(bodies, model.body_ipos)

        origin, point, trocar = state.subtree_com[model.body_rootid[tool]], np.zeros(3), np.zeros((2, 3))
        numbers = np.array([
            tool, tip, wrist, joints.stride, joints.direct, joints.on_links, settings.substeps
        ], dtype=np.int64)  # fmt: skip
        self.tell = partial(
            period.write_truth, joints.q, joints.v, state.xpos, state.cvel, origin, numbers, trocar, self.tissue,
            point, settings.period_s, self.truth,
        )  # fmt: skip
        self._before = (
            period.addresses(model, state), numbers, np.array([settings.substep_s, settings.period_s]), trocar,
            np.zeros(3), point, state.xpos, state.xmat, state.xipos, state.cvel, origin, state.xfrc_applied,
            state.qpos, state.qvel, joints.q, joints.v, joints.theta, joints.omega, joints.torque, state.qfrc_applied,
            joints.ripple, drives.limit, drives.queue,
        )  # fmt: skip

    def memory(self, encoders: Encoders) -> period.PlantMemory:
        """Return what a period works on until the next reset."""
        return period.PlantMemory(*self._before, encoders.memory, encoders.conversion, self.wrench, self.truth)

    def told(self, trocar: ArrayLike | None) -> Array:
        """Return the trocar (2, 3) as contiguous numbers, zeros for none.

        Raises:
            PlantError: it has another shape.
        """
        if trocar is None:
            self._told[:] = 0.0
        elif (trocar.shape if isinstance(trocar, np.ndarray) else np.shape(trocar)) == (2, 3):
            self._told[:] = trocar
        else:
            raise self.refusal(trocar)
        return self._told

    @staticmethod
    def refusal(trocar: ArrayLike | None) -> PlantError:
        """Make the error of a trocar that is not (2, 3) finite numbers."""
        return PlantError(
            f"trocar = {np.asarray(trocar).tolist()!r:.200}: give (2, 3) finite numbers, point [m] over "
            "velocity [m/s], or None for no trocar; the arm has not moved"
        )

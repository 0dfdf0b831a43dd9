"""Old, repeated and frozen measurements: the age of each, and whether it shows the motion that the torque made."""

from __future__ import annotations

import numpy as np

from moc_opt.control import motion_kernels as kernels
from moc_opt.control import replay_kernels as replays
from moc_opt.control.safety_settings import MotionSettings
from moc_opt.numerics.arrays import Array

WORDS = {
    kernels.RAN_AWAY: "the encoders' positions do not follow their velocities",
    kernels.REPEATED: "all encoders repeat one reading, as no arm that moves or has noise does",
    kernels.STUCK: "an encoder repeats one reading while torque acts on its joint",
    kernels.UNEXPLAINED: "the measured motion is not what the torque makes: a wrong encoder, an unknown force, or a "
    "loop that shakes at too long a delay",
    kernels.ONE_REPEATED: "one encoder repeats its reading, as its noise does not let it",
    kernels.WRENCH_REPEATED: "the wrench sensor repeats its reading, as its noise does not let it",
    kernels.LAGGING: "one encoder lags: its readings came before, to the last bit",
    kernels.RECORDED: "the measurements are a recording: they came before, to the last bit",
}
"""Result of the kernels -> what is wrong with a reading."""


class MotionMonitor:
    """Levels and memory of the checks of one arm's motion; see ``motion_kernels``.

    Args:
        settings: the levels.
        period: control period [s].
        tau_max: (n,) [Nm].
        coulomb: (n,) Coulomb friction in the robot's file [Nm], 0 for a joint without; None: for all.

    Attributes:
        on: whether anything is checked.
        levels, held, most_replayed, clock, memory, still, seen, count, joints_seen, joints_count, tip: as
            ``motion_kernels`` and ``replay_kernels`` take them.
        settling: ticks until the residual is what it will be.
    """

    def __init__(self, settings: MotionSettings, period: float, tau_max: Array, coulomb: Array | None = None) -> None:
        n = tau_max.size
        self.on, self.levels, self.tau_max = settings.motion, settings.levels, np.array(tau_max)
        self.held = settings.held(tau_max, np.zeros(n) if coulomb is None else coulomb)
        self.settling = settings.settling_ticks(period)
        self.most_replayed = np.array([settings.replayed_ticks(n), settings.repeat_whole_ticks])
        self.clock, self.memory = np.zeros(3, dtype=np.int64), np.zeros((kernels.ROWS, n))
        self.still, self.tip = np.zeros(13), np.zeros(3)
        self.seen, self.count = np.zeros((2, replays.SLOTS)), np.zeros(3)
        self.joints_seen, self.joints_count = np.zeros((2 * n, replays.JOINT_SLOTS)), np.zeros((n, 3))

    def start(self, q: Array, v: Array, stamp: int) -> None:
        """Begin at a measurement; the next one may be the same."""
        self.clock[:] = stamp - 1, stamp - 1, -2
        for memory in (self.memory, self.still, self.tip, self.seen, self.count, self.joints_seen, self.joints_count):
            memory[:] = 0.0
        self.memory[kernels.SHOWN], self.memory[kernels.PEAK], self.memory[kernels.REPEATS] = q, np.abs(v), -1.0

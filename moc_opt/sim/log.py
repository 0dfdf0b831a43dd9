"""The record of the closed loop."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from moc_opt.arrays import Array
from moc_opt.sim.plant import Plant
from moc_opt.sim.protocols import LoggedController
from moc_opt.tasks.trocar import shaft_distance

Columns = dict[str, NDArray[Any]]


class TaskOffset(NamedTuple):
    """True minus believed place of the two points that the arm registered with its own tip, (3,) each [m].

    The robot's own frame lies off the true one by calibration error, encoder bias and bending joints. What it touches
    it registers in its own frame, so that the offset at that point is of no consequence to it; only how the offset
    changes on the way from there is.
    """

    tip: Array  #: Where the path begins.
    trocar: Array  #: Where the shaft enters, the error of the registration left out.

    @classmethod
    def nothing(cls) -> TaskOffset:
        """Return no offset: the robot's frame is the true one."""
        return cls(np.zeros(3), np.zeros(3))


class Log:
    """The rows of a run, filled one by one; ``done`` of them are.

    Args:
        plant: tells joints, period and the time of the first tick.
        controller: makes columns of its own.
        tip_refs, trocars, registered, offset: see `moc_opt.sim.loop.simulate`.
    """

    def __init__(
        self, plant: Plant, controller: LoggedController, tip_refs: Array, trocars: Array, registered: Array,
        offset: TaskOffset,
    ) -> None:
        n, ticks, self._offset = plant.data.n, len(tip_refs), offset
        self.done = 0
        self.kept: Columns = {
            "t_s": plant.time + plant.settings.period_s * np.arange(ticks),
            "tip_ref_m": np.array(tip_refs[:, 0]), "trocar_m": np.array(trocars[:, 0]),
            "trocar_registered_m": registered[:, 0] + offset.trocar, "tau_Nm": np.empty((ticks, n)),
            "tick_us": np.empty(ticks), "limited": np.zeros(ticks, dtype=np.int8), **controller.columns(ticks),
        }  # fmt: skip
        self.tau, self.tick_us, self.limited = (self.kept[name] for name in ("tau_Nm", "tick_us", "limited"))
        self.truth, self.wrench = np.empty((ticks, 2 * n + 9)), np.empty((ticks, 6))
        self._places = {"q_rad": n, "v_rad_per_s": n, "tip_m": 3, "wrist_m": 3, "trocar_force_N": 3}

    def columns(self) -> Columns:
        """Return the columns of the rows that are done, errors included."""
        rows, widths = slice(self.done), np.cumsum([*self._places.values()])[:-1]
        kept: Columns = {name: column[rows] for name, column in self.kept.items()}
        kept |= dict(zip(self._places, np.split(self.truth[rows], widths, axis=1), strict=True))
        kept["force_N"], kept["torque_Nm"] = self.wrench[rows, :3], self.wrench[rows, 3:]
        tip, wrist, tip_ref = kept["tip_m"], kept["wrist_m"], kept["tip_ref_m"]
        kept["tip_error_m"] = np.linalg.norm(tip_ref - tip, axis=1)
        kept["tip_error_registered_m"] = np.linalg.norm(tip_ref + self._offset.tip - tip, axis=1)
        kept["rcm_error_m"] = shaft_distance(tip, wrist, kept["trocar_m"])
        kept["rcm_error_registered_m"] = shaft_distance(tip, wrist, kept["trocar_registered_m"])
        return kept

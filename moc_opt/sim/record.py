"""The record of the closed loop, with one row per tick."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from moc_opt.arrays import Array
from moc_opt.errors import PlantError
from moc_opt.sim.plant import Plant
from moc_opt.sim.protocols import Filtered, LoggedController
from moc_opt.sim.sensors import Measurement
from moc_opt.tasks.trocar import shaft_distance
from moc_opt.trace.trace import Trace

Columns = dict[str, NDArray[Any]]

_STOPPED = {
    "status": "none", "fault": "stopped", "x_rad_per_s": np.nan, "applied_x_rad_per_s": np.nan,
    "dual": np.nan, "iterations": 0, "solve_us": np.nan,
}  # fmt: skip


class RunAway(PlantError):
    """The simulation of the plant diverged. ``trace`` has the rows so far."""

    def __init__(self, message: str, trace: Trace) -> None:
        super().__init__(message)
        self.trace = trace


class TaskOffset(NamedTuple):
    """True minus model position of the two registered points, (3,) each [m]."""

    tip: Array = np.zeros(3)  #: The start of the path.
    trocar: Array = np.zeros(3)  #: The trocar. The registration error is not part of this offset.


class Record:
    """The rows of a run, of which the first ``done`` are filled."""

    def __init__(
        self, plant: Plant, controller: LoggedController, tip_refs: Array, trocars: Array, registered: Array,
        offset: TaskOffset,
    ) -> None:  # fmt: skip
        n, ticks = plant.data.n, len(tip_refs)
        self._plant, self._controller, self._offset, self.done = plant, controller, offset, 0
        self._columns: Columns = {
            "t_s": plant.time + plant.settings.period_s * np.arange(ticks),
            "tip_ref_m": np.array(tip_refs[:, 0]), "trocar_m": np.array(trocars[:, 0]),
            "trocar_registered_m": registered[:, 0] + offset.trocar, "tau_Nm": np.empty((ticks, n)),
            "tick_us": np.empty(ticks), "limited": np.zeros(ticks, dtype=np.int8), **controller.columns(ticks),
        }  # fmt: skip
        self._truth, self._wrench = np.empty((ticks, 2 * n + 9)), np.empty((ticks, 6))
        self._widths = {"q_rad": n, "v_rad_per_s": n, "tip_m": 3, "wrist_m": 3, "trocar_force_N": 3}
        self._ending: dict[str, Any] = {"ended": "completed"}

    def note_truth(self) -> None:
        """Write the true state into the row of the next tick."""
        self._plant.write_truth(self._truth[self.done])

    def note(self, seen: Measurement, tau: Array, tick_us: float, filtered: Filtered) -> None:
        """Write the results of the tick into its row."""
        row, columns = self.done, self._columns
        self._controller.note(row, columns)
        self._wrench[row], columns["tau_Nm"][row], columns["tick_us"][row] = seen.force, tau, tick_us
        if limited := filtered.limited:
            columns["limited"][row] = limited
        self.done = row + 1
        if filtered.stop_reason:
            for name in columns.keys() & _STOPPED.keys():
                columns[name][row] = _STOPPED[name]
            if "stopped_at_s" not in self._ending:
                t = float(columns["t_s"][row])
                self._ending = {"ended": f"stopped: {filtered.stop_reason} (t = {t:.3f} s)", "stopped_at_s": t}

    def columns(self) -> Columns:
        """Return the filled rows, with tip and RCM errors."""
        rows, edges = slice(self.done), np.cumsum([*self._widths.values()])[:-1]
        found: Columns = {name: column[rows] for name, column in self._columns.items()}
        found |= dict(zip(self._widths, np.split(self._truth[rows], edges, axis=1), strict=True))
        found["force_N"], found["torque_Nm"] = self._wrench[rows, :3], self._wrench[rows, 3:]
        tip, wrist, tip_ref = found["tip_m"], found["wrist_m"], found["tip_ref_m"]
        found["tip_error_m"] = np.linalg.norm(tip_ref - tip, axis=1)
        found["tip_error_registered_m"] = np.linalg.norm(tip_ref + self._offset.tip - tip, axis=1)
        found["rcm_error_m"] = shaft_distance(tip, wrist, found["trocar_m"])
        found["rcm_error_registered_m"] = shaft_distance(tip, wrist, found["trocar_registered_m"])
        return found

    def trace(self, warnings: list[dict[str, Any]], meta: Mapping[str, Any], *, ran_away: bool) -> Trace:
        """Return the trace of the filled rows."""
        t = self._columns["t_s"]
        found: dict[str, Any] = {
            "period_s": self._plant.settings.period_s, "ticks": self.done, "ticks_planned": len(t), **self._ending,
            "faults": getattr(self._controller, "faults", None),
            "restarts": getattr(self._controller, "restarts", None) or None,
            "warnings": [{**one, "first_s": float(t[0]) + one["first_s"]} for one in warnings] or None,
        }  # fmt: skip
        if ran_away:
            found["ended"] = f"ran away at t = {t[self.done - 1]:.3f} s"
        return Trace(self.columns(), {**{name: value for name, value in found.items() if value is not None}, **meta})

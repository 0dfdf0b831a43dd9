"""One step of the closed loop: simulation, live page, operating procedure and benchmarks all call this one."""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter_ns
from typing import Any, NamedTuple, Protocol

import numpy as np

from moc_opt.numerics.arrays import Array
from moc_opt.sim.faults import Faults
from moc_opt.sim.filtered import NOTHING, Begun, Filtered, FilteredController
from moc_opt.sim.log import Block
from moc_opt.sim.plant import Plant
from moc_opt.sim.protocols import SafetyFilter, TorqueController
from moc_opt.sim.sensors import Measurement


@dataclass(frozen=True)
class Stop:
    """How the arm is stopped: damping of the drives [Nm s/rad], and how long the stop is simulated at least [s].

    It goes on until the arm is at rest, at most ``LONGEST`` times as long: with open brakes the tissue may push the
    arm for a while.
    """

    damping: float = 15.0
    seconds: float = 0.5


DEFAULT_STOP = Stop()
AT_REST = 0.005
"""Largest speed of a joint at rest [rad/s], [m/s] where it slides."""
LONGEST = 4


class Stepped(NamedTuple):
    """What compiled steps have done."""

    periods: int
    seen: Measurement
    """the last one, as it arrived"""
    tau: Array
    """(n,) the last torque that was applied [Nm]"""
    begun: Begun
    """of the period after them"""


class CompiledSteps(Protocol):
    """`ClosedLoop.step` for periods in which everything is compiled and nothing has to be judged in Python."""

    def __call__(self, block: Block, most: int, applied: Array) -> Stepped:
        """Advance from a block's first row that is not done, by so many periods at most, and fill the rows in.

        Args:
            block: has references, and takes rows.
            most: 1 or more.
            applied: (n,) torque that was applied before [Nm].
        """


class ClosedLoop:
    """Plant, controller and safety filter, advanced one control period at a time.

    Args:
        plant: at the state where the loop begins.
        controller: computes the torque; one that is ``Filtered`` already has its safety filter with it.
        safety_filter: checks measurements and limits torques; None: neither.
        stop: how the arm is stopped once the safety filter has requested it.
        faults: disturb sensors and arm; None: no faults.
        compiled: takes several periods at once where it can, for ``advance``; None: Python takes each.

    Attributes:
        seen: the last measurement, as it arrived.
        tau: (n,) the last torque that was applied [Nm].
        tick_us: time that safety filter and controller took for it [us].
        ticks: number of steps so far.
    """

    def __init__(
        self, plant: Plant, controller: TorqueController | Filtered, safety_filter: SafetyFilter | None,
        stop: Stop = DEFAULT_STOP, faults: Faults | None = None, compiled: CompiledSteps | None = None,
    ) -> None:  # fmt: skip
        self._compiled, self._begun = compiled, NOTHING
        self._plant, self._faults, self._damping = plant, faults, stop.damping
        self._watched = round(stop.seconds / plant.settings.period_s)
        self.tau, self.tick_us = np.array(plant.applied_torque), float("nan")
        self._filtered: Filtered = (
            controller if isinstance(controller, Filtered) else FilteredController(controller, safety_filter, self.tau)
        )
        self.seen, self.ticks, self._stopped_at = plant.measure(), 0, -1

    def start(self, tip_ref: Array, trocar: Array) -> None:
        """Start controller and safety filter at the plant's present measurement; arguments as for ``step``."""
        self.seen = self._plant.measure()
        self._filtered.start(self.seen, tip_ref, trocar)

    def advance(self, block: Block, most: int) -> int:
        """Step through a block's next rows as far as nothing has to be done in Python; return how many are done.

        The period after them is for ``step``, unless ``most`` periods are done, or the block is.
        """
        filtered = self._filtered
        if self._compiled is None or self._stopped_at >= 0 or not isinstance(filtered, FilteredController):
            return 0
        if self.begun:
            return 0
        done = self._compiled(block, most, self.tau)
        self._begun = done.begun
        filtered.took(done.tau, done.begun)
        if done.periods:
            self.seen, self.tau = done.seen, done.tau
            self.ticks += done.periods
        return done.periods

    def step(self, tip_ref: Array, registered: Array, trocar: Array | None = None) -> None:
        """Measure, check, compute, limit, and move the arm by one control period.

        Args:
            tip_ref: (3, 3) rows X_d [m], dX_d [m/s], ddX_d [m/s^2].
            registered: (2, 3) rows P_t [m], dP_t [m/s] of the trocar, as registered.
            trocar: (2, 3) the true one; None: the arm is in no incision.

        Raises:
            PlantError: the plant cannot go on; measurement and torque of this step are there all the same.
        """
        seen = self._plant.measure()
        if self._faults is not None:
            self._faults.act(self._plant, self.ticks)
            seen = self._faults.sense(seen, self.ticks)
        begin = perf_counter_ns()
        tau = self._filtered.tick(seen, tip_ref, registered)
        self.tick_us = (perf_counter_ns() - begin) * 1e-3
        self.seen, self.tau = seen, tau
        if self._filtered.stop_reason:
            self._stopped_at = self.ticks if self._stopped_at < 0 else self._stopped_at
            self._plant.brake(self._damping, self._filtered.brake_friction(seen))
        self.ticks += 1
        found, self._begun = self._begun.moved, NOTHING
        self._plant.step(tau, trocar, found)

    @property
    def begun(self) -> bool:
        """Whether ``advance`` has done a part of the next period already; ``step`` does the rest."""
        return self._begun is not NOTHING

    @property
    def stop_reason(self) -> str:
        """Why the arm is being stopped; empty while it is not."""
        return self._filtered.stop_reason

    @property
    def finished(self) -> bool:
        """Whether the arm has been stopped, and simulated for as long as ``Stop`` says."""
        if not 0 <= self._stopped_at < self.ticks - self._watched:
            return False
        over = self.ticks - self._stopped_at > LONGEST * self._watched
        return over or bool(np.abs(self._plant.v).max() < AT_REST)

    @property
    def limited(self) -> int:
        """Number of joints at which the safety filter changed the last torque."""
        return self._filtered.limited

    @property
    def warnings(self) -> list[dict[str, Any]]:
        """Figures above their warning level since the start, as JSON values."""
        return self._filtered.warnings

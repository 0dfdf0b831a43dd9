"""The record of the closed loop, a block of ticks at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from moc_opt.numerics.arrays import Array
from moc_opt.sim.plant import Plant
from moc_opt.sim.protocols import LoggedController
from moc_opt.tasks.trocar import shaft_distance

Columns = dict[str, NDArray[Any]]
Sink = Callable[[int, Columns], None]
"""Takes the columns of a block and the number of its first tick; the same block may come twice."""


class Trajectory(Protocol):
    """A reference of every tick: an array (N, rows, 3), or a function that makes a part of it."""

    def __len__(self) -> int:
        """Number of ticks, N."""

    def __getitem__(self, ticks: slice, /) -> Array:
        """Rows of consecutive ticks, (k, rows, 3)."""


class Trajectories(NamedTuple):
    """Where tip and trocar have to be, are, and are believed to be; see ``sim.loop.simulate``."""

    tip_refs: Trajectory
    trocars: Trajectory
    registered: Trajectory


class TaskOffset(NamedTuple):
    """True minus believed place of the two points that the arm registered with its own tip, (3,) each [m].

    The robot's own frame lies off the true one by calibration error, encoder bias and bending joints. What it touches
    it registers in its own frame, so that the offset at that point is of no consequence to it; only how the offset
    changes on the way from there is.
    """

    tip: Array
    """Where the path begins."""
    trocar: Array
    """Where the shaft enters, the error of the registration left out."""

    @classmethod
    def nothing(cls) -> TaskOffset:
        """Return no offset: the robot's frame is the true one."""
        return cls(np.zeros(3), np.zeros(3))


class Block:
    """Rows of consecutive ticks, filled one by one.

    Args:
        plant: tells joints and period.
        controller: makes columns of its own.
        trajectories: references of all ticks.
        offset: see `TaskOffset`.
        first, ticks: number of the first tick, and how many there are.
        begin_s: time of tick 0 [s].
    """

    def __init__(
        self, plant: Plant, controller: LoggedController, trajectories: Trajectories, offset: TaskOffset,
        first: int, ticks: int, begin_s: float,
    ) -> None:
        n, self._offset = plant.data.n, offset
        self.first, self.ticks, self.done = first, ticks, 0
        self.tip_refs, self.trocars, self.registered = (t[first : first + ticks] for t in trajectories)
        self.kept: Columns = {
            "t_s": begin_s + plant.settings.period_s * np.arange(first, first + ticks),
            "tip_ref_m": np.array(self.tip_refs[:, 0]), "trocar_m": np.array(self.trocars[:, 0]),
            "trocar_registered_m": self.registered[:, 0] + offset.trocar, "tau_Nm": np.empty((ticks, n)),
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


class Log:
    """The rows of a run: one block of all, or several that go to a sink as they are full.

    Args:
        plant, controller, trajectories, offset: see `Block`.
        sink: takes each full block; None keeps all of them in one.
        most: ticks of a block for the sink.
    """

    def __init__(
        self, plant: Plant, controller: LoggedController, trajectories: Trajectories, offset: TaskOffset,
        sink: Sink | None, most: int,
    ) -> None:
        self._make = partial(Block, plant, controller, trajectories, offset)
        self._sink, self._begin_s, self.total = sink, plant.time, len(trajectories.tip_refs)
        self._most = self.total if sink is None else most
        self.block = self._open(0)

    def _open(self, first: int) -> Block:
        return self._make(first, min(self._most, self.total - first), self._begin_s)

    def blocks(self) -> Iterator[Block]:
        """Go through the blocks; the next one is made when the one before is full."""
        while True:
            yield self.block
            if self.block.first + self.block.ticks >= self.total:
                return
            self._hand_over()
            self.block = self._open(self.block.first + self.block.ticks)

    def close(self) -> Mapping[str, NDArray[Any]]:
        """Return the columns so far; none where a sink has them all."""
        if self._sink is None:
            return self.block.columns()
        self._hand_over()
        return {}

    def _hand_over(self) -> None:
        if self._sink is not None and self.block.done:
            self._sink(self.block.first, self.block.columns())

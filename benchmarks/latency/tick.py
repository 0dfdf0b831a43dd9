"""One control tick, state to torque: whole with several solvers, in its parts, and in the other libraries.

Everything here is timed on ticks that were recorded in a run with the realistic plant (ours) or in the peer's own
ideal run (theirs), one after the other in chunks, in one process.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np

from benchmarks import baselines as peers
from benchmarks.baselines.check import PERIOD_S, Inputs, Verdict, job, perform, verdict
from benchmarks.common.timing import Timed
from moc_opt.control import Controller, ControlSettings, tick
from moc_opt.control import null_space as manipulability
from moc_opt.control.law import law_of
from moc_opt.control.observer import MomentumObserver
from moc_opt.model.kinematics_kernels import state_views
from moc_opt.model.robot_model import RobotModel
from moc_opt.numerics.arrays import Array
from moc_opt.qp.problem import NullSpaceQP, row_length
from moc_opt.scenario import Setup, make_safety_filter, make_solver, make_stop
from moc_opt.scenario.adapter import ControllerAdapter
from moc_opt.sim.loop import simulate
from moc_opt.solvers.base import Solver
from moc_opt.trace.trace import Trace


class Recording(NamedTuple):
    """What a closed-loop run leaves for the clock."""

    inputs: list[Inputs]
    problems: list[NullSpaceQP]
    trace: Trace


class _Ear(ControllerAdapter):
    """An adapter that remembers what it was asked."""

    def __init__(self, controller: Controller) -> None:
        super().__init__(controller)
        self.heard: list[Inputs] = []

    def tick(self, q: Array, v: Array, tip_ref: Array, trocar: Array) -> Array:
        """See ``sim.loop.LoggedController``."""
        self.heard.append((q, v, np.array(tip_ref), np.array(trocar)))
        return super().tick(q, v, tip_ref, trocar)


def record(setup: Setup) -> Recording:
    """Run the scenario once, and keep what every tick was given and its subproblem."""
    ear = _Ear(setup.controller())
    trace = simulate(
        setup.plant, ear, *references(setup), safety_filter=make_safety_filter(setup.robot, setup.scenario),
        stop=make_stop(setup.scenario),
    )  # fmt: skip
    problems = [NullSpaceQP.from_row(np.array(row)) for row in trace.subproblem]
    return Recording(ear.heard, problems, trace)


def references(setup: Setup) -> tuple[Array, Array, Array]:
    """Return the tip references (N, 3, 3), true and registered trocar (N, 2, 3) of every tick of a scenario."""
    t = setup.times()
    tip, true, registered = (
        np.stack(source.at(t), axis=1) for source in (setup.reference, setup.trocar, setup.registered)
    )
    return tip, true, registered


def own_ticks(
    names: Iterable[str], robot: RobotModel, settings: ControlSettings, inputs: list[Inputs], period_s: float
) -> tuple[dict[str, Timed], dict[str, str]]:
    """Map solver to its whole tick; and solver -> why it cannot run in this controller."""
    timed: dict[str, Timed] = {}
    refused: dict[str, str] = {}
    for name in names:
        adapter = ControllerAdapter(Controller(robot, settings, make_solver(name, robot), period_s))
        try:
            adapter.start(*inputs[0])
        except Exception as error:  # noqa: BLE001 - one solver that fails must not end the others
            refused[name] = f"{type(error).__name__}: {error}"
            continue
        timed[name] = Timed(spread(adapter.tick), inputs)
    return timed, refused


def spread(call: Callable[..., Any]) -> Callable[[tuple[Any, ...]], Any]:
    """Return ``call`` for a tuple of its arguments."""
    return lambda given: call(*given)


PARTS = {
    "model state": "pinocchio's terms, Jacobians, manipulability and its gradient (RobotModel.state)",
    "levels 1 and 2": "tip and RCM torque, one compiled call",
    "before the solver": "one compiled call: the next two rows",
    "- null space": "Z carried on, called alone",
    "- subproblem": "its record filled, called alone",
    "solver": "exact, from Python",
    "observer": "momentum residual",
    "level 3 and limits": "one compiled call",
}
"""Part of a tick -> what it is; those that begin with a dash lie inside the one above."""


def parts(
    robot: RobotModel, settings: ControlSettings, solver: Solver, inputs: list[Inputs], period_s: float
) -> dict[str, Timed]:
    """Return the parts of our tick, each on the same states: what the controller calls, called by itself."""
    n, law = robot.n, law_of(settings, robot)
    states = [robot.state(q, v) for q, v, _, _ in inputs]
    given = [(state, tip_ref, trocar) for state, (_, _, tip_ref, trocar) in zip(states, inputs, strict=True)]
    Z, tau, row = manipulability.null_space(states[0].A), np.empty(n), np.empty(row_length(n))
    observer = MomentumObserver(robot, settings.observer_gain_per_s or 1.0, period_s)
    observer.start(states[0])
    held = np.array(states[0].h)
    held.flags.writeable = False
    problems = []
    for state, tip_ref, trocar in given:
        record = np.empty(row_length(n))
        tick.fill_subproblem(state.record, law, tip_ref, trocar, record)
        problems.append(NullSpaceQP.from_row(record))
    session = solver.start(problems[0])
    answers = [np.array(session.solve(qp).x) for qp in problems]
    views = [state_views.py_func(state.record, n) for state in states]
    spans = [(view.A, view.u) for view in views]

    def low(item: Any) -> None:
        state, tip_ref, trocar = item
        tick.tracking_torque(state.record, law, tip_ref, trocar, held)

    def prepare(item: Any) -> None:
        state, tip_ref, trocar = item
        tick.prepare_third_level(state.record, law, tip_ref, trocar, Z, row)

    def fill(item: Any) -> None:
        state, tip_ref, trocar = item
        tick.fill_subproblem(state.record, law, tip_ref, trocar, row)

    def after(item: Any) -> None:
        state, x = item
        tick.add_third_level(state.record, law, Z, x, 1.0, tau)

    calls: dict[str, tuple[Callable[[Any], Any], list[Any]]] = {
        "model state": (lambda item: robot.state(item[0], item[1]), inputs),
        "levels 1 and 2": (low, given),
        "before the solver": (prepare, given),
        "- null space": (lambda item: manipulability.follow_null_space(item[0], item[1], Z), spans),
        "- subproblem": (fill, given),
        "solver": (session.solve, problems),
        "observer": (lambda state: observer.update(state, held), states),
        "level 3 and limits": (after, list(zip(states, answers, strict=True))),
    }
    return {name: Timed(*entry) for name, entry in calls.items()}


class PeerRun(NamedTuple):
    """A peer that does its job: what is timed, and how well it did it."""

    timed: Timed
    level: str
    verdict: Verdict


def peer_ticks(
    names: Iterable[str], robot: RobotModel, advance: Callable[[str], None]
) -> tuple[dict[str, PeerRun], dict[str, str]]:
    """Map peer to its tick on the states of its own run; and peer -> why it is not listed."""
    work, runs, refused = job(robot), {}, {}
    for name in names:
        reason = peers.missing(name)
        advance(f"tried {name}")
        if reason is not None:
            refused[name] = reason
            continue
        peer = peers.create(name, robot, PERIOD_S)
        poses, given = perform(peer, robot, work)
        runs[name] = PeerRun(Timed(spread(peer.tick), given), peer.level, verdict(poses, robot, work))
    return runs, refused

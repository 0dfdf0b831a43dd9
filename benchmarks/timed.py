"""Measure times for ``python -m benchmarks.speed``. Each function that returns a `Part` is a job."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from benchmarks import peers
from moc_opt import core
from moc_opt.arrays import Array
from moc_opt.control import Controller
from moc_opt.control.law_numbers import numbers_of
from moc_opt.export import export_scenario
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.robots.model import load_robot
from moc_opt.scenario import Scenario, Setup, make_solver
from moc_opt.solvers.exact import Exact
from moc_opt.study.timing import each_us, percentiles, since, total, used

ROOT, CHUNK = Path(__file__).resolve().parents[1], 100
COLD = 5  # The first COLD calls of each chunk count as "cold".


class Timed(NamedTuple):
    call: Callable[[Any], Any]
    items: Sequence[Any]


@dataclass
class Part:
    """The measurements of one job.

    Attributes:
        found: figures by section of the summary, then by name.
        rows: rows for rows.parquet.
        missing: reason for each entry that could not run.
        times: (chunks, CHUNK) [us] of each entry.
        seen: context switches and processor time of each entry.
    """

    found: dict[str, dict[str, Any]] = field(default_factory=dict)
    rows: list[dict[str, Any]] = field(default_factory=list)
    missing: dict[str, str] = field(default_factory=dict)
    times: dict[str, Array] = field(default_factory=dict)
    seen: dict[str, dict[str, float]] = field(default_factory=dict)

    def time(self, part: str, entries: Mapping[str, Timed], rounds: int) -> None:
        """Time the entries in turn, chunk by chunk, so that a slow moment affects all of them.

        The first round is not timed.
        """
        names, starts = list(entries), range(0, min(len(entry.items) for entry in entries.values()) - CHUNK + 1, CHUNK)
        chunks: dict[str, list[Array]] = {name: [] for name in names}
        seen: dict[str, list[dict[str, float]]] = {name: [] for name in names}
        for turn in range((1 + rounds) * len(starts)):
            begin, first, timed = starts[turn % len(starts)], turn % len(names), turn >= len(starts)
            for name in names[first:] + names[:first]:
                call, items = entries[name]
                times = each_us(call, items[begin : begin + CHUNK], seen=seen[name] if timed else None)
                if timed:
                    chunks[name].append(times)
        for name in names:
            self.times[name], self.seen[name] = np.array(chunks[name]), total(seen[name])
            late = np.percentile(self.times[name], [50, 99, 100], axis=1).T.tolist()
            self.rows += [
                {"part": part, "name": name, "round": i, "p50_us": p50, "p99_us": p99, "max_us": longest}
                for i, (p50, p99, longest) in enumerate(late)
            ]

    def figures(self, name: str, prefix: str) -> dict[str, float]:
        times = self.times[name]
        return {
            **percentiles(times.ravel(), prefix), f"{prefix}_max_us": float(times.max()),
            f"{prefix}_cold_p50_us": float(np.median(times[:, :COLD])), **self.seen[name],
        }  # fmt: skip

    def over(self, name: str, other: str) -> float:
        """Return the median ratio ``name`` / ``other`` of the chunks' median times."""
        return float(np.median(np.median(self.times[name], axis=1) / np.median(self.times[other], axis=1)))


def record(scenario: Scenario) -> tuple[list[peers.Inputs], list[NullSpaceQP]]:
    """Run a scenario. Return the inputs and the subproblem of every tick."""
    heard: list[peers.Inputs] = []

    class Ear(Controller):
        def tick(self, q: Array, v: Array, tip_ref: Array, trocar: Array) -> Array:
            heard.append((q, v, np.array(tip_ref), np.array(trocar)))
            return super().tick(q, v, tip_ref, trocar)

    class Heard(Setup):
        def controller(self) -> Ear:
            return Ear(self.robot, scenario.control, self.solver(), scenario.plant.period_s)

    trace = Heard(scenario).trace()
    problems = [NullSpaceQP.from_row(np.array(row)) for row in trace.subproblem]
    for qp in problems:
        _ = qp.q, qp.reduced()  # fills the caches, so that this work is not timed
    return heard, problems


# --- one tick, state to torque ---


def ticks(scenario: Scenario, solvers: Iterable[str], libraries: Iterable[str], rounds: int) -> Part:
    """Time a tick with every solver, and a tick of each other library on the inputs of its own run."""
    part, entries, (inputs, _) = Part(), dict[str, Timed](), record(scenario)
    robot = load_robot(scenario.robot.name)
    for name in solvers:
        controller = Controller(robot, scenario.control, make_solver(name, robot), scenario.plant.period_s)
        try:
            controller.start(*inputs[0])
        except Exception as error:  # noqa: BLE001 - a failing solver must not stop the others
            part.missing[f"solver {name}"] = f"{type(error).__name__}: {error}"
            continue
        entries[name] = Timed(_spread(controller.tick), inputs)
    own, theirs, task = list(entries), dict[str, dict[str, Any]](), peers.circle(robot)
    for name in libraries:
        peer = peers.PEERS[name](robot)
        poses, given = peers.perform(peer, robot, task)
        entries[name] = Timed(_spread(peer.tick), given)
        theirs[name] = {"level": peer.level, **peers.verdict(poses, robot, task)._asdict()}
    # The runs of other libraries are shorter, so their inputs are timed in more rounds.
    shortest = min(len(entry.items) for entry in entries.values())
    part.time("tick", entries, max(rounds, round(rounds * len(inputs) / shortest)))
    for name, row in theirs.items():
        row |= part.figures(name, "tick") | {"times_ours": part.over(name, "exact")}
    part.found = {"tick": {name: part.figures(name, "tick") for name in own}, "peers": theirs}
    return part


def _spread(call: Callable[..., Any]) -> Callable[[tuple[Any, ...]], Any]:
    return lambda given: call(*given)


def tick_parts(scenario: Scenario, rounds: int) -> Part:
    part, (inputs, _), robot = Part(), record(scenario), load_robot(scenario.robot.name)
    law = core.Law(robot.arm, **numbers_of(scenario.control, robot, scenario.plant.period_s))
    law.start(*inputs[0])

    def begin(item: peers.Inputs) -> Array:
        q, v, tip_ref, trocar = item
        return law.begin(q, v, tip_ref, trocar, None)[1]

    problems = [NullSpaceQP.from_row(begin(item)) for item in inputs]
    session = Exact().start(problems[0])
    answers = [np.array(session.solve(qp).x) for qp in problems]
    entries = {
        "before the solver": Timed(begin, inputs),
        "of which the arm's terms": Timed(lambda item: robot.state(item[0], item[1]), inputs),
        "solver": Timed(session.solve, problems),
        "after the solver": Timed(lambda answer: law.finish(0, 0, answer, 1.0), answers),
    }
    part.time("tick_parts", entries, rounds)
    part.found["tick_parts"] = {name: part.figures(name, "tick") for name in entries}
    return part


_SAID = re.compile(r"one tick: mean ([\d.]+) us, longest ([\d.]+) us")
_COMPARED = re.compile(r"largest difference from the recorded torque ([\d.e+-]+) Nm")


def exported(scenario: Scenario) -> Part:
    with tempfile.TemporaryDirectory() as folder:
        export_scenario(scenario, folder)
        command = ["make", "--silent", "test"]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True, timeout=120)
    said, compared = _SAID.search(done.stdout), _COMPARED.search(done.stdout)
    if said is None or compared is None:
        raise subprocess.SubprocessError(f"the exported program printed no times, but {done.stdout!r:.200}")
    names = ("tick_mean_us", "tick_max_us")
    times = dict(zip(names, map(float, said.groups()), strict=True))
    return Part({"tick": {"c": {**times, "difference_Nm": float(compared[1])}}})


# --- the solver alone ---


def batch(scenario: Scenario, count: int) -> Part:
    rows = np.array([qp.row for qp in record(scenario)[1]])
    many, solver = np.ascontiguousarray(np.resize(rows, (count, rows.shape[1]))), Exact()
    found = {"batch": float(count)}
    solver.solve_batch(many[: min(count, 1000)])
    for name, threads in (("one_thread", 1), ("two_threads", 2)):
        seconds = min(_seconds(partial(solver.solve_batch, many, threads)) for _ in range(2))
        found[f"batch_{name}_per_s"] = count / seconds
    return Part({"batch": {"exact": found}})


def _seconds(call: Callable[[], Any]) -> float:
    begin = perf_counter()
    call()
    return perf_counter() - begin


ADAPTERS = ("daqp", "piqp", "quadprog", "proxqp", "osqp", "clarabel")
BY_HAND = "daqp by hand"


def adapters(scenario: Scenario, names: Iterable[str], rounds: int) -> Part:
    part, (_, problems), robot = Part(), record(scenario), load_robot(scenario.robot.name)
    entries = {"exact": Timed(Exact().start(problems[0]).solve, problems)}
    for name in names:
        solver: Any = make_solver(name, robot)
        if reason := solver.supports(problems[0]):
            part.missing[f"adapter {name}"] = reason
            continue
        entries[name] = Timed(solver.start(problems[0]).solve, problems)
        if name == "daqp":
            by_hand = daqp_by_hand(solver, problems[0])
            if reason := disagreement(solver, by_hand, problems):
                part.missing[BY_HAND] = reason
            else:
                entries[BY_HAND] = Timed(by_hand, problems)
    part.time("adapters", entries, rounds)
    part.found["adapters"] = {
        name: part.figures(name, "adapter") | {"ratio_of_exact": part.over("exact", name)} for name in entries
    }
    return part


def daqp_by_hand(settings: Any, first: NullSpaceQP) -> Callable[[NullSpaceQP], tuple[Array, Array]]:
    """Return a call that uses daqp without its adapter."""
    at, scale, n = settings.start(first), settings.cost_scale, first.n
    core = at._core

    def call(qp: NullSpaceQP) -> tuple[Array, Array]:
        (P, p, A, b, _), part = qp.reduced(), qp.fields
        np.multiply(P, scale, out=at._P)
        np.multiply(p, scale, out=at._p)
        at._A[:] = A
        at._lower[:n], at._upper[:n] = part.lower, part.upper
        at._lower[n:] = at._upper[n:] = b
        core.update(at._P, at._p, at._A, at._upper, at._lower, None)
        x, _, _, info = core.solve()
        return x, info["lam"][n:]

    return call


def disagreement(solver: Any, by_hand: Callable[[NullSpaceQP], Any], problems: list[NullSpaceQP]) -> str | None:
    session = solver.start(problems[0])
    gap = max(float(np.abs(session.solve(qp).x - by_hand(qp)[0]).max()) for qp in problems[:200])
    return None if gap <= 1e-4 else f"the answers of adapter and direct call differ by {gap:.2g} rad/s"


# --- the closed loop and its shortest possible tick ---


def own_steps(scenario: Scenario) -> tuple[Array, Callable[[], Array]]:
    """Return MuJoCo's state at each tick as a row, and a function that simulates one period from each state.

    The function applies the recorded forces.
    """
    import mujoco
    from mujoco.rollout import rollout

    kinds = mujoco.mjtState
    state, applied = kinds.mjSTATE_FULLPHYSICS, kinds.mjSTATE_QFRC_APPLIED | kinds.mjSTATE_XFRC_APPLIED
    setup, found = Setup(scenario), list[tuple[Array, Array, Array]]()
    model, data = setup.plant.mj_model, setup.plant.mj_data

    def read(what: int) -> Array:
        values = np.empty(mujoco.mj_stateSize(model, what))
        mujoco.mj_getState(model, data, values, what)
        return values

    setup.trace(lambda tick: found.append((read(state), read(applied), np.array(data.qacc_warmstart))))
    before, forces, warm = (np.array(part) for part in zip(*found, strict=True))

    def stepped() -> Array:
        after: Array = rollout(
            model, data, before, forces[:, None], control_spec=applied, nstep=scenario.plant.substeps,
            initial_warmstart=warm,
        )[0][:, -1]  # fmt: skip
        return after

    return before, stepped


def loop(scenario: Scenario, runs: int) -> Part:
    """Time whole runs and, after each, MuJoCo's steps alone from the same states."""
    part, (states, stepped), times = Part(), own_steps(scenario), list[Array]()
    seen, bar = list[dict[str, float]](), list[int]()
    for turn in range(1 + runs):
        setup, before = Setup(scenario), used()
        trace = setup.trace(lambda tick: bar.append(tick) if tick % 100 == 0 else None)
        spent = since(before, len(trace))
        if turn:
            seen.append(spent)
            times.append(trace.tick_us)
            us, steps = 1e6 * spent["times_wall_s"] / len(trace), 1e6 * _seconds(stepped) / len(states)
            row = {"part": "loop", "name": "python", "round": turn, "us_per_tick": us, "steps_us": steps}
            part.rows.append(row)
    us = float(np.median([row["us_per_tick"] for row in part.rows]))
    python = {
        "factor": 1e6 * scenario.plant.period_s / us, "us_per_tick": us,
        **percentiles(np.concatenate(times), "tick"), **total(seen),
    }  # fmt: skip
    part.found["loop"] = {"python": python}
    return part


def limit(rows: Iterable[Mapping[str, Any]], c_tick_us: float | None) -> dict[str, float]:
    """Return medians over the runs. The limit is the shortest time of a tick: MuJoCo's steps plus `moc_step` in C."""
    us, steps = np.array([(row["us_per_tick"], row["steps_us"]) for row in rows]).T
    found = {"steps_us": float(np.median(steps))}
    if c_tick_us is not None:
        least = steps + c_tick_us
        found |= {"limit_us": float(np.median(least)), "python_over_limit": float(np.median(us / least))}
    return found


# --- new processes ---

FIRST_TICK = """
from time import perf_counter
begin = perf_counter()
import moc_opt as mo
import numpy as np
from moc_opt.control import Controller, ControlSettings
loaded = perf_counter()
robot = mo.load_robot()
controller = Controller(robot, ControlSettings(), mo.solvers.create("exact"))
state = robot.state(robot.data.q_home)
tip_ref = np.array([state.tip, np.zeros(3), np.zeros(3)])
trocar = np.array([state.tip - 0.15 * state.tool_direction, np.zeros(3)])
built = perf_counter()
controller.start(state.q, state.v, tip_ref, trocar)
controller.tick(state.q, state.v, tip_ref, trocar)
done = perf_counter()
print('{"first_tick_s": %r, "libraries_s": %r, "model_s": %r, "start_and_tick_s": %r}' % (
    done - begin, loaded - begin, built - loaded, done - built))
"""
FIRST_RUN = ("-m", "moc_opt", "run", "--json")


def fresh(processes: int) -> Part:
    """Time new processes. Each ``moc-opt run`` has its own home folder, so that it finds no caches."""
    part = Part()
    for turn in range(processes):
        told = json.loads(_process("-c", FIRST_TICK).stdout)
        part.rows.append({"part": "setup", "name": "first tick", "round": turn, **told})
        with tempfile.TemporaryDirectory() as home:
            seconds = _seconds(partial(_process, *FIRST_RUN, HOME=home, XDG_CACHE_HOME=home))
        part.rows.append({"part": "setup", "name": "first run", "round": turn, "first_run_s": seconds})
    names = dict.fromkeys(key for row in part.rows for key in row if key.endswith("_s"))
    medians = {key: float(np.median([row[key] for row in part.rows if key in row])) for key in names}
    part.found["setup"] = medians
    return part


def _process(*words: str, **variables: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *words], capture_output=True, text=True, check=True, cwd=ROOT, env=os.environ | variables
    )

"""What ``python -m benchmarks.speed`` times: ticks, solvers, libraries by hand, the loop, new processes, the C program.

Entries take turns in chunks, so that a slow moment of the machine hits all of them alike; ratios are of chunks or of
rounds that lie side by side.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from benchmarks import baselines as peers
from benchmarks.baselines.job import PERIOD_S, Inputs, job, perform, verdict
from benchmarks.latency.bare import by_hand
from moc_opt.arrays import Array
from moc_opt.control import Controller
from moc_opt.control.law import law_of
from moc_opt.export import export_scenario
from moc_opt.qp.problem import NullSpaceQP, row_length
from moc_opt.robots.model import RobotModel
from moc_opt.scenario import Scenario, Setup, make_solver
from moc_opt.scenario.adapter import ControllerAdapter
from moc_opt.solvers.exact import Exact
from moc_opt.study.timing import Disturbance, Timed, figures, interleaved, percentiles, ratios, used

ROOT, CHUNK = Path(__file__).resolve().parents[2], 100
Step = Callable[[str], None]


class Bench:
    """Times entries side by side, and keeps a row for each chunk and the reasons for what could not run.

    Attributes:
        rows: of rows.parquet.
        missing: what could not run -> why.
    """

    def __init__(self) -> None:
        self.rows, self.missing = list[dict[str, Any]](), dict[str, str]()

    def time(
        self, part: str, entries: Mapping[str, Timed], rounds: int
    ) -> tuple[dict[str, Array], dict[str, Disturbance]]:
        """Return (chunks, CHUNK) times [us] by name, and what the machine did meanwhile."""
        seen: dict[str, Disturbance] = {}
        times = interleaved(entries, rounds, CHUNK, seen)
        for name, chunks in times.items():
            late = np.percentile(chunks, [50, 99, 100], axis=1).T.tolist()
            self.rows += [
                {"part": part, "name": name, "round": i, "p50_us": p50, "p99_us": p99, "max_us": longest}
                for i, (p50, p99, longest) in enumerate(late)
            ]
        return times, seen


# --- one tick, state to torque ---


def record(scenario: Scenario) -> tuple[list[Inputs], list[NullSpaceQP]]:
    """Run a scenario, and return what every tick was given and its subproblem."""
    heard: list[Inputs] = []

    class Ear(ControllerAdapter):
        def tick(self, q: Array, v: Array, tip_ref: Array, trocar: Array) -> Array:
            heard.append((q, v, np.array(tip_ref), np.array(trocar)))
            return super().tick(q, v, tip_ref, trocar)

    class Heard(Setup):
        def adapter(self) -> ControllerAdapter:
            return Ear(self.controller())

    trace = Heard(scenario).trace()
    problems = [NullSpaceQP.from_row(np.array(row)) for row in trace.subproblem]
    for qp in problems:  # what the adapters read is computed before the clock starts
        _ = qp.P, qp.p, qp.q, qp.reduced()
    return heard, problems


def ticks(
    bench: Bench, solvers: Iterable[str], libraries: Iterable[str], scenario: Scenario, robot: RobotModel,
    inputs: list[Inputs], rounds: int, step: Step,
) -> tuple[dict[str, Any], dict[str, Any], dict[str, Array]]:  # fmt: skip
    """Time our tick with every solver, and those of other libraries on the states of their own runs.

    Returns:
        figures of ours, figures of theirs, and all times [us] by name.
    """
    entries: dict[str, Timed] = {}
    for name in solvers:
        controller = Controller(robot, scenario.control, make_solver(name, robot), scenario.plant.period_s)
        adapter = ControllerAdapter(controller)
        try:
            adapter.start(*inputs[0])
        except Exception as error:  # noqa: BLE001 - one solver that fails must not end the others
            bench.missing[f"solver {name}"] = f"{type(error).__name__}: {error}"
            continue
        entries[name] = Timed(_spread(adapter.tick), inputs)
    own, theirs, work = list(entries), dict[str, dict[str, Any]](), job(robot)
    for name in libraries:
        step(f"tries {name}")
        if reason := peers.missing(name):
            bench.missing[f"peer {name}"] = reason
            continue
        peer = peers.create(name, robot, PERIOD_S)
        poses, given = perform(peer, robot, work)
        entries[name] = Timed(_spread(peer.tick), given)
        installed = "make" if peers.PEERS[name].made else "hand"
        theirs[name] = {"level": peer.level, "installed": installed, **verdict(poses, robot, work)._asdict()}
    shortest = min(len(entry.items) for entry in entries.values())
    times, seen = bench.time("tick", entries, max(rounds, round(rounds * len(inputs) / shortest)))
    found = {name: figures(of, "tick", seen[name]) for name, of in times.items()}
    for name, row in theirs.items():
        over = float(np.median(ratios(times[name], times["exact"])))
        row |= found[name] | {"times_ours": (seen[name] + seen["exact"]).judged(over, 50.0)}
    return {name: found[name] for name in own}, theirs, {name: of.ravel() for name, of in times.items()}


def _spread(call: Callable[..., Any]) -> Callable[[tuple[Any, ...]], Any]:
    return lambda given: call(*given)


PARTS = {
    "model state": "kinematics, dynamics, manipulability and its gradient (RobotModel.state)",
    "before the solver": "observer, levels 1 and 2, null space and subproblem: one call of the core",
    "solver": "exact, from Python",
    "after the solver": "what the answer is worth, what stands in for it, level 3 and limits: one call of the core",
}
"""Part of a tick -> what it is."""


def parts(bench: Bench, scenario: Scenario, robot: RobotModel, inputs: list[Inputs], rounds: int) -> dict[str, Any]:
    """Time the parts of our tick, each on the same states: what the controller calls, called by itself."""
    n, law = robot.n, law_of(scenario.control, robot, scenario.plant.period_s)
    given = [(robot.state(q, v), tip_ref, trocar) for q, v, tip_ref, trocar in inputs]
    tau, x, row = np.empty(n), np.zeros(n), np.empty(row_length(n))
    law.start(given[0][0].record, given[0][1], given[0][2], row)

    def begin(item: Any) -> None:
        state, tip_ref, trocar = item
        law.begin(state.record, tip_ref, trocar, None, row)

    problems = []
    for item in given:
        begin(item)
        problems.append(NullSpaceQP.from_row(row.copy()))
    session = Exact().start(problems[0])
    answers = [np.array(session.solve(qp).x) for qp in problems]
    calls: dict[str, tuple[Callable[[Any], Any], list[Any]]] = {
        "model state": (lambda item: robot.state(item[0], item[1]), inputs),
        "before the solver": (begin, given),
        "solver": (session.solve, problems),
        "after the solver": (lambda answer: law.finish(0, 0, answer, 1.0, x, tau), answers),
    }
    times, seen = bench.time("tick_parts", {name: Timed(*entry) for name, entry in calls.items()}, rounds)
    return {name: figures(of, "tick", seen[name]) for name, of in times.items()}


_SAID = re.compile(r"median ([\d.]+) us, p99\.9 ([\d.]+) us, max ([\d.]+) us")
_COMPARED = re.compile(r"largest difference from the recorded torque ([\d.e+-]+) Nm")


def exported(scenario: Scenario) -> dict[str, float]:
    """Export the scenario's controller, make its own program, and return what that says of ``moc_step``.

    Raises:
        MocOptError: a setting that C cannot do.
        OSError, subprocess.SubprocessError: no make or compiler, or the program fails its own test.
    """
    with tempfile.TemporaryDirectory() as folder:
        export_scenario(scenario, folder)
        command = ["make", "--silent", "test"]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True, timeout=120)
    said, compared = _SAID.search(done.stdout), _COMPARED.search(done.stdout)
    if said is None or compared is None:
        raise subprocess.SubprocessError(f"the exported program said {done.stdout!r:.200}: its times are not in it")
    median, late, longest = map(float, said.groups())
    return {
        "tick_p50_us": median, "tick_p99_9_us": late, "tick_max_us": longest, "difference_Nm": float(compared[1]),
    }  # fmt: skip


# --- the solver alone ---


def batch(problems: list[NullSpaceQP], count: int) -> dict[str, float]:
    """Time ``Exact.solve_batch`` on ``count`` recorded subproblems in one call: the better of two on each.

    80 doubles a record of seven joints: a million are 640 MB.
    """
    rows = np.array([qp.row for qp in problems])
    many, solver = np.ascontiguousarray(np.resize(rows, (count, rows.shape[1]))), Exact()
    found = {"batch": float(count)}
    solver.solve_batch(many[: min(count, 1000)])
    for name, threads in (("one_thread", 1), ("two_threads", 2)):
        seconds = min(_seconds(partial(solver.solve_batch, many, threads)) for _ in range(2))
        found[f"batch_{name}_per_s"] = count / seconds
    return found


def _seconds(call: Callable[[], Any]) -> float:
    begin = perf_counter()
    call()
    return perf_counter() - begin


def adapters(
    bench: Bench, names: Iterable[str], robot: RobotModel, problems: list[NullSpaceQP], rounds: int
) -> dict[str, Any]:
    """Time every adapter beside its library by hand, and exact beside all of them."""
    entries, kept = {"exact": Timed(Exact().start(problems[0]).solve, problems)}, []
    for name in names:
        solver: Any = make_solver(name, robot)
        if reason := solver.supports(problems[0]) or disagreement(name, solver, problems):
            bench.missing[f"adapter {name}"] = reason
            continue
        kept.append(name)
        entries[name] = Timed(solver.start(problems[0]).solve, problems)
        entries[f"{name} by hand"] = Timed(by_hand(name, solver, problems[0]), problems)
    times, seen = bench.time("adapters", entries, rounds)
    found: dict[str, Any] = {"exact": figures(times["exact"], "adapter", seen["exact"])}
    for name in kept:
        hand, load = times[f"{name} by hand"], seen[name] + seen[f"{name} by hand"] + seen["exact"]
        medians = {
            "by_hand_p50_us": np.median(hand), "ratio": np.median(ratios(times[name], hand)),
            "ratio_of_exact": np.median(ratios(times["exact"], hand)),
        }  # fmt: skip
        found[name] = figures(times[name], "adapter", seen[name])
        found[name] |= {key: load.judged(float(value), 50.0) for key, value in medians.items()}
    return found


def disagreement(name: str, solver: Any, problems: list[NullSpaceQP], tolerance: float = 1e-4) -> str | None:
    """Say why adapter and library by hand do not do the same work; None when their answers agree."""
    session, library = solver.start(problems[0]), by_hand(name, solver, problems[0])
    for i, qp in enumerate(problems[:200]):
        gap = float(np.abs(session.solve(qp).x - library(qp)[0]).max())
        if not gap <= tolerance:
            return f"adapter and library by hand differ by {gap:.2g} rad/s at subproblem {i}"
    return None


# --- the closed loop and its limit ---


class Steps:
    """MuJoCo's own steps of the control periods of a run: no Python between them, no trocar, no sensors of ours.

    MuJoCo's time depends on the state: dry friction, joint limits and the trocar are work that an arm left alone does
    not have. So each period is stepped from its own recorded state, under the forces of the step before it.

    Attributes:
        states: (k, m) of MuJoCo before each period, its time first.
    """

    def __init__(self, scenario: Scenario) -> None:
        # Late: a process that measures other parts needs no threads of MuJoCo's.
        import mujoco
        from mujoco.rollout import rollout

        kinds = mujoco.mjtState
        state, self._forces_kind = kinds.mjSTATE_FULLPHYSICS, kinds.mjSTATE_QFRC_APPLIED | kinds.mjSTATE_XFRC_APPLIED
        setup = Setup(scenario)
        self._plant, self._rollout = setup.plant, rollout
        model, data, found = self._plant.mj_model, self._plant.mj_data, list[tuple[Array, Array, Array]]()

        def read(what: int) -> Array:
            values = np.empty(mujoco.mj_stateSize(model, what))
            mujoco.mj_getState(model, data, values, what)
            return values

        setup.trace(lambda tick: found.append((read(state), read(self._forces_kind), np.array(data.qacc_warmstart))))
        self.states, forces, self._warm = (np.array(part) for part in zip(*found, strict=True))
        self._forces = forces[:, None]

    def stepped(self) -> Array:
        """Step every period once, and return the states (k, m) after each."""
        states, _ = self._rollout(
            self._plant.mj_model, self._plant.mj_data, self.states, self._forces, control_spec=self._forces_kind,
            nstep=self._plant.settings.substeps, initial_warmstart=self._warm,
        )  # fmt: skip
        after: Array = states[:, -1]
        return after

    def us(self) -> float:
        """Time one control period's steps [us], the mean over all of them."""
        return 1e6 * _seconds(self.stepped) / len(self.states)


def loop(
    bench: Bench, scenario: Scenario, runs: int, c_tick_us: float | None, step: Step
) -> dict[str, dict[str, float]]:
    """Time the run as ``moc-opt run`` does it, with the watch of its progress bar, beside MuJoCo's steps of the same.

    References and trace are in it. One run more comes first, for caches. ``limit`` has the ratio, the rounds' median.
    """
    steps, walls, limits, times = Steps(scenario), list[float](), list[float](), list[Array]()
    seen, bar = Disturbance(), list[int]()
    for turn in range(1 + runs):
        setup, before = Setup(scenario), used()
        trace = setup.trace(lambda tick: bar.append(tick) if tick % 100 == 0 else None)
        spent = used() - before + Disturbance(len(trace))
        step("the closed loop")
        if turn:
            seen += spent
            walls.append(1e6 * spent.wall_s / len(trace))
            limits.append(steps.us())
            times.append(trace.tick_us)
            row = {"part": "loop", "name": "python", "round": turn}
            bench.rows.append(row | {"us_per_tick": walls[-1], "steps_us": limits[-1]})
    us, over = float(np.median(walls)), loop_ratios(np.array(walls), np.array(limits), c_tick_us)
    python = {
        "factor": seen.judged(1e6 * scenario.plant.period_s / us, 50.0), "us_per_tick": us,
        **percentiles(np.concatenate(times), "tick", seen), **seen.entries(),
    }  # fmt: skip
    return {"python": python, "limit": {name: seen.judged(value, 50.0) for name, value in over.items()}}


def loop_ratios(loop_us: Array, steps_us: Array, c_tick_us: float | None) -> dict[str, float]:
    """Return the medians over the rounds: MuJoCo's steps, the limit with the tick in C, and the loop over it."""
    found = {"steps_us": float(np.median(steps_us))}
    if c_tick_us is not None:
        limit = steps_us + c_tick_us
        found |= {"limit_us": float(np.median(limit)), "python_over_limit": float(np.median(loop_us / limit))}
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
controller.start(state, tip_ref, trocar)
controller.tick(state, tip_ref, trocar)
done = perf_counter()
print('{"first_tick_s": %r, "libraries_s": %r, "model_s": %r, "start_and_tick_s": %r}' % (
    done - begin, loaded - begin, built - loaded, done - built))
"""
FIRST_RUN = ("-m", "moc_opt", "run", "--json")


def fresh(bench: Bench, processes: int, step: Step) -> dict[str, float]:
    """Return medians over new processes [s]: from the first import to the first torque, and a whole ``moc-opt run``.

    Each run has a home of its own, so that nothing that an earlier one left there helps it.
    """
    rows: list[dict[str, Any]] = []
    for turn in range(processes):
        done = _process("-c", FIRST_TICK)
        rows.append({"part": "setup", "name": "first tick", "round": turn, **json.loads(done.stdout)})
        step("first torque of a new process")
        with tempfile.TemporaryDirectory() as home:
            seconds = _seconds(partial(_process, *FIRST_RUN, HOME=home, XDG_CACHE_HOME=home))
        rows.append({"part": "setup", "name": "first run", "round": turn, "first_run_s": seconds})
        step("moc-opt run in a new process")
    bench.rows += rows
    names = dict.fromkeys(key for row in rows for key in row if key.endswith("_s"))
    return {key: float(np.median([row[key] for row in rows if key in row])) for key in names}


def _process(*words: str, **variables: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *words], capture_output=True, text=True, check=True, cwd=ROOT, env=os.environ | variables
    )

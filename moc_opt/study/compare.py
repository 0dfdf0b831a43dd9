"""Compare solvers in closed loop: the same trials under DCAC and under MOC with each of them."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from moc_opt.errors import MocOptError, ScenarioError, SolverError, describe, shown
from moc_opt.inputs.files import LARGEST_INTEGER
from moc_opt.report.console import busy
from moc_opt.report.run_table import VERDICTS, answers_another_problem
from moc_opt.scenario import RunAway, Scenario, make_solver, run
from moc_opt.scenario.parts import check_solver
from moc_opt.solvers.base import Solver
from moc_opt.study.findings import Comparison
from moc_opt.study.trials import BASELINE, placed, variant
from moc_opt.trace.meta import Ending
from moc_opt.trace.metrics import summarize
from moc_opt.trace.trace import Trace

Solvers = Sequence[str | Solver] | Mapping[str, str | Solver]
Row = dict[str, Any]


def compare(
    solvers: Solvers, scenario: Scenario | str | os.PathLike[str] | None = None, trials: int = 15, *, seed: int = 0,
    random_start: bool = True, watch: Callable[[str], None] | None = None,
) -> Comparison:  # fmt: skip
    """Run every solver, and DCAC with the same gains, on the same trials.

    If a solver cannot be started or ends a run with an error, its rows hold the reason, and the others go on.
    After Ctrl-C the finished trials are returned, if there is one.

    Args:
        solvers: names, or solver objects (of `solvers.create` or your own); a mapping gives them other names.
        scenario: of every trial, or the path of its file; None: the default one.
        trials: how many; trial k has the seed ``seed + k``, which draws start, mismatch and noise.
        seed: of the first trial.
        random_start: whether pose and swivel are drawn too, in place of the scenario's `[start]`.
        watch: called with a few words before each run.

    Raises:
        UnknownNameError, SolverError: no such solver, no solver, or two of one name; before anything runs.
        ScenarioError: an argument is not usable, the scenario has no third level, or DCAC cannot run it.

    Example:
        >>> short = mo.Scenario(duration_s=0.05, bound_samples=0)
        >>> mo.compare({"one": "exact", "two": mo.solvers.create("exact")}, short, trials=1).solvers
        ['dcac', 'one', 'two']
    """
    base = Scenario() if scenario is None else Scenario.given(scenario)
    for argument, value, least in (("trials", trials, 1), ("seed", seed, 0)):
        if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= LARGEST_INTEGER:
            raise ScenarioError(f"{argument} = {shown(value)}: give an integer of {least} or more")
    if not isinstance(random_start, bool):
        raise ScenarioError(f"random_start = {shown(random_start)}: give True or False")
    if watch is not None and not callable(watch):
        raise ScenarioError(f"watch = {shown(watch)}: give a function of one text, or None")
    if base.control.law != "moc":
        raise ScenarioError("[control] law = 'dcac' asks no solver: take law = 'moc', DCAC is compared anyhow")
    chosen, note, rows = _named(solvers, base), f"{_starts(base, random_start)} {busy()}".strip(), list[Row]()
    start = {"pose": "random", "q_rad": None, "swivel": "random"} if random_start else {}
    done = 0
    try:
        for k in range(seed, seed + trials):
            rows += _trial(base, k, start, chosen, f"trial {k - seed + 1} of {trials}", watch, first=not rows)
            done += 1
    except KeyboardInterrupt:
        if not done:
            raise
        note = f"Interrupted: {done} of {trials} trials. {note}".strip()
    return Comparison(rows, list(chosen), base, note, done == trials)


def _trial(
    base: Scenario, seed: int, start: Mapping[str, Any], chosen: Mapping[str, str | Solver], where: str,
    watch: Callable[[str], None] | None, first: bool,
) -> list[Row]:  # fmt: skip
    """Run every solver on one trial; an error in laying out the first one is the scenario's, and is raised."""
    try:
        trial, baseline = placed(base.change(seed=seed, start=start)), None
    except MocOptError as error:
        if first:
            raise
        failed = f"{Ending.FAILED.value}: {describe(error)}"
        return [{"solver": name, "seed": seed, "ended": failed, "asked": 0} for name in chosen]
    rows = []
    for name, solver in chosen.items():
        if watch is not None:
            watch(f"{where}, {name}")
        row, trace = _row(trial, base, name, solver, baseline)
        rows.append({"solver": name, "seed": seed, **row})
        if name == BASELINE and Ending.of(row["ended"]).whole:
            baseline = trace
    return rows


def _row(
    trial: Scenario, base: Scenario, name: str, solver: str | Solver, baseline: Trace | None
) -> tuple[Row, Trace | None]:
    """Run one solver on a trial: how it ended, its ticks with a subproblem, its metrics; and its trace, if any."""
    named = solver if isinstance(solver, str) else None
    case = trial if named is None else variant(trial, named, _settings(base, named))
    try:
        trace = _run(case, None if isinstance(solver, str) else solver)
    except Exception as error:
        if name == BASELINE or isinstance(error, MemoryError):
            raise  # no solver is at fault
        return {"ended": f"{Ending.FAILED.value}: {describe(error)}", "asked": 0}, None
    found = {"ended": str(trace.meta["ended"]), "asked": _asked(trace)}
    same_length = baseline is not None and len(trace) == len(baseline)
    found |= summarize(trace, baseline if same_length else None)
    if answers_another_problem(trace, solver if isinstance(solver, str) else solver.name):
        found = {key: value for key, value in found.items() if key not in VERDICTS}
    return found, trace


def _starts(base: Scenario, random_start: bool) -> str:
    """Say from where the trials start, where that is not what the scenario says, or the same for all."""
    if not random_start:
        fixed = base.start.pose != "random" and base.start.swivel != "random"
        return "All trials start as the scenario's [start] says, from one pose." if fixed else ""
    said = base.start.model_fields_set & {"pose", "q_rad", "swivel"}
    text = "Starts are drawn at random: [start] is not used (`--keep-start`, random_start=False keep it)."
    return text if said else ""


def _settings(base: Scenario, name: str) -> Mapping[str, Any]:
    """Return the settings of the scenario's own solver, where that one is meant."""
    return base.solver.settings if name == base.solver.name else {}


def _run(case: Scenario, solver: Solver | None) -> Trace:
    try:
        return run(case, solver=solver)
    except RunAway as error:
        return error.trace


def _asked(trace: Trace) -> int:
    """Count the ticks at which there was a subproblem."""
    return int(np.count_nonzero(trace.status != "none")) if "status" in trace.columns else 0


def _named(solvers: Solvers, base: Scenario) -> dict[str, str | Solver]:
    """Name -> solver, the baseline first; every name is made once, so that a wrong one is found now."""
    if isinstance(solvers, str):
        raise SolverError(f"solvers = {solvers!r} is one text: give a list, [{solvers!r}]")
    if not isinstance(solvers, Mapping | Sequence):
        raise SolverError(f"solvers = {shown(solvers)}: give a list of names or solvers, such as ['exact', 'osqp']")
    pairs = solvers.items() if isinstance(solvers, Mapping) else [(_name(one), one) for one in solvers]
    robot, chosen = base.robot.arm(), dict[str, str | Solver]({BASELINE: BASELINE})
    for name, solver in pairs:
        if name == solver == BASELINE:
            continue  # the baseline is always compared
        if name in chosen:
            raise SolverError(
                f"two solvers are called {name!r}: name each once, or give a mapping, {{'one': ..., 'another': ...}}"
            )
        if isinstance(solver, str):
            make_solver(solver, robot, **_settings(base, solver))
        elif isinstance(solvers, Mapping):
            check_solver(solver)
        chosen[name] = solver
    if len(chosen) == 1:
        raise SolverError("no solver to compare: give one name or more, such as ['exact', 'osqp']")
    return chosen


def _name(solver: str | Solver) -> str:
    if isinstance(solver, str):
        return solver
    check_solver(solver)
    return solver.name

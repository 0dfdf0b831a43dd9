"""The parts of the solver study, one method each: every one can be resumed, and gives its part of the summary."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from benchmarks.solver_study import closed_loop, compare, growth, loop, open_loop
from benchmarks.solver_study.answers import Data, Limits, asked, timed
from benchmarks.solver_study.cells import (
    Cell,
    asked_all,
    cold_only,
    costs_of,
    load,
    solved_duals,
    time_figures,
    totals,
)  # fmt: skip
from benchmarks.solver_study.closed_loop import Run
from benchmarks.solver_study.config import Config
from benchmarks.solver_study.settings import QPSOLVERS, RECOMMENDED, Entry, effective, entries, in_words
from benchmarks.solver_study.store import Store
from benchmarks.solver_study.worker import Worker, spread
from moc_opt.inputs.names import file_stem
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.scenario import Scenario
from moc_opt.solvers.registry import accepts

Advance = Callable[[str], None]
Summary = dict[str, dict[str, dict[str, Any]]]

DUAL_SETS = ("circle", "random")
GROWING = ("solve_p50_us", "solve_p99_us", "setup_p50_us", "update_p50_us")
NONLINEAR = "nlp-"


class Study:
    """What was asked for, and what has been found so far.

    Args:
        config: what is compared.
        names: of the solvers that can run here.
        out: folder of the results; finished parts are kept in ``out/parts``.
        advance: called with a few words after each step.
    """

    def __init__(self, config: Config, names: Sequence[str], out: Path, advance: Advance) -> None:
        self.config, self.names, self.out, self.advance = config, list(names), out, advance
        self.store = Store(out / "parts")
        self.entries = entries(names, config.settings)
        self.recommended = [entry for entry in self.entries if entry.setting == RECOMMENDED]
        self.summary: Summary = {}
        self.rows: list[dict[str, Any]] = []
        self.samples: dict[str, Any] = {}  # of the figures
        self.words: dict[str, str] = {}
        self.runs: list[Run] = []
        self.seconds: dict[str, float] = {}  # that each part took, of the wall clock

    @property
    def steps(self) -> int:
        """How often ``advance`` will be called."""
        config, parts = self.config, self.config.parts
        trials = len(config.closed_loop.tasks) * config.closed_loop.seeds
        points = sum(len(sweep.points) for sweep in self._sweeps())
        points += 3 * len(config.sweeps.late_percent) * len(self._deadline_solvers())
        counts = {
            "open_loop": 2 * len(self.recommended), "testsets": 2 * len(self.entries),
            "growth": len(self._growing()), "closed_loop": trials * (1 + len(self._in_the_loop())),
            "sweeps": points, "duals": len(self._with_duals()), "qpbenchmark": 1,
        }  # fmt: skip
        return 1 + sum(counts[part] for part in parts)

    # --- open loop on the recorded sequence ---

    @cached_property
    def sequence(self) -> list[NullSpaceQP]:
        """What a closed-loop run with ``exact`` asks, tick by tick."""
        config = self.config
        cut = config.open_loop.ticks * config.scenario.plant.period_s
        case = next(
            iter(closed_loop.trials(config.scenario, [config.open_loop.task], [config.seed]).values())
        )
        return open_loop.record(case.change(duration_s=cut))

    @cached_property
    def recorded(self) -> Data:
        """The sequence as a set; its feasibility is ``exact``'s word, which the test sets bear out."""
        rows = np.array([qp.row for qp in self.sequence])
        session = _exact(self.sequence)
        feasible = np.array([session.solve(qp).status.label == "solved" for qp in self.sequence])
        return Data("recorded", rows, rows, feasible)

    def run_open_loop(self) -> None:
        """Every solver warm and cold on the recorded sequence, as we recommend it."""
        data, patience = self.recorded, max(2.0, self.config.testsets.patience_s)
        limits = Limits(patience, rounds=2, seconds=1.0, cold=self.config.open_loop.cold)
        every = max(1, len(data.rows) // self.config.open_loop.cold)
        thin = data.thinned(every)
        warm, cold = {}, {}
        with Worker() as worker:
            for entry in self.recommended:
                cell = Cell(entry, data, asked(self.store, worker, entry, data, limits))
                times = timed(self.store, worker, entry, data, limits, cell.complete)
                self.advance(f"open loop {entry.solver}, warm")
                if cell.refused:
                    self.summary.setdefault("not_run", {})[entry.solver] = {"reason": cell.refused}
                    self.advance(entry.solver)
                    continue
                warm[entry.solver] = cell.summary(times)
                apart = Cell(entry, thin, asked(self.store, worker, entry, thin, limits, warm=False))
                cold[entry.solver] = apart.summary(cold_only(times))
                self.rows += cell.rows("open_loop_warm") + apart.rows("open_loop_cold")
                self.samples.setdefault("open_loop", {})[entry.solver] = times.arrays["solve_us"].ravel()
                self.advance(f"open loop {entry.solver}, cold")
        self.summary |= {"open_loop_warm": warm, "open_loop_cold": cold}

    # --- the certified sets ---

    def run_testsets(self) -> None:
        """Every setting of every solver on every set; the answers several at a time, the times one by one."""
        table = self.config.testsets
        chosen = [load(name, table.every) for name in table.chosen()]
        limits = table.limits()

        def all_sets(worker: Worker, entry: Entry) -> list[Cell]:
            found = asked_all(self.store, worker, entry, chosen, limits)
            self.advance(f"answers {entry.label}")
            return found

        cells = spread(self.entries, all_sets, self.config.processes)
        whole: dict[str, dict[str, Any]] = {}
        costs: dict[str, Any] = {}
        with Worker() as worker:
            for entry, mine in zip(self.entries, cells, strict=True):
                measured = {}
                for cell in mine:
                    name = cell.data.name
                    if not cell.refused and (entry.setting == RECOMMENDED or name in table.timed):
                        measured[name] = timed(self.store, worker, entry, cell.data, limits, cell.complete)
                    part = self.summary.setdefault(f"testset {name}", {})
                    part[entry.label] = cell.summary(measured.get(name))
                    self.rows += cell.rows("testset")
                whole[entry.label] = totals(mine, measured)
                if entry.setting == RECOMMENDED:
                    costs[entry.solver] = costs_of(mine, measured)
                self.advance(f"times {entry.label}")
        self.summary["testsets"] = whole
        self.samples["profile"] = costs
        self.summary["settings"] = {
            e.label: {"options": in_words(effective(e)), "reason": e.reason} for e in self.entries
        }

    # --- joints ---

    def _growing(self) -> list[Entry]:
        nonlinear = self.config.growth.nonlinear
        return [e for e in self.recommended if nonlinear or not e.solver.startswith(NONLINEAR)]

    def run_growth(self) -> None:
        """How times grow with the joints, as we recommend each solver."""
        limits = self.config.testsets.limits()
        sets = {n: growth.sequence(n) for n in self.config.growth.joints}
        found: dict[str, dict[str, Any]] = {}
        with Worker() as worker:
            for entry in self._growing():
                figures: dict[int, dict[str, Any]] = {}
                row: dict[str, Any] = {"verified_solved": 0, "solves": 0}
                for n, data in sets.items():
                    cell = Cell(entry, data, asked(self.store, worker, entry, data, limits))
                    if cell.refused:
                        row["reason"] = cell.refused
                        continue
                    figures[n] = time_figures(timed(self.store, worker, entry, data, limits, cell.complete))
                    counts = cell.counts()
                    row = {**row, **{k: row[k] + counts[k] for k in ("verified_solved", "solves")}}
                    for key in GROWING:
                        if key in figures[n]:
                            row[f"{key}_n{n}"] = figures[n][key]
                for key in GROWING:
                    row |= {f"{key}_{name}": v for name, v in growth.growth(figures, key).items()}
                found[entry.solver] = row
                self.advance(f"joints {entry.solver}")
        self.summary["growth"] = found

    # --- closed loop ---

    def _in_the_loop(self) -> list[Entry]:
        """Without the libraries that run there through an adapter of their own."""
        native = {f"{QPSOLVERS}{name}" for name in self.names}
        return [e for e in self.recommended if self.config.closed_loop.twice or e.solver not in native]

    def run_closed_loop(self) -> None:
        """Every solver in the controller, and the baseline, on every trial."""
        part, config = self.config.closed_loop, self.config
        seeds = [config.seed + i for i in range(part.seeds)]
        cases = closed_loop.trials(config.scenario.change(duration_s=part.duration_s), part.tasks, seeds)
        controllers = {e.solver: e.options for e in self._in_the_loop()}
        self.runs = closed_loop.run_all(
            cases, controllers, self.advance, self.store, timed=part.timed, processes=config.processes
        )
        self.summary["closed_loop"] = closed_loop.summary(self.runs)

    def _sweeps(self) -> list[loop.Sweep]:
        values = self.config.sweeps.values
        many = values == "many"
        found = [*loop.accuracy_sweeps(many), loop.damping_sweep(), loop.box_sweep(many)]
        if values == "few":
            found = [replace(sweep, points=sweep.points[::3]) for sweep in found]
        return [sweep for sweep in found if sweep.needs in self.names]

    def _deadline_solvers(self) -> list[str]:
        return [name for name in self.config.sweeps.deadline_solvers if name in self.names]

    @cached_property
    def _sweep_trials(self) -> dict[str, Scenario]:
        part = self.config.sweeps
        seeds = [self.config.seed + i for i in range(part.seeds)]
        return closed_loop.trials(self.config.scenario.change(duration_s=part.duration_s), part.tasks, seeds)

    def run_sweeps(self) -> None:
        """Accuracy, damping, box and deadlines; the accuracy sweeps' points in open loop too."""
        cases = self._sweep_trials
        store, processes = self.store, self.config.processes
        done = spread(
            list(cases.values()), lambda w, trial: loop.run_baseline(store, w, trial), processes
        )
        baselines = dict(zip(cases, done, strict=True))
        sweeps = [*self._sweeps(), *self._deadlines(cases, baselines)]
        jobs = [(sweep, point) for sweep in sweeps for point in sweep.points]
        limits = self.config.testsets.limits()

        def work(
            worker: Worker, job: tuple[loop.Sweep, loop.Point]
        ) -> tuple[dict[str, Any], Any]:
            sweep, point = job
            found = loop.run_sweep(store, worker, sweep, point, cases, baselines)
            cell = None
            if point.entry is not None:
                cell = Cell(
                    point.entry, self.recorded, asked(store, worker, point.entry, self.recorded, limits)
                )
            self.advance(f"sweep {sweep.name} {point.label}")
            return found, cell

        _ = self.recorded  # before the threads ask for it
        opened, closed = {}, {}
        for (sweep, point), (found, cell) in zip(jobs, spread(jobs, work, processes), strict=True):
            self.summary.setdefault(f"sweep {sweep.name}", {})[point.label] = found
            if cell is not None and not cell.refused:
                name = f"{sweep.name.partition('.')[0]} {point.label}{sweep.suffix}"
                opened[name], closed[name] = cell.summary(), found
        self._compare(opened, closed)
        begins = {
            sweep.name: loop.beginning_of_cost(self.summary[f"sweep {sweep.name}"])
            for sweep in sweeps
            if sweep.group == "accuracy"
        }
        self.summary["cost_begins"] = {name: found for name, found in begins.items() if found}
        self.words["cost_begins"] = loop.begins_in_words(self.summary["cost_begins"])

    def _deadlines(
        self, cases: Mapping[str, Scenario], baselines: Mapping[str, Run]
    ) -> list[loop.Sweep]:
        """Sweeps over recorded times; one run at a time makes the recording, and it is kept as a file."""
        found, first = [], next(iter(cases.values()))
        with Worker() as worker:
            for name in self._deadline_solvers():
                trial = closed_loop.variant(first, name, self.config.settings.get(name, {}))
                run = closed_loop.run_one(self.store, worker, trial, name, baselines[first.name])
                if not run.columns:
                    continue
                times = run.columns["solve_us"]
                self.out.mkdir(parents=True, exist_ok=True)
                np.save(self.out / f"solve_us_{file_stem(name)}.npy", times)
                found.append(loop.deadline_sweep(name, times, self.config.sweeps.late_percent))
        return found

    def _compare(self, opened: dict[str, dict[str, Any]], closed: dict[str, dict[str, Any]]) -> None:
        """Does open loop predict closed loop? Over the points of the accuracy sweeps and the recommended settings."""
        trials = set(self._sweep_trials)
        if self.config.sweeps.duration_s == self.config.closed_loop.duration_s:
            for name, metrics in self.summary.get("open_loop_warm", {}).items():
                mine = [run for run in self.runs if run.controller == name and run.trial in trials]
                if {run.trial for run in mine} == trials:
                    label = f"{name} as recommended"
                    opened[label], closed[label] = metrics, closed_loop.combined(mine)
        found = compare.correlations(opened, closed)
        self.summary["prediction"] = found
        self.words["prediction"] = compare.verdict(found)
        self.summary["disagreements"] = {
            f"{one} ~ {other}: {d['name']}": d
            for one, other in (("relative_p50", "mu_mean"), ("primal_p50", "tip_error_model_mean_mm"),
                               ("loss_p50", "torque_rate_rms_Nm_per_s"))
            for d in compare.disagreements(opened, closed, one, other)
        }  # fmt: skip

    # --- duals ---

    def _with_duals(self) -> list[str]:
        return [name for name in self.names if accepts(name, "rows")]

    def run_duals(self) -> None:
        """The same problems on six rows and on five: how far apart are any two solvers' multipliers?"""
        limits = self.config.testsets.limits()
        sets = [load(name, max(2, self.config.testsets.every)) for name in DUAL_SETS]
        found: dict[int, dict[str, dict[str, Any]]] = {}

        def work(worker: Worker, name: str) -> dict[int, Any]:
            mine = {}
            for rows in (6, 5):
                options = {**self.config.settings.get(name, {}), "rows": rows}
                entry = Entry(name, f"rows={rows}", options, "")
                mine[rows] = np.concatenate(
                    [solved_duals(asked(self.store, worker, entry, d, limits)) for d in sets]
                )
            self.advance(f"duals {name}")
            return mine

        names = self._with_duals()
        given = spread(names, work, self.config.processes) if names else []
        problems = [NullSpaceQP.from_row(np.array(row)) for d in sets for row in d.rows]
        for rows in (6, 5):
            duals = {name: mine[rows] for name, mine in zip(names, given, strict=True)}
            found[rows] = compare.dual_distances(problems, duals)
            self.summary[f"duals on {'six' if rows == 6 else 'five'} rows"] = found[rows]
        self.words["duals"] = compare.dual_verdict(found[6], found[5])

    # --- everything ---

    def run(self) -> None:
        """All parts of the configuration, in the order in which they need each other."""
        _ = self.sequence
        self.advance("recorded the sequence")
        jobs = {
            "testsets": self.run_testsets, "open_loop": self.run_open_loop, "growth": self.run_growth,
            "closed_loop": self.run_closed_loop, "sweeps": self.run_sweeps, "duals": self.run_duals,
        }  # fmt: skip
        for part, job in jobs.items():
            if part in self.config.parts:
                begin = perf_counter()
                job()
                self.seconds[part] = round(perf_counter() - begin, 1)
        self.summary.setdefault("not_run", {})


def _exact(problems: Sequence[NullSpaceQP]) -> Any:
    from moc_opt.solvers.exact.solver import Exact

    return Exact().start(problems[0])

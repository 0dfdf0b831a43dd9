"""The parts of the study in closed loop: every controller on the trials, the sweeps, and what open loop predicts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.common.crew import spread
from benchmarks.common.processes import Worker
from benchmarks.solver_study import closed_loop, combine, compare, open_parts, sweeps
from benchmarks.solver_study.answers import Data, Limits, asked, recorded
from benchmarks.solver_study.cases import trials as draw_trials
from benchmarks.solver_study.cells import Cell
from benchmarks.solver_study.closed_loop import Run
from benchmarks.solver_study.config import ClosedLoop, Sweeps
from benchmarks.solver_study.study import Findings, Part, Study
from benchmarks.solver_study.sweeps import Point, Sweep
from moc_opt.comparison.trials import BASELINE, variant
from moc_opt.inputs.names import file_stem
from moc_opt.scenario import Scenario


def cases(study: Study, part: ClosedLoop | Sweeps) -> dict[str, Scenario]:
    """Return the trials of a part, by name."""
    base = study.config.scenario.change(duration_s=part.duration_s)
    return draw_trials(base, part.tasks, [study.config.seed + i for i in range(part.seeds)])


def controllers(study: Study, so_far: Findings) -> Findings:
    """Run every solver in the controller, and the baseline, on every trial."""
    part = study.config.closed_loop
    runs = closed_loop.run_all(
        cases(study, part), {s.solver: s.options for s in study.recommended}, study.advance, study.store,
        timed=part.timed, processes=study.config.processes, short=part.short, short_s=part.short_s,
        show=lambda runs: study.show({"closed_loop": combine.summary(runs)}),
    )  # fmt: skip
    found = {"closed_loop": combine.summary(runs)}
    if any(run.short for run in runs):
        found["closed_loop_beginning"] = combine.summary([run.beginning for run in runs])
    return Findings(found, runs=runs)


def chosen_sweeps(study: Study) -> list[Sweep]:
    """Return the sweeps over accuracy, damping and box whose solvers can run here."""
    values = study.config.sweeps.values
    many = values == "many"
    found = [*sweeps.accuracy_sweeps(many), sweeps.damping_sweep(many), sweeps.box_sweep(many)]
    if values == "few":
        found = [replace(sweep, points=sweep.points[::3]) for sweep in found]
    return [sweep for sweep in found if sweep.needs in study.names]


def all_sweeps(study: Study, so_far: Findings) -> Findings:
    """Sweep accuracy, damping, box and deadlines; the accuracy sweeps' points in open loop too."""
    store, processes = study.store, study.config.processes
    # A sweep compares its points with each other: the best course, planned anew in every process, is left out.
    trials = {name: trial.change(best_courses=False) for name, trial in cases(study, study.config.sweeps).items()}
    known = _known(study, so_far)
    baselines = known.get(BASELINE, {})
    if not set(trials) <= set(baselines):
        done = spread(list(trials.values()), lambda w, trial: sweeps.run_baseline(store, w, trial), processes)
        baselines = dict(zip(trials, done, strict=True))
    chosen = [*chosen_sweeps(study), *_deadlines(study, trials, baselines, known)]
    default = {} if study.config.settings.get("exact") else known.get("exact", {})
    jobs = [(sweep, point) for sweep in chosen for point in sweep.points]
    limits, data = study.config.testsets.limits(), recorded("recorded", so_far.sequence)

    def work(worker: Worker, job: tuple[Sweep, Point]) -> tuple[dict[str, Any], Cell | None]:
        sweep, point = job
        metrics = sweeps.run_sweep(store, worker, sweep, point, trials, baselines, default=default)
        cell = _in_open_loop(study, worker, point, data, limits)
        study.advance(f"sweep {sweep.name} {point.label}")
        return metrics, cell

    found = Findings()
    opened, closed = {}, {}
    for (sweep, point), (metrics, cell) in zip(jobs, spread(jobs, work, processes), strict=True):
        found.summary.setdefault(f"sweep {sweep.name}", {})[point.label] = metrics
        if cell is not None and not cell.refused:
            name = f"{sweep.name.partition('.')[0]} {point.label}{sweep.suffix}"
            opened[name], closed[name] = cell.summary(), metrics
    for name, metrics in so_far.summary.get("open_loop_warm", {}).items():
        mine = known.get(name, {})
        if set(trials) <= set(mine) and not any(run.short for run in mine.values()):
            opened[f"{name} as recommended"] = metrics
            closed[f"{name} as recommended"] = combine.combined([mine[trial] for trial in trials])
    found.add(prediction(opened, closed, len(trials)))
    begins = {
        sweep.name: sweeps.beginning_of_cost(found.summary[f"sweep {sweep.name}"])
        for sweep in chosen
        if sweep.group == "accuracy"
    }
    found.summary["cost_begins"] = {name: begin for name, begin in begins.items() if begin}
    found.words["cost_begins"] = sweeps.begins_in_words(found.summary["cost_begins"])
    return found


def _in_open_loop(study: Study, worker: Worker, point: Point, data: Data, limits: Limits) -> Cell | None:
    """Return the answers of a point's solver to the recorded sequence; None where the sweep is not about accuracy."""
    if point.setting is None:
        return None
    return Cell(point.setting, data, asked(study.store, worker, point.setting, data, limits))


def _known(study: Study, so_far: Findings) -> dict[str, dict[str, Run]]:
    """Return controller -> trial -> its run in the part before, if that has trials of the same length."""
    found: dict[str, dict[str, Run]] = {}
    if study.config.sweeps.duration_s == study.config.closed_loop.duration_s:
        for run in so_far.runs:
            found.setdefault(run.controller, {})[run.trial] = run
    return found


def _deadlines(
    study: Study, trials: Mapping[str, Scenario], baselines: Mapping[str, Run], known: Mapping[str, Mapping[str, Run]]
) -> list[Sweep]:
    """Return sweeps over recorded times; a run with nothing beside it makes the recording, and it is kept as a file."""
    found, first = [], next(iter(trials.values()))
    with Worker() as worker:
        for name in study.deadline_solvers:
            run = known.get(name, {}).get(first.name)
            if run is None or not run.timed or run.short:
                trial = variant(first, name, study.config.settings.get(name, {}))
                run = closed_loop.run_one(study.store, worker, trial, name, baselines[first.name])
            if not run.columns:
                continue
            times = run.columns["solve_us"]
            study.out.mkdir(parents=True, exist_ok=True)
            np.save(study.out / f"solve_us_{file_stem(name)}.npy", times)
            found.append(sweeps.deadline_sweep(name, times, study.config.sweeps.late_percent))
    return found


def prediction(opened: compare.Figures, closed: compare.Figures, trials: int) -> Findings:
    """Say whether open loop predicts closed loop, over the accuracy sweeps' points and the recommended settings."""
    pairs = {
        "relative_p50": "mu_mean", "primal_p50": "tip_error_model_mean_mm", "loss_p50": "torque_rate_rms_Nm_per_s",
    }  # fmt: skip
    found = compare.correlations(opened, closed)
    disagreements = {
        f"{one} ~ {other}: {d['name']}": d
        for one, other in pairs.items()
        for d in compare.disagreements(opened, closed, one, other)
    }
    return Findings(
        {"prediction": found, "disagreements": disagreements}, words={"prediction": compare.verdict(found, trials)}
    )


JOBS: dict[str, Part] = {
    "open_loop": open_parts.recorded_sequence, "testsets": open_parts.certified_sets, "closed_loop": controllers,
    "sweeps": all_sweeps, "growth": open_parts.more_joints, "duals": open_parts.duals,
}  # fmt: skip
"""Name in the configuration -> what runs, in the order in which they need each other."""


SECONDS = {
    "open_loop": 9.0, "testsets": 35.0, "closed_loop": 50.0, "sweeps": 42.0, "growth": 5.0, "duals": 1.0,
    "qpbenchmark": 10.0,
}  # fmt: skip
"""That each part takes, roughly, on two cores: what its steps weigh in the time that is left."""


def weights(study: Study) -> dict[str, float]:
    """Return for each part that is asked for what one of its steps weighs."""
    return {part: SECONDS[part] / max(count, 1) for part, count in steps(study).items() if part in study.config.parts}


def steps(study: Study) -> dict[str, int]:
    """Return how often each part calls ``study.advance``."""
    config = study.config
    points = sum(len(sweep.points) for sweep in chosen_sweeps(study))
    points += len(sweeps.LATE) * len(config.sweeps.late_percent) * len(study.deadline_solvers)
    trials = len(config.closed_loop.tasks) * config.closed_loop.seeds
    return {
        "open_loop": 2 * len(study.recommended), "testsets": 2 * len(study.settings), "growth": len(study.growing),
        "closed_loop": trials * (1 + len(study.recommended)), "sweeps": points, "duals": len(study.with_duals),
        "qpbenchmark": 1,
    }  # fmt: skip

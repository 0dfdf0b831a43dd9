"""The parts of the study in closed loop: every controller on the trials, the sweeps, and what open loop predicts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.solver_study import closed_loop, combine, compare, open_parts, sweeps
from benchmarks.solver_study.answers import recorded
from benchmarks.solver_study.cases import trials as draw_trials
from benchmarks.solver_study.cells import Cell
from benchmarks.solver_study.closed_loop import Asked, Run
from benchmarks.solver_study.config import ClosedLoop, Sweeps
from benchmarks.solver_study.study import Findings, Part, Study
from benchmarks.solver_study.sweeps import Sweep
from moc_opt.inputs.names import file_stem
from moc_opt.scenario import Scenario
from moc_opt.study.statistics import too_few
from moc_opt.study.trials import BASELINE, variant


def cases(study: Study, part: ClosedLoop | Sweeps) -> dict[str, Scenario]:
    """Return the trials of a part, by name."""
    config = study.config
    base = config.scenario.change(duration_s=part.duration_s)
    return draw_trials(base, config.closed_loop.tasks, config.seed, part.trials)


def controllers(study: Study, so_far: Findings) -> Findings:
    """Run every solver in the controller, and the baseline, on its trials."""
    part = study.config.closed_loop
    runs = closed_loop.run_all(
        study.run, cases(study, part), {s.solver: s.options for s in study.recommended}, trials_of=part.of,
        timed=part.timed, short=part.short, short_s=part.short_s, show=lambda runs: study.show(summaries(runs)),
    )  # fmt: skip
    return Findings(summaries(runs), runs=runs)


def summaries(runs: Sequence[Run]) -> dict[str, Any]:
    """Return the summary of the runs, and their values by trial; the latter of the short runs' ticks too."""
    found: dict[str, Any] = {"closed_loop": combine.summary(runs), "closed_loop_trials": combine.by_trial(runs)}
    if any(run.short for run in runs):
        found["closed_loop_beginning_trials"] = combine.by_trial([run.beginning for run in runs])
    return found


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
    # A sweep compares its points with each other: the best course, planned anew in every process, is left out.
    trials = {name: trial.change(best_courses=False) for name, trial in cases(study, study.config.sweeps).items()}
    known = _known(study, so_far)
    baselines = known.get(BASELINE, {})
    if not set(trials) <= set(baselines):
        asked = [Asked(BASELINE, variant(trial, BASELINE)) for trial in trials.values()]
        baselines = dict(zip(trials, closed_loop.run_each(study.run, asked), strict=True))
    chosen = [*chosen_sweeps(study), *_deadlines(study, trials, known)]
    default = {} if study.config.settings.get("exact") else known.get("exact", {})
    points = [(sweep, point) for sweep in chosen for point in sweep.points]
    closed_runs = sweeps.run_points(study.run, points, trials, default)
    data = recorded("recorded", so_far.sequence)
    accurate = [point.setting for _, point in points if point.setting is not None]
    parts = iter(study.ask([(setting, data) for setting in accurate], study.config.testsets.limits()))

    found = Findings()
    opened, closed = {}, {}
    for (sweep, point), runs in zip(points, closed_runs, strict=True):
        metrics = sweeps.figures(point, runs, [baselines[trial] for trial in trials])
        found.summary.setdefault(f"sweep {sweep.name}", {})[point.label] = metrics
        if point.setting is not None:
            cell = Cell(point.setting, data, next(parts))
            if not cell.refused:
                name = f"{sweep.name.partition('.')[0]} {point.label}{sweep.suffix}"
                opened[name], closed[name] = cell.summary(), metrics
    for name, metrics in so_far.summary.get("open_loop_warm", {}).items():
        mine = known.get(name, {})
        if set(trials) <= set(mine) and not any(run.short for run in mine.values()):
            opened[f"{name} as recommended"] = metrics
            closed[f"{name} as recommended"] = combine.combined([mine[trial] for trial in trials])
    found.add(prediction(opened, closed, len(trials)))
    if few := too_few(len(trials)):
        found.summary["cost_begins"] = {}
        found.words["cost_begins"] = f"From which setting on inaccuracy costs nothing: {few}."
        return found
    begins = {
        sweep.name: sweeps.beginning_of_cost(found.summary[f"sweep {sweep.name}"])
        for sweep in chosen
        if sweep.group == "accuracy"
    }
    found.summary["cost_begins"] = {name: begin for name, begin in begins.items() if begin}
    found.words["cost_begins"] = sweeps.begins_in_words(found.summary["cost_begins"], len(trials))
    return found


def _known(study: Study, so_far: Findings) -> dict[str, dict[str, Run]]:
    """Return controller -> trial -> its run in the part before, if that has trials of the same length."""
    found: dict[str, dict[str, Run]] = {}
    if study.config.sweeps.duration_s == study.config.closed_loop.duration_s:
        for run in so_far.runs:
            found.setdefault(run.controller, {})[run.trial] = run
    return found


def _deadlines(
    study: Study, trials: Mapping[str, Scenario], known: Mapping[str, Mapping[str, Run]]
) -> list[Sweep]:
    """Return sweeps over recorded times; a run with nothing beside it makes the recording, and it is kept as a file."""
    found, first = [], next(iter(trials.values()))
    for name in study.deadline_solvers:
        run = known.get(name, {}).get(first.name)
        if run is None or not run.timed or run.short:
            asked = Asked(name, variant(first, name, study.config.settings.get(name, {})), timed=True)
            (run,) = closed_loop.run_each(study.run, [asked])
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
    "open_loop": 9.0, "testsets": 35.0, "closed_loop": 110.0, "sweeps": 42.0, "growth": 5.0, "duals": 1.0,
    "qpbenchmark": 10.0,
}  # fmt: skip
"""That each part takes, roughly, on two cores: what it weighs in the time that is left."""
STAGES = {"open_loop": 3, "testsets": 2, "growth": 2, "sweeps": 2}
"""How many batches of jobs a part consists of, where it is more than one."""

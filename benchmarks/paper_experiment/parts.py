"""The parts of ``benchmarks.paper`` beside its trials, and what is made of all of them: summary and figures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.common.crew import run_parallel
from benchmarks.common.kept import Kept
from benchmarks.paper_experiment import ablation, figures, verdict
from benchmarks.paper_experiment import procedure as paper_procedure
from benchmarks.paper_experiment import swivel as paper_swivel
from benchmarks.paper_experiment.config import STREAM, Config
from benchmarks.paper_experiment.trials import BASELINES, Measurement, Outcome, seeds, trials
from moc_opt.trace.ending import Ending


def run_swivel(config: Config, advance: Any, kept: Kept) -> list[dict[str, Any]]:
    """Run the study of the starting swivel."""
    base = config.base(config.swivel.group)
    [(_, trial)] = trials(base, [config.swivel.task], seeds(config.seed, STREAM, 1))
    jobs = [(trial, start, config.best_solver) for start in paper_swivel.starts(trial, config.swivel.starts)]
    return run_parallel(paper_swivel.gain, jobs, config.processes, advance, kept)


def run_procedure(
    config: Config, out: Path, advance: Any, kept: Kept
) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Return (one row a task, accuracy of single pictures)."""
    rows = run_parallel(paper_procedure.perform, config.procedures(out), config.processes, advance, kept)
    accuracy = paper_procedure.accuracy(config.procedure, config.scenario.robot.name, config.seed)
    advance()
    return rows, accuracy


def run_ablation(config: Config, advance: Any, kept: Kept) -> tuple[list[Measurement], list[dict[str, Any]]]:
    """Return (every measurement, every run that broke off) of Table I with entries exchanged."""
    done = run_parallel(ablation.measure, config.ablation_jobs(), config.processes, advance, kept)
    return [m for found, _ in done for m in found], [entry for _, broken in done for entry in broken]


def summarise(
    config: Config, outcomes: Sequence[Outcome], swivel: list[dict[str, Any]]
) -> tuple[dict[str, Any], list[Measurement], list[dict[str, Any]]]:
    """Return (summary, every measurement, every run that broke off)."""
    found = [m for outcome in outcomes for m in outcome.measurements]
    broken = [entry for outcome in outcomes for entry in outcome.broken]
    summary: dict[str, Any] = {}
    for group in config.groups:
        summary[group] = {
            controller: {
                **verdict.intervals(found, group, controller),
                "broke_off": sum(e["group"] == group and e["controller"] == controller for e in broken),
                "oscillated": sum(
                    (m.group, m.controller, m.phase) == (group, controller, "whole")
                    and Ending.of(m.ended) is Ending.OSCILLATED
                    for m in found
                ),
            }
            for controller in (*BASELINES, *config.solvers)
        }
    each = [(group, solver) for group in config.groups for solver in config.solvers]
    summary["verdict"] = [row for pair in each for row in verdict.verdicts(found, *pair)]
    summary["phases"] = [row for pair in each for row in verdict.phase_changes(found, *pair)]
    summary["goals"] = verdict.goals(found, config.best, config.best_solver)
    if config.elsewhere is not None:
        summary["goals_elsewhere"] = verdict.goals(found, config.elsewhere, config.best_solver)
    summary["swivel"] = paper_swivel.summary(swivel)
    return summary, found, broken


def draw(config: Config, outcomes: Sequence[Outcome], swivel: list[dict[str, Any]]) -> dict[str, Any]:
    """Return every figure by its file's name."""
    drawn: dict[str, Any] = {}
    for group in config.groups:
        drawn |= figures.box_figures(outcomes, group, config.tasks)
        kept = [o for o in outcomes if o.traces and any(m.group == group for m in o.measurements)]
        if kept:
            drawn[f"trial-{group}"] = figures.trial_figure(kept[0].traces)
    drawn["swivel"] = figures.swivel_figure(swivel)
    return drawn

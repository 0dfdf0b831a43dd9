"""The paper's experiment in simulation, and which of its claims hold.

python -m benchmarks.paper [CONFIG.toml] [--out DIR] [--seed N] [--quick] [--json]

DCAC and MOC on three virtual tasks, five trials each, with the paper's parameters and with tuned ones, with its own and
with matched gains, with every one of its solvers; then the verdict on each claim, the goals, which entry of the paper's
Table I decides, and what the starting swivel decides. Several trials run at a time, so no time is reported: that is
what ``benchmarks.solvers`` is for.
"""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.common import cli
from benchmarks.common.crew import run_parallel
from benchmarks.paper_experiment import ablation, figures, look, report, verdict
from benchmarks.paper_experiment import procedure as paper_procedure
from benchmarks.paper_experiment import swivel as paper_swivel
from benchmarks.paper_experiment.config import STREAM, Config
from benchmarks.paper_experiment.first_screen import answer
from benchmarks.paper_experiment.trials import BASELINES, Measurement, Outcome, run_job, seeds, trials
from moc_opt.errors import BrowserError
from moc_opt.trace.ending import Ending


def run_swivel(config: Config, advance: Any) -> list[dict[str, Any]]:
    """Run the study of the starting swivel."""
    base = config.base(config.swivel.group)
    [(_, trial)] = trials(base, [config.swivel.task], seeds(config.seed, STREAM, 1))
    jobs = [(trial, start, config.best_solver) for start in paper_swivel.starts(trial, config.swivel.starts)]
    return run_parallel(paper_swivel.gain, jobs, config.processes, advance)


def run_procedure(config: Config, out: Path, advance: Any) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Return (one row a task, accuracy of single pictures)."""
    rows = run_parallel(paper_procedure.perform, config.procedures(out), config.processes, advance)
    accuracy = paper_procedure.accuracy(config.procedure, config.scenario.robot.name, config.seed)
    advance()
    return rows, accuracy


def run_ablation(config: Config, advance: Any) -> tuple[list[Measurement], list[dict[str, Any]]]:
    """Return (every measurement, every run that broke off) of Table I with entries exchanged."""
    done = run_parallel(ablation.measure, config.ablation_jobs(), config.processes, advance)
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


def experiment(given: Namespace) -> cli.Results:
    """Run every part; figures and the replay are written here, as the page refers to them."""
    config, out = Config.chosen(given, "paper"), given.out
    jobs = config.jobs()
    out.mkdir(parents=True, exist_ok=True)
    total = len(jobs) + len(config.ablation_jobs()) + config.swivel.starts + 1 + len(config.tasks) + 2
    with cli.steps("trials", total) as step:
        outcomes = run_parallel(run_job, jobs, config.processes, step)
        exchanged, failed = run_ablation(config, step)
        swivel = run_swivel(config, step)
        procedure, accuracy = run_procedure(config, out, step)
        looks = look.looks(config, outcomes)
        step()
    summary, found, broken = summarise(config, outcomes, swivel)
    summary["ablation"] = ablation.rows(config.ablation, exchanged)
    summary["procedure"] = paper_procedure.summary(procedure)
    summary["board_pictures"] = accuracy
    summary["courses"] = look.rows(looks)
    measured = [*(m.row() for m in found), *({**m.row(), "part": "ablation"} for m in exchanged)]
    environment = config.environment(given, timing=f"none: {config.processes} processes at a time shared the machine")
    drawn = draw(config, outcomes, swivel) | look.map_figures(looks)
    try:
        figures.save(drawn, out / "figures")
    except BrowserError as error:
        # The page has the figures all the same.
        environment["figures"] = f"not saved as files: {error}"
        print(environment["figures"], file=sys.stderr)
    groups = {name: group.about or name for name, group in config.groups.items()}
    best = (config.best, config.best_solver)
    first = answer(summary, list(groups), drawn)
    page = report.page(
        summary, groups, best, drawn, environment,
        look=lambda page: look.add_section(page, looks, out, config), first=first,
    )  # fmt: skip
    return cli.Results(
        summary, environment, rows=[*measured, *broken, *failed, *swivel, *procedure], page=page,
        files=["replay.html", "figures/"], answer=first,
    )  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the experiment; see `cli.run` for the exit status."""
    options = cli.parser("paper", "The paper's experiment, and which of its claims hold.")
    return cli.run(options, experiment, arguments)


if __name__ == "__main__":
    sys.exit(main())

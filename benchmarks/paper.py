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

from benchmarks.common import cli
from benchmarks.common.crew import run_parallel
from benchmarks.common.kept import Kept
from benchmarks.paper_experiment import ablation, figures, look, report
from benchmarks.paper_experiment import procedure as paper_procedure
from benchmarks.paper_experiment.config import Config
from benchmarks.paper_experiment.first_screen import answer
from benchmarks.paper_experiment.parts import draw, run_ablation, run_procedure, run_swivel, summarise
from benchmarks.paper_experiment.trials import run_job
from moc_opt.errors import BrowserError


def experiment(given: Namespace) -> cli.Results:
    """Run every part; figures and the replay are written here, as the page refers to them."""
    config, out = Config.chosen(given, "paper"), given.out
    jobs = config.jobs()
    out.mkdir(parents=True, exist_ok=True)
    kept = Kept(out / "jobs", config.model_dump(mode="json"))
    total = len(jobs) + len(config.ablation_jobs()) + config.swivel.starts + 1 + len(config.tasks) + 2
    with cli.steps("trials", total) as step:
        outcomes = run_parallel(run_job, jobs, config.processes, step, kept)
        exchanged, failed = run_ablation(config, step, kept)
        swivel = run_swivel(config, step, kept)
        procedure, accuracy = run_procedure(config, out, step, kept)
        looks = look.looks(config, outcomes)
        step()
    summary, found, broken = summarise(config, outcomes, swivel)
    summary["ablation"] = ablation.rows(config.ablation, exchanged)
    summary["procedure"] = paper_procedure.summary(procedure)
    summary["board_pictures"] = accuracy
    summary["courses"] = look.rows(looks)
    measured = [*(m.row() for m in found), *({**m.row(), "part": "ablation"} for m in exchanged)]
    timing = f"none: {config.processes} processes at a time shared the machine"
    environment = config.environment(given, timing=timing, jobs_of_an_earlier_run=kept.reused)
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
    return cli.run(options, experiment, arguments, cli.GOES_ON)


if __name__ == "__main__":
    sys.exit(main())

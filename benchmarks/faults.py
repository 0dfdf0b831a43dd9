"""Every fault under every controller: survived, or stopped safely?

python -m benchmarks.faults [CONFIG.toml] [--out DIR] [--seed N] [--quick] [--page]

--page also writes docs/reliability.md, and docs/reliability.json with the figures in it.
"""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Sequence
from typing import Any

from pydantic import Field, field_validator

from benchmarks.common import cli
from benchmarks.common.config import Configuration, runnable
from benchmarks.reliability.page import PAGE, answer, report, write_page
from benchmarks.reliability.runs import BASELINE, Case, Job, lost_job, run_job
from benchmarks.reliability.verdict import goals, summarise
from moc_opt.inputs.settings import Name
from moc_opt.scenario import Scenario
from moc_opt.study import Kept, each


class Config(Configuration):
    """benchmarks/configs/faults.toml."""

    trials: int = Field(2, ge=1)
    solvers: list[str] = Field(["exact", "osqp", "rnn"], min_length=1)
    processes: int = Field(2, ge=1)
    tip_limit_mm: float = Field(20.0, gt=0.0)
    rcm_limit_mm: float = Field(20.0, gt=0.0)
    scenario: Scenario = Scenario()
    cases: dict[Name, Case] = Field(min_length=1)

    @field_validator("scenario", mode="before")
    @classmethod
    def _validated(cls, value: Any) -> Any:
        return Scenario(**value) if isinstance(value, dict) else value

    @field_validator("cases")
    @classmethod
    def _fit_a_scenario(cls, cases: dict[str, Case]) -> dict[str, Case]:
        for case in cases.values():
            case.corrupt(Scenario())
        if "none" in cases:
            raise ValueError("'none' is the name of the run without a fault: choose another one")
        return cases

    def quick(self) -> Config:
        """Return the same faults on one trial of half the length."""
        short = self.scenario.change(duration_s=min(3.2, self.scenario.duration_s or 3.2))
        return self.model_copy(update={"trials": 1, "scenario": short})

    def jobs(self) -> list[Job]:
        """Return every controller on every trial; DCAC has no solver that could fail."""
        found, limits = [], (self.tip_limit_mm, self.rcm_limit_mm)
        sound = {name: case for name, case in self.cases.items() if case.group != "solver"}
        for trial in range(self.trials):
            base = self.scenario.change(seed=self.seed + trial)
            found.append(Job(BASELINE, trial, base.change(control=base.control.matched_dcac()), sound, limits))
            for name in self.solvers:
                solved = base.change(solver={"name": name, "settings": {}})
                found.append(Job(name, trial, solved, dict(self.cases), limits))
        return found


def inject(given: Namespace) -> cli.Results:
    """Inject every fault; with ``--page`` write docs/reliability.md."""
    config = Config.chosen(given, "faults")
    runnable(config.solvers)
    work, kept = config.jobs(), Kept(given.out / "jobs")
    with cli.steps("faults", len(work)) as step:
        outcomes = each(run_job, work, kept=kept, workers=config.processes, step=step, failed=lost_job)
    rows = [row for outcome in outcomes for row in outcome.rows]
    traces = {name: trace for outcome in outcomes for name, trace in outcome.traces.items()}
    cases = summarise(rows)
    reached = goals(config.cases, cases)
    environment = config.environment(given, jobs_of_an_earlier_run=kept.reused)
    if given.page:
        write_page({"cases": cases, "goals": reached, "environment": environment})
    first = answer(cases, reached, traces)
    summary = {**cases, "goals": {goal["goal"]: goal for goal in reached}}
    return cli.Results(summary, environment, rows, report(cases, first, environment), answer=first)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark; see `cli.run` for the exit status."""
    options = cli.parser("faults", "Inject every fault under every controller.")
    options.add_argument("--page", action="store_true", help=f"write {PAGE.parent.name}/{PAGE.name} as well")
    return cli.run(options, inject, arguments, cli.GOES_ON)


if __name__ == "__main__":
    sys.exit(main())

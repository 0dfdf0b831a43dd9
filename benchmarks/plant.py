"""What each defect of the arm costs, alone and together: calibration error, encoder bias, elastic joints, ripple.

python -m benchmarks.plant [CONFIG.toml] [--out DIR] [--seed N] [--quick] [--json] [--page]

Every trial is run under DCAC and MOC with the same gains, in the plant without these defects and with each of them;
--page also writes the table into docs/plant.md.
"""

from __future__ import annotations

import math
import sys
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from pydantic import Field

from benchmarks import cli, markdown, output
from benchmarks.config import Configuration
from benchmarks.crew import run_parallel
from benchmarks.paper_experiment.config import STREAM
from benchmarks.paper_experiment.trials import MATCHED, attempt, seeds, trials, variant
from moc_opt.comparison.statistics import mean
from moc_opt.report.tables import Column, Table
from moc_opt.scenario import Scenario
from moc_opt.sim.settings import PlantSettings
from moc_opt.trace.ending import Ending
from moc_opt.trace.metrics import summarize
from moc_opt.trace.trace import Trace

PAGE = Path(__file__).resolve().parent.parent / "docs" / "plant.md"

FIGURES = {
    "mu_gain_percent": Column("mu_gain_percent", "mu", unit="%", format="+.1f", help="above DCAC on the same trials"),
    "tip_error_mean_mm": Column("tip_error_mean_mm", "tip, absolute", unit="mm", format=".3f"),
    "tip_error_registered_mean_mm": Column("tip_error_registered_mean_mm", "tip, registered", unit="mm", format=".3f"),
    "tip_error_model_mean_mm": Column("tip_error_model_mean_mm", "tip, own kinematics", unit="mm", format=".3f"),
    "rcm_error_mean_mm": Column("rcm_error_mean_mm", "RCM, true", unit="mm", format=".3f"),
    "rcm_error_model_mean_mm": Column("rcm_error_model_mean_mm", "RCM, own kinematics", unit="mm", format=".3f"),
    "rcm_error_registered_mean_mm": Column("rcm_error_registered_mean_mm", "RCM, registered", unit="mm", format=".3f"),
    "trocar_force_mean_N": Column("trocar_force_mean_N", "force", unit="N", format=".3f"),
    "torque_rate_rms_Nm_per_s": Column("torque_rate_rms_Nm_per_s", "chatter", unit="Nm/s", format=".0f"),
}


class Config(Configuration):
    """benchmarks/configs/plant.toml."""

    tasks: list[str] = Field(["circle", "sinusoid", "spiral"], min_length=1)
    trials: int = Field(5, ge=1, description="per task")
    processes: int = Field(2, ge=1)
    presets: list[str] = Field(["tuned", "default"], min_length=1)
    solver: str = "exact"
    base: dict[str, Any] = Field(default_factory=dict, description="[plant], common to all effects")
    effects: dict[str, dict[str, Any]] = Field(default_factory=dict, min_length=1)
    scenario: Scenario = Scenario(judge=False, bound_samples=0)

    def plant(self, effect: str) -> PlantSettings:
        """Return the plant with one effect.

        Raises:
            MocOptError: a field that does not exist, or a value out of range.
        """
        return PlantSettings(**self.scenario.plant.model_dump() | self.base | self.effects[effect])

    def quick(self) -> Self:
        """Return the same on less data."""
        return self.model_copy(update={"tasks": self.tasks[:1], "trials": 2, "presets": self.presets[:1]})

    def jobs(self) -> list[Job]:
        """Return every effect on every trial under every preset."""
        drawn = seeds(self.seed, STREAM, self.trials * len(self.tasks))
        found = []
        for preset in self.presets:
            base = self.scenario.change(control={} if preset == "default" else {"preset": preset})
            for _, trial in trials(base, self.tasks, drawn):
                for effect in self.effects:
                    found.append(Job(preset, effect, self.solver, trial.change(plant=self.plant(effect).model_dump())))
        return found


@dataclass(frozen=True)
class Job:
    """One trial under DCAC and MOC in one plant."""

    preset: str
    effect: str
    solver: str
    trial: Scenario


def run_job(job: Job) -> list[dict[str, Any]]:
    """Return one row a controller; a run that breaks off is a row with its reason."""
    rows: list[dict[str, Any]] = []
    baseline: Trace | None = None
    for controller in (MATCHED, job.solver):
        row: dict[str, Any] = {
            "preset": job.preset, "effect": job.effect, "controller": controller, "trial": job.trial.name,
            "seed": job.trial.seed,
        }  # fmt: skip
        rows.append(row)
        trace, row["ended"] = attempt(variant, job.trial, controller)
        if trace is not None:
            baseline = trace if controller == MATCHED else baseline
            row |= measure(trace, None if controller == MATCHED else baseline)
    return rows


def measure(trace: Trace, baseline: Trace | None) -> dict[str, float]:
    """Return the figures of one run."""
    found = summarize(trace, baseline)
    return {name: found[name] for name in ("mu_mean", *FIGURES) if name in found}


def summarise(config: Config, rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Map preset to "effect, controller" -> runs, those that broke off, and each figure with its interval."""
    summary: dict[str, Any] = {}
    for preset in config.presets:
        summary[preset] = {}
        for effect in config.effects:
            for controller in (MATCHED, config.solver):
                mine = [r for r in rows if (r["preset"], r["effect"], r["controller"]) == (preset, effect, controller)]
                group: dict[str, Any] = {
                    "runs": len(mine), "broke_off": sum(not Ending.of(r["ended"]).whole for r in mine),
                }  # fmt: skip
                for name in FIGURES:
                    values = [r[name] for r in mine if name in r]
                    if values:
                        group |= mean(values).entries(name)
                summary[preset][f"{effect}, {controller}"] = group
    return summary


def tables(summary: dict[str, Any]) -> list[Table]:
    """Make one table a preset, means over the runs that were completed."""
    first = [Column("group", "effect, controller"), Column("broke_off", "broke off", format="d")]
    return [
        Table(f"Preset {preset}", [*first, *FIGURES.values()], [{"group": name, **row} for name, row in groups.items()])
        for preset, groups in summary.items()
    ]


def page_text(summary: dict[str, Any], config: Config) -> str:
    """Return the tables with their intervals, for docs/plant.md."""
    trials_run = config.trials * len(config.tasks)
    lines = [f"`python -m benchmarks.plant --page` (seed {config.seed}, {trials_run} trials; mean, 95 % interval):"]
    heads = ["effect", "law", *(f"{column.title} [{column.unit}]" for column in FIGURES.values()), "broke off"]
    for preset, groups in summary.items():
        rows = [
            [*name.rsplit(", ", 1), *(_cell(row, key) for key in FIGURES), f"{row['broke_off']}/{row['runs']}"]
            for name, row in groups.items()
        ]
        lines += ["", f"Preset `{preset}`:", "", markdown.table(heads, rows)]
    return "\n".join(lines)


def _cell(row: dict[str, Any], name: str) -> str:
    if name not in row:
        return ""
    spec = FIGURES[name].format
    low, high = row[f"{name}_low"], row[f"{name}_high"]
    if low is None or not math.isfinite(low) or name == "torque_rate_rms_Nm_per_s":
        return f"{row[name]:{spec}}"  # of a single trial there is no interval
    return f"{row[name]:{spec}} [{low:{spec}}, {high:{spec}}]"


def write_page(text: str, page: Path = PAGE) -> None:
    """Put the tables between the marks of docs/plant.md.

    Raises:
        SectionError: the page has no such marks.
    """
    new = markdown.fill_section(page.read_text(encoding="utf-8"), "plant", text, page)
    output.write_atomically(page, new.encode())


def study(given: Namespace) -> cli.Results:
    """Run every job; with ``--page`` write the tables into docs/plant.md."""
    config = Config.chosen(given, "plant")
    jobs = config.jobs()
    with cli.steps("plants", len(jobs)) as step:
        parts = run_parallel(run_job, jobs, config.processes, step)
    rows = [row for part in parts for row in part]
    summary = summarise(config, rows)
    if given.page:
        write_page(page_text(summary, config))
    return cli.Results(summary, config.environment(given), rows, tables=tables(summary))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark; see `cli.run` for the exit status."""
    options = cli.parser("plant", "What each defect of the arm costs.")
    options.add_argument("--page", action="store_true", help=f"write the table into {PAGE.parent.name}/{PAGE.name}")
    return cli.run(options, study, arguments)


if __name__ == "__main__":
    sys.exit(main())

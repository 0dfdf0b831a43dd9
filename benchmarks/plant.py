"""What each defect of the arm costs, alone and together: calibration error, encoder bias, elastic joints, ripple.

python -m benchmarks.plant [CONFIG.toml] [--out DIR] [--seed N] [--quick] [--json] [--page]

Every trial is run under DCAC and MOC with the same gains, in the plant without these defects and with each of them.
Then calibration errors of several sizes: from which on a moving elbow costs tip accuracy, and what registering again
leaves of it. --page also writes the tables into docs/plant.md.
"""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar, Self

from pydantic import Field

from benchmarks.common import cli
from benchmarks.common.config import Configuration
from benchmarks.common.markdown import write_section
from benchmarks.paper_experiment.trials import STREAM, seeds, trials
from benchmarks.plant_study import page
from benchmarks.plant_study.runs import KINDS, Job, lost_job, plant_of, run_job
from moc_opt.inputs.settings import Settings
from moc_opt.scenario import Scenario
from moc_opt.sim.settings import PlantSettings
from moc_opt.study import Kept, each

PAGE = Path(__file__).resolve().parents[1] / "docs" / "plant.md"
CALIBRATION_STREAM = 9
"""Of the seeds: no trial of the sweep is one of another study."""


class Sweep(Settings):
    """Sizes of the calibration error."""

    KIND: ClassVar[str] = "[calibration]"
    trials: int = Field(5, ge=1, description="per task")
    duration_s: float | None = Field(4.0, gt=0.0, description="of each run; None: all of it")
    sizes: list[float] = Field([0.05, 0.1, 0.2, 0.3, 0.5], description="beside 0: [mm] of origins, [mrad] of encoders")


class Config(Configuration):
    """benchmarks/configs/plant.toml."""

    tasks: list[str] = Field(["circle", "sinusoid", "spiral"], min_length=1)
    trials: int = Field(5, ge=1, description="per task")
    processes: int = Field(2, ge=1)
    presets: list[str] = Field(["tuned", "default"], min_length=1)
    solver: str = "exact"
    base: dict[str, Any] = Field(default_factory=dict, description="[plant], common to all effects")
    effects: dict[str, dict[str, Any]] = Field(default_factory=dict)
    calibration: Sweep = Sweep()
    scenario: Scenario = Scenario(judge=False, bound_samples=0)

    def quick(self) -> Self:
        """Return the same on less data."""
        sweep = self.calibration.model_copy(update={"trials": 2, "sizes": self.calibration.sizes[-1:]})
        less = {"tasks": self.tasks[:1], "trials": 2, "presets": self.presets[:1], "calibration": sweep}
        return self.model_copy(update=less)

    def plant(self, effect: str) -> PlantSettings:
        """Return the plant with one effect.

        Raises:
            MocOptError: a field that does not exist, or a value out of range.
        """
        return PlantSettings(**self.scenario.plant.model_dump() | self.base | self.effects[effect])

    def jobs(self) -> list[Job]:
        """Return every effect on every trial under every preset."""
        plants = [({"effect": effect}, self.plant(effect)) for effect in self.effects]
        return self._jobs("effects", self.scenario, plants, self.trials, STREAM)

    def calibration_jobs(self) -> list[Job]:
        """Return every size of every kind on every trial under every preset; size 0 once, as "both"."""
        sweep = self.calibration
        sizes = [("both", 0.0), *((kind, size) for kind in KINDS for size in sweep.sizes)]
        plants = [({"kind": kind, "size": size}, plant_of(self.scenario.plant, kind, size)) for kind, size in sizes]
        base = self.scenario.change(duration_s=sweep.duration_s)
        return self._jobs("calibration", base, plants, sweep.trials, CALIBRATION_STREAM)

    def _jobs(
        self, part: str, base: Scenario, plants: list[tuple[dict[str, Any], PlantSettings]], count: int, stream: int
    ) -> list[Job]:
        drawn = seeds(self.seed, stream, count * len(self.tasks))
        return [
            Job({"part": part, "preset": preset, **about}, self.solver, trial.change(plant=plant.model_dump()))
            for preset in self.presets
            for _, trial in trials(
                base.change(control={} if preset == "default" else {"preset": preset}), self.tasks, drawn
            )
            for about, plant in plants
        ]


def study(given: Namespace) -> cli.Results:
    """Run every job; with ``--page`` write the tables into docs/plant.md."""
    config = Config.chosen(given, "plant")
    jobs = [*config.jobs(), *config.calibration_jobs()]
    kept = Kept(given.out / "jobs")
    with cli.steps("plants", len(jobs)) as step:
        done = each(run_job, jobs, kept=kept, workers=config.processes, step=step, failed=lost_job)
    rows = [row for of_job in done for row in of_job]
    effects = page.effects_summary([row for row in rows if row["part"] == "effects"])
    sweep = page.sweep_summary([row for row in rows if row["part"] == "calibration"], config.solver)
    if given.page:
        write_section(PAGE, "plant", page.effects_markdown(effects, config.seed))
        write_section(PAGE, "calibration", page.sweep_markdown(sweep, config.seed))
    environment = config.environment(given, jobs_of_an_earlier_run=kept.reused)
    first, tables = page.answer(sweep), page.effects_tables(effects)
    summary = {**effects, "calibration": sweep, "break_even": page.break_evens(sweep)}
    return cli.Results(
        summary, environment, rows, page.page(sweep, first, tables, environment), tables=tables, answer=first
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark; see `cli.run` for the exit status."""
    options = cli.parser("plant", "What each defect of the arm costs.")
    options.add_argument("--page", action="store_true", help="write the tables into docs/plant.md")
    return cli.run(options, study, arguments, cli.GOES_ON)


if __name__ == "__main__":
    sys.exit(main())

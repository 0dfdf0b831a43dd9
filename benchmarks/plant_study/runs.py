"""The runs of ``python -m benchmarks.plant``: every trial under DCAC and MOC, in plants with one defect each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

from pydantic import Field

from benchmarks.common.config import Configuration
from benchmarks.paper_experiment.config import STREAM
from benchmarks.paper_experiment.trials import MATCHED, attempt, seeds, trials, variant
from moc_opt.report.tables import Column
from moc_opt.scenario import Scenario
from moc_opt.sim.settings import PlantSettings
from moc_opt.trace.metrics import summarize
from moc_opt.trace.trace import Trace

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

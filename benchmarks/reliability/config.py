"""Which faults are injected, into which runs: benchmarks/configs/faults.toml."""

from __future__ import annotations

from typing import Any, ClassVar, Literal, Self

from pydantic import Field, field_validator, model_validator

from benchmarks.common.config import Configuration
from moc_opt.inputs.settings import Name, Settings
from moc_opt.scenario import Scenario

BASELINE = "dcac"


class Case(Settings):
    """One fault: what it changes in a scenario, and when it acts."""

    KIND: ClassVar[str] = "[cases]"
    group: Literal["solver", "sensors", "plant", "contact", "camera"]
    faults: dict[str, Any] = Field(default_factory=dict)
    plant: dict[str, Any] = Field(default_factory=dict)
    trocar: dict[str, Any] = Field(default_factory=dict)
    camera_lost_s: tuple[float, float] | None = Field(
        None, description="the board is out of sight from .. until; the tip waits meanwhile"
    )
    from_s: float = Field(0.0, ge=0.0)
    until_s: float | None = Field(None, ge=0.0, description="None: it lasts")

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.until_s is not None and self.until_s < self.from_s:
            raise ValueError(f"until_s = {self.until_s} is before from_s = {self.from_s}: exchange them")
        return self

    def corrupt(self, scenario: Scenario) -> Scenario:
        """Return the scenario with this fault in it."""
        return scenario.change(faults=self.faults, plant=self.plant, trocar=self.trocar)


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
        """Return the same faults on one trial of half the length: for a first look and for the tests."""
        short = self.scenario.change(duration_s=min(3.2, self.scenario.duration_s or 3.2))
        return self.model_copy(update={"trials": 1, "scenario": short})

"""The space that ``benchmarks.tune`` draws its candidates from: benchmarks/configs/tune.toml, validated."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from pydantic import Field, model_validator

from benchmarks.common.config import Configuration
from moc_opt.inputs.settings import Settings
from moc_opt.scenario import Scenario

NEAR = 0.1  # spread of local candidates, in parts of a range
Values = Mapping[str, float]


class Range(Settings):
    """Where one parameter may lie: between two numbers, or one of some choices."""

    KIND: ClassVar[str] = "[space]"
    low: float = 0.0
    high: float = 1.0
    log: bool = False
    choices: list[bool | float] | None = Field(None, min_length=1)

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if not self.low < self.high or (self.log and self.low <= 0.0):
            raise ValueError(f"low = {self.low}, high = {self.high}: give low < high, and above 0 where log is true")
        return self

    def at(self, place: float) -> float | bool:
        """Return the value at a place in [0, 1], to three significant digits: a preset is read by people."""
        if self.choices is not None:
            return self.choices[min(int(place * len(self.choices)), len(self.choices) - 1)]
        if self.log:
            value = math.exp(math.log(self.low) + place * (math.log(self.high) - math.log(self.low)))
        else:
            value = self.low + place * (self.high - self.low)
        return float(f"{value:.3g}")


class Config(Configuration):
    """benchmarks/configs/tune.toml."""

    tasks: list[str] = Field(["circle", "sinusoid", "spiral"], min_length=1)
    random: int = Field(60, ge=1)
    local: int = Field(40, ge=0)
    finalists: int = Field(6, ge=1)
    trials: int = Field(2, ge=2)
    final_trials: int = Field(5, ge=2)
    processes: int = Field(2, ge=1)
    space: dict[str, Range]
    hard: dict[str, Any] = Field(default_factory=dict)
    scenario: Scenario = Scenario(judge=False, bound_samples=0)

    def quick(self) -> Config:
        """Return the same search with few candidates: for a first look and for the tests."""
        few = {"random": 3, "local": 1, "finalists": 2, "trials": 2, "final_trials": 2, "tasks": self.tasks[:1]}
        return self.model_copy(update=few)


@dataclass(frozen=True)
class Candidate:
    """Places in [0, 1], one a parameter, and what they mean."""

    places: tuple[float, ...]
    values: Values

    @property
    def control(self) -> dict[str, Any]:
        """Return it as a table of control settings."""
        table: dict[str, Any] = {"gains": "default", **self.values}
        if "rho_over_c2" in table:
            table["regularization"] = float(f"{table.pop('rho_over_c2') * 1e-3:.3g}")
        return table


def draw(config: Config, rng: np.random.Generator, near: Sequence[Candidate] = ()) -> Candidate:
    """Draw a candidate from the whole space, or near one of some others."""
    size = len(config.space)
    if near:
        centre = np.array(near[int(rng.integers(len(near)))].places)
        places = np.clip(centre + NEAR * rng.standard_normal(size), 0.0, 1.0)
    else:
        places = rng.uniform(0.0, 1.0, size)
    drawn = tuple(float(place) for place in places)
    values = {name: span.at(place) for (name, span), place in zip(config.space.items(), drawn, strict=True)}
    return Candidate(drawn, values)

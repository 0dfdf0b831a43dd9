"""Which entry of Table I decides: the third level against matched DCAC, with entries exchanged one at a time.

A case is the paper's parameters with some of them exchanged, on both sides of the comparison. Every case runs the
same trials, at several seeds of the experiment. The first case is the table as printed; the ``shift`` of another is
its effect less that of the first, in percentage points, resampled over the trials that both have. ``RULE`` says which
case decides.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from pydantic import Field

from benchmarks.experiment.trials import MATCHED, Measurement, trials, variant
from benchmarks.experiment.trials import seeds as seeds_of
from benchmarks.experiment.verdict import CLAIMS, Claim, effect, pairs
from benchmarks.statistics import difference_of_changes
from moc_opt import scenario
from moc_opt.control import ControlSettings
from moc_opt.errors import MocOptError, UnknownNameError
from moc_opt.metrics import summarize
from moc_opt.scenario import Scenario
from moc_opt.settings import Settings

ALL = "all"
RULE = (
    "A case decides on a claim where its effect lies on the other side of the claim's bound than that of the first "
    "case, and the 95 % interval of the difference of the two effects leaves out zero, over the trials of all seeds."
)


class Case(Settings):
    """Table I with some entries exchanged."""

    KIND: ClassVar[str] = "[ablation.cases.*]"
    about: str = ""
    control: dict[str, Any] = Field(default_factory=dict, description="what is exchanged")
    without: list[str] = Field(default_factory=list, description="settings put back to the package's default")
    controller: str = Field("exact", description="a solver of the third level, or 'dcac-damped'")


class Ablation(Settings):
    """The cases, the first of which is the table as printed; none: the ablation is left out."""

    KIND: ClassVar[str] = "[ablation]"
    group: str = Field("paper", description="whose parameters and trials")
    draws: int = Field(3, ge=1, description="seeds of the experiment: its own and those after it")
    cases: dict[str, Case] = Field(default_factory=dict)

    def quick(self) -> Ablation:
        """The first two cases at one seed."""
        return self.model_copy(update={"draws": 1, "cases": dict(list(self.cases.items())[:2])})


@dataclass(frozen=True)
class AblationJob:
    """One trial of one case, under DCAC and under the case's controller."""

    case: str
    seed: int
    task: str
    trial: Scenario
    controller: str


def changed(base: Scenario, case: Case) -> Scenario:
    """The scenario that a case's trials share.

    Raises:
        UnknownNameError: a setting that does not exist.
        MocOptError: a value out of range.
    """
    for name in case.without:
        if name not in ControlSettings.model_fields:
            raise UnknownNameError("[ablation.cases.*] without", name, ControlSettings.model_fields)
    defaults = {name: getattr(ControlSettings(), name) for name in case.without}
    return base.change(control={**case.control, **defaults}, bound_samples=0)


def jobs(
    ablation: Ablation, base: Scenario, tasks: Sequence[str], per_task: int, seed: int, stream: int
) -> list[AblationJob]:
    """Every case on every trial of every draw."""
    found = []
    for name, case in ablation.cases.items():
        shared = changed(base, case)
        for draw in range(seed, seed + ablation.draws):
            for task, trial in trials(shared, tasks, seeds_of(draw, stream, per_task * len(tasks))):
                named = trial.change(name=f"{draw}/{trial.name}")
                found.append(AblationJob(name, draw, task, named, case.controller))
    return found


def measure(job: AblationJob) -> tuple[list[Measurement], list[dict[str, Any]]]:
    """The claims' metrics of both controllers over the whole trial, and why a run broke off."""
    found, broken = [], []
    for controller in (MATCHED, job.controller):
        given: dict[str, Any] = {"task": job.task, "trial": job.trial.name, "seed": job.trial.seed}
        try:
            trace = scenario.run(variant(job.trial, controller))
        except MocOptError as error:
            reason = f"{type(error).__name__}: {error}"
        else:
            reason = str(trace.meta.get("ended", "completed"))
            if reason == "completed":
                metrics = summarize(trace)
                kept = {claim.metric: metrics[claim.metric] for claim in CLAIMS}
                found.append(
                    Measurement(
                        job.case, controller, phase="whole", window_of="", metrics=kept, **given
                    )
                )
                continue
        row = {"part": "ablation broke off", "group": job.case, "controller": controller, **given}
        broken.append({**row, "error": reason})
    return found, broken


def rows(ablation: Ablation, found: Sequence[Measurement]) -> list[dict[str, Any]]:
    """One row a case, draw and claim: the effect with its interval; over all draws also shift and ``decides``."""
    table: list[dict[str, Any]] = []
    by_draw: dict[str, list[Measurement]] = {}
    for m in found:
        by_draw.setdefault(m.trial.split("/")[0], []).append(m)
    draws: Mapping[str, Sequence[Measurement]] = {**by_draw, ALL: found}
    printed = next(iter(ablation.cases), "")
    for name, case in ablation.cases.items():
        for draw, mine in draws.items():
            for claim in CLAIMS:
                change = effect(mine, name, case.controller, MATCHED, claim.metric)
                if change is None:
                    continue
                row = {
                    "case": name, "about": case.about, "draw": draw, "claim": claim.name, "trials": change.samples,
                    "confirmed": claim.confirmed(change), **change.entries("effect_percent"),
                }  # fmt: skip
                if draw == ALL and name != printed:
                    row |= _against_printed(ablation, found, name, claim)
                table.append(row)
    return table


def _against_printed(
    ablation: Ablation, found: Sequence[Measurement], name: str, claim: Claim
) -> dict[str, Any]:
    """Shift of a case from the first, over the trials in which all four runs came to their end, and ``decides``."""
    first = next(iter(ablation.cases))
    asked = [(case, ablation.cases[case].controller) for case in (name, first)]
    ends = [
        {m.trial for m in found if (m.group, m.controller) == (case, controller)}
        for case, moc in asked
        for controller in (moc, MATCHED)
    ]
    mine = [m for m in found if m.trial in set.intersection(*ends)]
    here, there = (pairs(mine, case, controller, MATCHED, claim.metric) for case, controller in asked)
    if not here[0]:
        return {}
    shift = difference_of_changes(*here, *there)
    beyond = [100.0 * (sum(a) / sum(b) - 1.0) > claim.bound_percent for a, b in (here, there)]
    return {**shift.entries("shift_percent"), "decides": beyond[0] != beyond[1] and shift.low * shift.high > 0.0}


def headline(table: Sequence[Mapping[str, Any]]) -> list[str]:
    """Which entries decide, in words, from the rows over all draws."""
    over_all = [row for row in table if row["draw"] == ALL]
    if not over_all:
        return []
    deciding: dict[str, list[str]] = {}
    for row in over_all:
        if row.get("decides"):
            deciding.setdefault(row["about"], []).append(row["claim"])
    held = [row["claim"] for row in over_all if row["case"] == over_all[0]["case"] and row["confirmed"]]
    sentence = f"Table I as printed, against matched DCAC over all draws: {', '.join(held) or 'no claim'} confirmed."
    parts = [f"{about} ({', '.join(claims)})" for about, claims in deciding.items()]
    return [sentence, f"What decides on a claim: {'; '.join(parts) or 'no exchange'}."]

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

from benchmarks.paper_experiment.trials import MATCHED, Measurement, attempt, trials, variant
from benchmarks.paper_experiment.trials import seeds as seeds_of
from benchmarks.paper_experiment.verdict import CLAIMS, Claim, effect, pairs
from moc_opt.comparison.statistics import difference_of_changes
from moc_opt.control import ControlSettings
from moc_opt.errors import UnknownNameError
from moc_opt.inputs.settings import Settings
from moc_opt.scenario import Scenario
from moc_opt.trace.metrics import summarize

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
        """Return the first two cases at one seed."""
        return self.model_copy(update={"draws": 1, "cases": dict(list(self.cases.items())[:2])})


@dataclass(frozen=True)
class AblationJob:
    """One trial under every case: case -> (the trial with what the case exchanges, its controller)."""

    task: str
    cases: Mapping[str, tuple[Scenario, str]]


def changed(base: Scenario, case: Case) -> Scenario:
    """Return the scenario that a case's trials share.

    Raises:
        UnknownNameError: a setting that does not exist.
        MocOptError: a value out of range.
    """
    for name in case.without:
        if ControlSettings.FORMER.get(name, name) not in ControlSettings.model_fields:
            raise UnknownNameError("[ablation.cases.*] without", name, ControlSettings.model_fields)
    defaults = {name: getattr(ControlSettings(), name) for name in case.without}
    named = ControlSettings.present_names
    return base.change(control={**named(case.control), **named(defaults)}, bound_samples=0)


def jobs(
    ablation: Ablation, base: Scenario, tasks: Sequence[str], per_task: int, seed: int, stream: int
) -> list[AblationJob]:
    """Return every trial of every draw, each under all cases."""
    shared = {name: changed(base, case) for name, case in ablation.cases.items()}
    found = []
    for draw in range(seed, seed + ablation.draws):
        drawn = seeds_of(draw, stream, per_task * len(tasks))
        of_cases = {name: trials(scene, tasks, drawn) for name, scene in shared.items()}
        for k in range(len(drawn)):
            cases = {}
            for name, case in ablation.cases.items():
                task, trial = of_cases[name][k]
                cases[name] = (trial.change(name=f"{draw}/{trial.name}"), case.controller)
            found.append(AblationJob(task, cases))
    return found


def measure(job: AblationJob) -> tuple[list[Measurement], list[dict[str, Any]]]:
    """Return the claims' metrics of both controllers of each case over the whole trial, and why a run broke off."""
    found, broken = [], []
    # DCAC knows no third level: cases that differ there only have the same baseline.
    baselines: dict[str, dict[str, float] | str] = {}
    for case, (trial, controller) in job.cases.items():
        matched = variant(trial, MATCHED).change(control={"K_N2": None, "D_N2": None})
        same = matched.model_dump_json()
        if same not in baselines:
            baselines[same] = _metrics(matched)
        for name, done in ((MATCHED, baselines[same]), (controller, _metrics(variant(trial, controller)))):
            if isinstance(done, str):
                broken.append(
                    {
                        "part": "ablation broke off", "group": case, "controller": name, "task": job.task,
                        "trial": trial.name, "seed": trial.seed, "error": done,
                    }
                )  # fmt: skip
            else:
                found.append(Measurement(case, name, job.task, trial.name, trial.seed, phase="whole", metrics=done))
    return found, broken


def _metrics(case: Scenario) -> dict[str, float] | str:
    """Return the claims' metrics of one run, or why it broke off."""
    trace, ended = attempt(lambda: case)
    if trace is None:
        return ended
    metrics = summarize(trace)
    return {claim.metric: metrics[claim.metric] for claim in CLAIMS}


def rows(ablation: Ablation, found: Sequence[Measurement]) -> list[dict[str, Any]]:
    """Make one row a case, draw and claim: the effect with its interval; over all draws also shift and ``decides``."""
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
                    "case": name, "about": case.about, "controller": case.controller, "draw": draw,
                    "claim": claim.name, "trials": change.samples, "confirmed": claim.confirmed(change),
                    **change.entries("effect_percent"),
                }  # fmt: skip
                if draw == ALL and name != printed:
                    row |= _against_printed(ablation, found, name, claim)
                table.append(row)
    return table


def _against_printed(ablation: Ablation, found: Sequence[Measurement], name: str, claim: Claim) -> dict[str, Any]:
    """Compute the shift of a case from the first, over the trials with four whole runs, and ``decides``."""
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
    """Return which entries decide, in words, from the rows over all draws; cases of another controller are left out."""
    over_all = [row for row in table if row["draw"] == ALL]
    if not over_all:
        return []
    deciding: dict[str, list[str]] = {}
    for row in over_all:
        if row.get("decides") and row["controller"] == over_all[0]["controller"]:
            deciding.setdefault(row["about"], []).append(row["claim"])
    held = [row["claim"] for row in over_all if row["case"] == over_all[0]["case"] and row["confirmed"]]
    sentence = f"Table I as printed, against matched DCAC over all draws: {', '.join(held) or 'no claim'} confirmed."
    parts = [f"{about} ({', '.join(claims)})" for about, claims in deciding.items()]
    return [sentence, f"Replacements in Table I that turn a claim: {'; '.join(parts) or 'no exchange'}."]

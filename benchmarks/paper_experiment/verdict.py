"""Which of the paper's claims hold, and which goals are reached: computed from the trials, never written by hand.

An effect is the change of MOC against a DCAC on the same trials, 100 (mean MOC / mean DCAC - 1), with the 95 %
bootstrap interval over the pairs, and beside it the mean of the trials' own ratios (`statistics.Change`). A claim is
confirmed against one DCAC when both intervals lie on its side:

- **holds**: confirmed against DCAC with MOC's own gains (and compensation), where only the third level differs;
- **undecided**: against that DCAC the two means disagree;
- **holds only against softer gains**: confirmed against DCAC with its own gains, as the paper compares, and not
  against the matched one;
- **does not hold**: confirmed against neither, or only against DCAC with other gains than it is compared with.

Fewer than `LEAST_TRIALS` trials decide nothing: the verdict says so. In a phase the trials count by their ticks.

Errors of tip and RCM stand in three frames side by side (`FRAMES`): the controller can answer for the first alone, and
what a moving elbow costs an arm with calibration errors shows in the second. The force at the trocar follows the RCM
error and is no further claim. A goal about a mean is reached when the end of its interval is, not the mean alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from pydantic import Field

from benchmarks.paper_experiment.trials import BASELINES, DAMPED, MATCHED, OWN, Measurement
from moc_opt.inputs.settings import Settings
from moc_opt.study.statistics import (
    Change,
    Interval,
    StatisticsError,
    difference_of_changes,
    mean,
    relative_changes,
    spread,
    too_few,
)
from moc_opt.trace.meta import Ending
from moc_opt.trace.metrics import PHASES

HOLDS, GAINS_ONLY, FAILS, UNDECIDED = "holds", "holds only against softer gains", "does not hold", "undecided"
REPEATS = "follows the RCM error: not counted"  # in place of a verdict


@dataclass(frozen=True)
class Claim:
    """A claim of the paper: the change of a metric is beyond a bound, upwards or downwards."""

    name: str
    title: str
    text: str
    metric: str
    bound_percent: float = 0.0
    upwards: bool = False

    def confirmed(self, effect: Change) -> bool:
        """Tell whether both whole intervals lie beyond the bound, of trials enough to decide."""
        return effect.side(self.bound_percent) == (1 if self.upwards else -1)


CLAIMS = (
    Claim("mu", "mu", "manipulability rises by more than 7 %", "mu_mean", 7.0, upwards=True),
    Claim("tip", "tip, own", "tip accuracy is better", "tip_error_model_mean_mm"),
    Claim("rcm", "RCM, own", "the RCM error is smaller", "rcm_error_model_mean_mm"),
)
"""By the robot's own kinematics from the registered trocar, as the paper measured them."""
BESIDE = (
    Claim("tip_registered", "tip, registered", "the tip is nearer to its path in the patient",
          "tip_error_registered_mean_mm"),
    Claim("rcm_registered", "RCM, registered", "the shaft is nearer to the incision in the patient",
          "rcm_error_registered_mean_mm"),
    Claim("tip_true", "tip, base", "the tip is nearer to its path in the base frame", "tip_error_mean_mm"),
    Claim("rcm_true", "RCM, base", "the RCM error is smaller (true trocar)", "rcm_error_mean_mm"),
)  # fmt: skip
"""The same in the frame that was registered by touch, where calibration errors count, and in that of the base."""
REPEATED = Claim("force", "force", "the contact force is smaller", "trocar_force_mean_N")
EVERY = (*CLAIMS, *BESIDE, REPEATED)
FRAMES = {"": "own kinematics", "_registered": "registered", "_true": "base frame"}
"""End of a claim's name -> the frame of its error."""
ABOUT_FRAMES = (
    "Own kinematics: what the controller can see and answer for. Registered, the frame that was touched at the start: "
    "what the patient sees. Base frame: absolute accuracy, for whoever registers elsewhere, as by a tracker."
)
# Upper ends of the means' intervals [mm], None: no goal; 0.3 mm of the 0.5 are the error of a registration that is
# 0.5 mm off.
LIMITS: Mapping[str, float | None] = {
    "tip": 0.1, "tip_registered": 0.1, "tip_true": None, "rcm": 0.2, "rcm_registered": 0.2, "rcm_true": 0.5,
}  # fmt: skip
LEAST_GAIN_PERCENT, MOST_CHANGE_PERCENT = 15.0, 5.0


def pairs(
    found: Sequence[Measurement], group: str, moc: str, baseline: str, metric: str, phase: str = "whole"
) -> tuple[list[float], list[float]]:
    """Return one number a trial for the MOC and for the baseline, the trials that have both, in the same order.

    In a phase the number is the sum over its ticks: else a trial that is steady for a moment only would count as
    much as one that is for seconds.
    """

    def by_trial(controller: str) -> dict[str, float]:
        return {
            m.trial: m.metrics[metric] * (m.metrics["ticks"] if phase in PHASES else 1.0)
            for m in found
            if (m.group, m.controller, m.phase) == (group, controller, phase) and metric in m.metrics
        }

    ours, theirs = by_trial(moc), by_trial(baseline)
    both = [trial for trial in ours if trial in theirs]
    return [ours[trial] for trial in both], [theirs[trial] for trial in both]


def effect(
    found: Sequence[Measurement], group: str, moc: str, baseline: str, metric: str, phase: str = "whole"
) -> Change | None:
    """Return the change of MOC against a baseline [percent]; None where no trial has both."""
    try:
        return relative_changes(*pairs(found, group, moc, baseline, metric, phase))
    except StatisticsError:
        return None


def claim_verdict(claim: Claim, own: Change | None, matched: Change | None) -> str:
    """Return the verdict, from the effects against DCAC with its own gains and with MOC's."""
    few = too_few(0 if matched is None else matched.ratio.samples)
    if few is not None or matched is None:
        return few or FAILS
    if claim.confirmed(matched):
        return HOLDS
    if disagree(matched, claim.bound_percent):
        return UNDECIDED
    if own is None:
        return FAILS
    return too_few(own.ratio.samples) or (GAINS_ONLY if claim.confirmed(own) else FAILS)


def disagree(change: Change, bound: float) -> bool:
    """Tell whether the two means of a change lie on different sides of a bound [percent], by value or by interval."""
    sides = {(one.low > bound, one.high < bound) for one in change}
    return len(sides) > 1 or (change.ratio.value > bound) != (change.ratios.value > bound)


def verdicts(found: Sequence[Measurement], group: str, moc: str) -> list[dict[str, Any]]:
    """Make one row a claim: verdict, effect against each DCAC with its interval; then what is reported beside."""
    rows = []
    for claim in EVERY:
        effects = {name: effect(found, group, moc, name, claim.metric) for name in BASELINES}
        row: dict[str, Any] = {
            "group": group, "controller": moc, "claim": claim.name, "text": claim.text,
            "verdict": claim_verdict(claim, effects[OWN], effects[MATCHED]) if claim is not REPEATED else REPEATS,
        }  # fmt: skip
        for name, key in ((OWN, "own"), (MATCHED, "matched"), (DAMPED, "damped")):
            change = effects[name]
            if change is not None:
                row |= change.entries(f"{key}_percent")
        rows.append(row)
    return rows


def goals(found: Sequence[Measurement], group: str, moc: str) -> list[dict[str, Any]]:
    """Return what the best MOC should reach, against DCAC with the same gains and compensation, and what it reaches.

    ``reached`` is None where that is open, ``open`` says why then: too few trials, means that disagree, or no goal.
    """
    rows: list[dict[str, Any]] = []

    def add(name: str, text: str, figure: Change | Interval | None, limit: float | None, up: bool) -> None:
        one = figure.ratio if isinstance(figure, Change) else figure
        why = "no goal" if limit is None else too_few(one.samples if one else 0) or ""
        reached = None
        if not why and one is not None and limit is not None:
            if isinstance(figure, Change):
                why = UNDECIDED if disagree(figure, limit) else ""
                reached = figure.side(limit) == (1 if up else -1)
            else:
                reached = one.value >= limit if up else one.high <= limit
        row = {"goal": name, "text": text, "limit": limit, "trials": one.samples if one else 0, "open": why}
        rows.append(row | {"reached": None if why else reached} | (figure.entries("value") if figure else {}))

    whole = of_phase(found, group, moc)
    gain = effect(found, group, moc, MATCHED, "mu_mean")
    add("mu_gain", "gain in mean mu [%], lower end at least", gain, LEAST_GAIN_PERCENT, up=True)
    known = [m.metrics["mu_gain_percent"] for m in whole if "mu_gain_percent" in m.metrics]
    least = Interval(min(known), float("nan"), float("nan"), len(known)) if known else None
    add("mu_worst", f"smallest gain of {len(known)} trials [%], at least", least, 0.0, up=True)
    metrics = {claim.name: claim.metric for claim in EVERY}
    errors = [(part, words, end) for part, words in (("tip", "tip error"), ("rcm", "RCM error")) for end in FRAMES]
    for part, words, end in errors:
        change = effect(found, group, moc, MATCHED, metrics[part + end], "settled")
        add(f"settled_{part}{end}", f"steady: change of {words}, {FRAMES[end]} [%], upper end at most", change,
            MOST_CHANGE_PERCENT, up=False)  # fmt: skip
    for part, words, end in errors:
        values = [m.metrics[metrics[part + end]] for m in whole]
        add(f"{part}{end}_mean", f"mean {words}, {FRAMES[end]} [mm], upper end at most",
            mean(values) if values else None, LIMITS[part + end], up=False)  # fmt: skip
    return rows


def in_words(goal: Mapping[str, Any]) -> str:
    """Return "yes" or "no" of a goal, or why that is open; of a smallest gain also by how much it falls short."""
    if goal["reached"] is None:
        return str(goal["open"])
    short = goal["goal"] == "mu_worst" and not goal["reached"]
    return "yes" if goal["reached"] else f"no, by {goal['limit'] - goal['value']:.2g}" if short else "no"


def goal_value(goal: Mapping[str, Any]) -> str | None:
    """Return what was found of a goal with its interval, by both means where they disagree about the limit."""
    said = spread(goal, "value")
    both = said is not None and goal["open"] == UNDECIDED and not goal.get("value_undecided")
    return f"{said} (mean of ratios {spread(goal, 'value_of_ratios')})" if both else said


def counted(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return "9 of 13 goals are reached", with how many are open; or the words for too few trials."""
    asked = [row for row in rows if row["limit"] is not None]
    few = [str(row["open"]) for row in asked if row["open"] not in ("", UNDECIDED)]
    if len(few) == len(asked):
        return few[0]
    undecided = sum(row["reached"] is None for row in asked)
    said = f"{sum(bool(row['reached']) for row in asked)} of {len(asked)} goals are reached"
    return said + (f", {undecided} open" if undecided else "")


def phase_changes(found: Sequence[Measurement], group: str, moc: str) -> list[dict[str, Any]]:
    """Return what the travelling elbow costs: share of the ticks, and the change of each error, by phase."""
    rows = []
    for phase in PHASES:
        mine = of_phase(found, group, moc, phase)
        if not mine:
            continue
        ticks = [m.metrics["ticks"] for m in mine]
        row: dict[str, Any] = {
            "group": group, "controller": moc, "phase": phase, "trials": len(mine), "ticks": sum(ticks),
            "share_of_ticks": float(np.mean([m.metrics["share_of_ticks"] for m in mine])),
        }  # fmt: skip
        for claim in EVERY:
            row[claim.metric] = float(np.average([m.metrics[claim.metric] for m in mine], weights=ticks))
            change = effect(found, group, moc, MATCHED, claim.metric, phase)
            row |= change.entries(f"{claim.name}_change_percent") if change else {}
        rows.append(row)
    return rows


def group_summary(
    found: Sequence[Measurement], broken: Sequence[Mapping[str, Any]], group: str, controllers: Sequence[str]
) -> dict[str, dict[str, float]]:
    """Map controller to every metric's mean over the trials, and to how many of its runs broke off or oscillated.

    Those of the claims have intervals; the gain is that of the means.
    """
    summary, of_claims = {}, {claim.metric for claim in EVERY}
    for controller in controllers:
        mine = of_phase(found, group, controller)
        values = {
            "trials": float(len(mine)),
            "broke_off": sum((row["group"], row["controller"]) == (group, controller) for row in broken),
            "oscillated": sum(Ending.of(m.ended) is Ending.OSCILLATED for m in mine),
        }
        for metric in dict.fromkeys(name for m in mine for name in m.metrics):
            data = [m.metrics[metric] for m in mine if metric in m.metrics]
            if metric == "mu_gain_percent":
                gain = effect(found, group, controller, MATCHED, "mu_mean")
                values |= {} if gain is None else gain.entries(metric)
            elif metric in of_claims:
                values |= mean(data).entries(metric)
            else:
                values[metric] = float(max(data) if "_max" in metric else np.mean(data))
        summary[controller] = values
    return summary


def of_phase(
    found: Sequence[Measurement], group: str, controller: str, phase: str = "whole"
) -> list[Measurement]:
    """Return a controller's measurements in one phase."""
    return [m for m in found if (m.group, m.controller, m.phase) == (group, controller, phase)]


# Table I with entries exchanged. A case is the paper's parameters with some of them exchanged, on both sides; the
# first case is the table as printed.

RULE = (
    "A case decides on a claim where its effect lies on the other side of the claim's bound than that of the first "
    "case, and the 95 % interval of the difference of the two effects leaves out zero, over eight trials at least."
)


class Case(Settings):
    """Table I with some entries exchanged."""

    KIND: ClassVar[str] = "[ablation.cases.*]"
    about: str = ""
    control: dict[str, Any] = Field(default_factory=dict, description="what is exchanged")
    without: list[str] = Field(default_factory=list, description="settings put back to the package's default")
    controller: str = Field("exact", description="a solver of the third level, or 'dcac-damped'")


def exchange_rows(cases: Mapping[str, Case], found: Sequence[Measurement]) -> list[dict[str, Any]]:
    """Make one row a case and claim: the effect, and but for the first case its shift from that and ``decides``."""
    table: list[dict[str, Any]] = []
    printed = next(iter(cases), "")
    for name, case in cases.items():
        for claim in CLAIMS:
            change = effect(found, name, case.controller, MATCHED, claim.metric)
            if change is None:
                continue
            row = {
                "case": name, "about": case.about, "controller": case.controller, "claim": claim.name,
                "trials": change.ratio.samples, "confirmed": claim.confirmed(change),
                **change.entries("effect_percent"),
            }  # fmt: skip
            table.append(row | (_shift(cases, found, name, printed, claim) if name != printed else {}))
    return table


def _shift(
    cases: Mapping[str, Case], found: Sequence[Measurement], name: str, printed: str, claim: Claim
) -> dict[str, Any]:
    """Compute the shift of a case from the first [percentage points], over the trials with four whole runs."""
    asked = [(case, cases[case].controller) for case in (name, printed)]
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
    decides = beyond[0] != beyond[1] and shift.low * shift.high > 0.0 and not too_few(shift.samples)
    return {**shift.entries("shift_percent"), "decides": decides}


def what_decides(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return which entries decide, in words; cases of another controller than the first are left out."""
    if not rows:
        return []
    if few := too_few(min(row["trials"] for row in rows)):
        return [f"Table I with entries exchanged, against matched DCAC: {few}."]
    deciding: dict[str, list[str]] = {}
    for row in rows:
        if row.get("decides") and row["controller"] == rows[0]["controller"]:
            deciding.setdefault(row["about"], []).append(row["claim"])
    held = [row["claim"] for row in rows if row["case"] == rows[0]["case"] and row["confirmed"]]
    parts = [f"{about} ({', '.join(claims)})" for about, claims in deciding.items()]
    return [
        f"Table I as printed, against matched DCAC: {', '.join(held) or 'no claim'} confirmed.",
        f"Replacements in Table I that turn a claim: {'; '.join(parts) or 'no exchange'}.",
    ]


def swivel_summary(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the gain at the maximum, and the largest and mean gain over the other starts [percent]."""
    known = [row for row in rows if "gain_percent" in row]
    others = [row for row in known if not row["at_maximum"]]
    gains = [row["gain_percent"] for row in others]
    found: dict[str, Any] = {"starts": len(rows), "broke_off": len(rows) - len(known)}
    if gains:
        mean_gain = sum(row["mu_moc"] for row in others) / sum(row["mu_dcac"] for row in others) - 1.0
        found["gain_mean_percent"] = 100.0 * mean_gain
        found |= {"gain_max_percent": max(gains), "gain_min_percent": min(gains)}
    at_top = [row["gain_percent"] for row in known if row["at_maximum"]]
    return {**found, "gain_at_maximum_percent": at_top[0]} if at_top else found

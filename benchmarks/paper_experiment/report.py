"""The headline and the page of ``python -m benchmarks.paper``, all from its numbers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import plotly.graph_objects as go

from benchmarks.answer import Answer
from benchmarks.paper_experiment import ablation
from benchmarks.paper_experiment.tables import (
    Summary,
    ablation_table,
    goal_table,
    group_table,
    phase_table,
    procedure_table,
    verdict_table,
)
from benchmarks.paper_experiment.verdict import CLAIMS, FAILS, GAINS_ONLY, HOLDS, PATIENT
from moc_opt.report.page import Page


def headline(summary: Summary, groups: Sequence[str], solver: str) -> list[str]:
    """Return the results in words, computed."""
    found = []
    for group in groups:
        rows = [v for v in summary["verdict"] if v["group"] == group and v["controller"] == solver]
        mine = [v for v in rows if v["claim"] in {claim.name for claim in CLAIMS}]
        held = [v["text"] for v in mine if v["verdict"] == HOLDS]
        gains = [v["text"] for v in mine if v["verdict"] == GAINS_ONLY]
        failed = [v["text"] for v in mine if v["verdict"] == FAILS]
        parts = [
            f"{label}: {', '.join(names)}"
            for label, names in (
                ("hold", held),
                ("hold only against DCAC's own, softer gains", gains),
                ("do not hold", failed),
            )
            if names
        ]
        who = f"Group {group}, MOC with {solver}{_shaking(summary, group, solver)}"
        found.append(f"{who}: of the paper's claims {'; '.join(parts)}.")
        felt = [f"{v['text']}: {v['verdict']}" for v in rows if v["claim"] in {claim.name for claim in PATIENT}]
        if felt:
            found.append(f"Group {group}, in the patient's frame, calibration errors included: {'; '.join(felt)}.")
    found += ablation.headline(summary["ablation"])
    goals = summary["goals"]
    missed = [goal["text"] for goal in goals if not goal["reached"]]
    found.append(
        f"{len(goals) - len(missed)} of {len(goals)} goals are reached"
        + (f"; missed: {'; '.join(missed)}." if missed else ".")
    )
    swivel = summary["swivel"]
    if "gain_at_maximum_percent" in swivel and "gain_max_percent" in swivel:
        found.append(
            f"MOC changes the mean mu by {swivel['gain_at_maximum_percent']:+.2g} % from a start at the largest mu, by "
            f"{swivel['gain_min_percent']:+.2g} to {swivel['gain_max_percent']:+.2g} % from others."
        )
    return found


def _shaking(summary: Summary, group: str, solver: str) -> str:
    """ " (10 of 45 trials oscillate)", empty where none does."""
    row = summary.get(group, {}).get(solver, {})
    count = row.get("oscillated", 0)
    return f" ({count} of {row['trials']:g} trials oscillate)" if count else ""


def page(
    summary: Summary,
    groups: Mapping[str, str],
    best: tuple[str, str],
    drawn: Mapping[str, go.Figure],
    environment: Mapping[str, Any],
    look: Callable[[Page], None],
    first: Answer,
) -> Page:
    """Make the page; ``first`` is its first screen, ``look`` adds the section on single trials."""
    page = Page("The paper's experiment in simulation", "DCAC and MOC on three virtual tasks")
    first.begin(page)
    page.section("In more words")
    for sentence in headline(summary, list(groups), best[1]):
        page.text(sentence)
    page.section("Goals")
    page.table(goal_table(summary, *best))
    for group, about in groups.items():
        page.section(f"Group {group}")
        page.text(f"{about[:1].upper()}{about[1:]}.")
        page.table(verdict_table(summary["verdict"], group))
        page.table(group_table(summary, group, about))
        page.table(phase_table(summary["phases"], group))
        for name, figure in drawn.items():
            if name.startswith(f"figure7-{group}-") and name not in page.figures:
                page.figure(figure, "Distribution over the ticks of all trials, by task.", name=name)
        if f"trial-{group}" in drawn:
            page.figure(drawn[f"trial-{group}"], "The first trial over time.", name=f"trial-{group}")
    if summary["ablation"]:
        page.section("Which entry of Table I decides")
        page.text("The paper's parameters with some entries exchanged, on both sides of the comparison.")
        page.table(ablation_table(summary["ablation"]))
    look(page)
    page.section("The starting swivel")
    page.text(
        "The same trial from every place of the feasible self-motion. The gain in mu is a statement about the start "
        "as much as about the controller."
    )
    page.section("The procedure")
    page.text(
        "A hand guides the tip to the incision, where the trocar is registered; the camera finds the board; the tip "
        "follows the task that is defined on it, and waits while the board is lost. Errors are against the truth."
    )
    page.table(procedure_table(summary))
    page.environment(environment)
    return page

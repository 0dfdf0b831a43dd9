"""The page of ``python -m benchmarks.paper``, all from its numbers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import plotly.graph_objects as go

from benchmarks.common.answer import Answer
from benchmarks.paper_experiment.tables import (
    Summary,
    ablation_table,
    goal_table,
    group_table,
    phase_table,
    procedure_table,
    verdict_table,
)
from moc_opt.report.page import Page


def page(
    summary: Summary, groups: Mapping[str, str], best: tuple[str, str], drawn: Mapping[str, go.Figure],
    environment: Mapping[str, Any], look: Callable[[Page], None], first: Answer,
) -> Page:  # fmt: skip
    """Make the page; ``first`` is its first screen, ``look`` adds the section on single trials."""
    page = Page("The paper's experiment in simulation", "DCAC and MOC on three virtual tasks")
    first.begin(page)
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

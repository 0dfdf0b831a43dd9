"""The page of ``python -m benchmarks.robots``: its first screen, and folded below it tables and one picture an arm."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import plotly.graph_objects as go

from benchmarks.common.answer import Answer
from benchmarks.common.output import close_page
from benchmarks.paper_experiment.trials import MATCHED
from benchmarks.robots_study.first_screen import EACH, FOUND, RESULTS
from benchmarks.robots_study.tables import Rows, tables
from moc_opt.comparison.statistics import spread
from moc_opt.figures.boxes import box_plots
from moc_opt.report.page import Page


def report(summary: Mapping[str, Any], rows: Rows, first: Answer, environment: Mapping[str, Any]) -> Page:
    """Make the page out of the rows, their summary and its first screen."""
    page = Page("The arms", "what of the study holds on every arm, and what is the LWR4+'s")
    first.begin(page)
    page.section("How to read this")
    page.text(
        "Every arm does the paper's three tasks from random poses of its own workspace, in the realistic plant at the "
        "default preset; DCAC has the same gains and trials. Settled errors are those at ticks at which no elbow is on "
        "its way. Intervals in summary.json are 95 %, over trials. A run that broke off is counted and in no mean. "
        "Errors in space hold the arm's calibration, which no controller sees: it counts from the pose at which the "
        "arm touched task and trocar, where DCAC stays, and which the third level leaves. Those by the arm's own "
        "kinematics are what control answers for."
    )
    results, findings, order = tables(summary)
    for title, table in ((RESULTS, results), (FOUND, findings), ("Solvers", order)):
        page.section(title)
        page.table(table)
    page.section(EACH)
    for robot, figures in summary["robots"].items():
        drawn = _picture(rows, robot, [name for name in figures if name != MATCHED])
        if drawn is not None:
            gains = ", ".join(
                f"{name} {text} %" for name, row in figures.items() if (text := spread(row, "mu_gain_percent"))
            )
            page.figure(drawn, f"{robot}: gain in mu over DCAC by task, one box a solver; over all tasks: {gains}.",
                        name=robot)  # fmt: skip
    close_page(page, "robots", environment, rows, ("robot", "trial", "controller"))
    return page


def _picture(rows: Rows, robot: str, controllers: list[str]) -> go.Figure | None:
    """Draw the gain of every trial of one arm; None where no trial was run by a controller and by DCAC."""
    mine = [row for row in rows if row["robot"] == robot and "mu_mean" in row]
    base = {row["trial"]: row["mu_mean"] for row in mine if row["controller"] == MATCHED}
    tasks = dict.fromkeys(row["task"] for row in mine)
    groups = {
        name: {
            task: np.array([
                100.0 * (row["mu_mean"] / base[row["trial"]] - 1.0) for row in mine
                if (row["controller"], row["task"]) == (name, task) and row["trial"] in base
            ]) for task in tasks
        } for name in controllers
    }  # fmt: skip
    if not any(len(samples) for by in groups.values() for samples in by.values()):
        return None
    return box_plots(groups, "gain in mu (%)")

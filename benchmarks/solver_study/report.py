"""The tables, the page and the headline of ``python -m benchmarks.solvers``, all from its numbers."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console

from benchmarks.output import save_page
from benchmarks.solver_study import compare
from benchmarks.solver_study import figures as study_figures
from benchmarks.solver_study.cells import RIGHTLY, answers_rightly
from benchmarks.solver_study.closed_loop import BASELINE
from benchmarks.solver_study.look import Look
from benchmarks.solver_study.tables import FOOTNOTE, SETTLED, headline, tables
from moc_opt.report import figures
from moc_opt.report.page import Page
from moc_opt.report.tables import Table

if TYPE_CHECKING:
    from benchmarks.solver_study.parts import Study

SCREEN = ("testsets", "closed_loop", "prediction", "troubles", "not_run")
METRICS = {
    "mu_mean": "µ [m³]", "tip_error_model_mean_mm": "tip error [mm]", "rcm_error_model_mean_mm": "RCM error [mm]",
    "torque_rate_rms_Nm_per_s": "chatter [Nm/s]",
}  # fmt: skip


def print_tables(console: Console, study: Study, out: Path) -> None:
    """The tables on the screen, and where the files are."""
    made = tables(study.summary)
    for part in SCREEN:
        if part in made:
            for piece in made[part].fitted(console.width):
                console.print(piece)
    console.print(headline(study.summary, study.words))
    if study.store.reused:
        console.print(f"{study.store.reused} parts are those of an earlier run in {out}/parts")
    console.print(
        f"written: {out}/summary.json rows.parquet environment.json report.html (all tables) replay.html"
    )


def write_report(
    path: Path, study: Study, environment: Mapping[str, Any], look: Look | None, figures: bool = False
) -> None:
    """One page that opens by itself, and the replay beside it."""
    summary, made = study.summary, tables(study.summary)
    page = Page("Solvers of the null-space subproblem", "open loop and in closed loop, judged by one measure")
    page.headline(headline(summary, study.words))
    page.section("How to read this")
    page.text(
        "An answer is verified when its primal residual is at most 1e-6, its relative natural residual 1e-3 and its "
        "self-motion loss 1e-2; the solver is not asked. Silently wrong: claimed as solved, and not verified. "
        "Infeasible claims are right where the set's certificate says so, and wrong elsewhere; a wrong one counts "
        "among the failed too. Right: verified, or rightly called infeasible; times are compared among solvers that "
        f"are right at {100 * RIGHTLY:g} % of the problems or more. Hung: no answer within the time limit, the process "
        "was killed; the rest of a set is not asked after two of them, and no further set after three such sets. "
        "Update: of a warm solve, the part that hands the new problem to the library, where that can be told apart. "
        "Percentiles of times stand beside each other (p50, p99, p99.9); no mean of times is shown anywhere, and of "
        f"several sets the slowest is quoted. {SETTLED}\n\n" + FOOTNOTE
    )
    if "settings" in made:
        page.table(made["settings"])
    _testsets(page, study, made)
    _open_loop(page, study, made)
    _closed_loop(page, study, made)
    if look is not None:
        look.add_section(page, path.parent)
    _sweeps(page, study, made)
    if "qpbenchmark" in made:
        page.section("What qpbenchmark says")
        page.table(made["qpbenchmark"])
    if "troubles" in made:
        page.section("Exceptions, hangs and crashes")
        page.table(made["troubles"])
    if "not_run" in made:
        page.section("Not run")
        page.table(made["not_run"])
    page.environment(environment)
    save_page(page, path, figures=figures)


def _testsets(page: Page, study: Study, made: Mapping[str, Table]) -> None:
    summary = study.summary
    if "testsets" not in made:
        return
    page.section("Certified test sets")
    page.table(made["testsets"])
    costs = {name: cost for name, cost in study.samples.get("profile", {}).items() if np.isfinite(cost).any()}
    if costs:
        tau, shares = compare.profile(costs)
        page.figure(
            study_figures.performance_profile(tau, shares),
            "Performance profiles (Dolan and Moré): the share of all problems of all sets that a solver under our "
            "settings answered rightly within a multiple of the fastest right answer's time. Where a line ends "
            "below 1, the rest was never answered rightly.",
            name="performance-profile",
        )
    points = {
        name: (figure["solve_p50_us_worst_set"], figure["relative_max"])
        for name, figure in summary["testsets"].items()
        if figure.get("solve_p50_us_worst_set") and figure.get("relative_max") is not None
    }
    points = {
        name: point
        for name, point in points.items()
        if name.endswith("@recommended") and answers_rightly(summary["testsets"][name])
    }
    if points:
        page.figure(
            figures.accuracy_against_time(
                {name.partition("@")[0]: point for name, point in points.items()},
                x_label="median solve time on the slowest set [us]",
                y_label="largest relative residual on any set",
            ),
            "Accuracy against time over all sets under our settings, of the solvers that answer "
            f"{100 * RIGHTLY:g} % or more rightly; the line joins what nothing else beats in both.",
            name="pareto",
        )
    for part, table in made.items():
        if part.startswith("testset "):
            page.table(table)
    if "growth" in made:
        page.section("More joints")
        page.table(made["growth"])
    if "duals on six rows" in made:
        page.section("Duals")
        page.text(study.words.get("duals", ""))
        for rows in ("six", "five"):
            if f"duals on {rows} rows" in made:
                page.table(made[f"duals on {rows} rows"])


def _open_loop(page: Page, study: Study, made: Mapping[str, Table]) -> None:
    if "open_loop_warm" not in made:
        return
    page.section("Open loop on a recorded run")
    page.table(made["open_loop_warm"])
    samples = {name: times for name, times in study.samples.get("open_loop", {}).items() if len(times)}
    if samples:
        deadline = study.config.scenario.deadline_us
        page.figure(
            figures.latency_ecdf(samples, deadline),
            "Solve time, warm: empirical distribution, with the deadline of a tick.",
        )
        page.figure(
            figures.latency_ecdf(samples, deadline, tail=True),
            "The same, its tail: how rare are the late ones?",
        )
    page.table(made["open_loop_cold"])


def _closed_loop(page: Page, study: Study, made: Mapping[str, Table]) -> None:
    if "closed_loop" not in made:
        return
    page.section("Closed loop")
    cut = study.config.closed_loop.duration_s
    page.text(
        "Each trial begins at a random pose and shows "
        + (f"the first {cut:g} s of its task." if cut else "its whole task.")
    )
    page.table(made["closed_loop"])
    first = study.runs[0].trial if study.runs else ""
    shown = {r.controller: r.trace for r in study.runs if r.trial == first and r.trace is not None}
    if shown:
        page.figure(
            figures.time_series(shown),
            f"Trial {first}: manipulability, tip error, RCM error and trocar force over time.",
        )


def _sweeps(page: Page, study: Study, made: Mapping[str, Table]) -> None:
    summary = study.summary
    names = [part for part in summary if part.startswith("sweep ")]
    if not names:
        return
    page.section("Where inaccuracy begins to cost")
    page.text(
        "The supervisor's check of residuals is off here, so that the arm follows the answer as it is and not what "
        "would be put in its place. " + study.words.get("cost_begins", "")
    )
    groups = {
        "tolerance": [p for p in names if p.endswith((".eps", ".primal_tol"))],
        "steps or iterations": [p for p in names if "steps" in p or "max_iter" in p],
        "rho": [p for p in names if p == "sweep damping"],
    }
    for words, parts in groups.items():
        if parts:
            page.figure(
                study_figures.sweep_panels(
                    {part.removeprefix("sweep "): list(summary[part].values()) for part in parts}, METRICS, words,
                    zero=1e-8,
                ),
                f"Closed loop over the {words}" + (" (rho = 0 is drawn at 1e-8)." if words == "rho" else "."),
                name=f"sweep-{words.split()[0]}",
            )  # fmt: skip
    for part in names:
        if part.startswith("sweep deadline") and "deadline" not in page.figures:
            page.section("Deadlines")
            page.text(
                "A solve that takes longer than its budget is answered by the last good answer (hold), by rest (zero), "
                "or by what the solver has when its budget ends (iterate): it is asked again, from where that solve "
                "began, for as many iterations as fit. Times are replayed from a recording: "
                "`[solver] replay_us` in a scenario repeats a run exactly."
            )
            break
    for part in names:
        page.table(made[part])
    if "prediction" in made:
        page.section("Does open loop predict closed loop?")
        page.text(study.words.get("prediction", ""))
        page.table(made["prediction"])
        if summary.get("disagreements"):
            page.text("\n\n".join(d["words"] + "." for d in summary["disagreements"].values()))


__all__ = ["BASELINE", "headline", "print_tables", "tables", "write_report"]

"""The tables, the page and the headline of ``python -m benchmarks.solvers``, all from its numbers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from benchmarks.common.answer import Answer
from benchmarks.solver_study import compare, verdicts
from benchmarks.solver_study import figures as study_figures
from benchmarks.solver_study.cells import RIGHTLY, answers_rightly
from benchmarks.solver_study.first_screen import CERTIFIED, CLOSED_LOOP, RECORDED, RULES
from benchmarks.solver_study.headline import headline
from benchmarks.solver_study.look import Look
from benchmarks.solver_study.study import Findings, Study
from benchmarks.solver_study.tables import FOOTNOTE, STEADY
from moc_opt import figures
from moc_opt.figures.notation import Doubtful
from moc_opt.report.page import Page
from moc_opt.report.tables import Table

LAST = {
    "qpbenchmark": "What qpbenchmark says", "troubles": "Exceptions, hangs and crashes", "not_run": "Not run",
}  # fmt: skip
METRICS = {
    "mu_mean": "µ [m³]", "tip_error_model_mean_mm": "tip error [mm]", "rcm_error_model_mean_mm": "RCM error [mm]",
    "torque_rate_rms_Nm_per_s": "chatter [Nm/s]",
}  # fmt: skip


def sentences(study: Study, found: Findings) -> list[str]:
    """Return what stands below the first screen in the terminal."""
    said = []
    if found.summary["not_run"]:
        said.append(f"{len(found.summary['not_run'])} solvers were not run: the report says why.")
    if study.kept.reused:
        said.append(f"{study.kept.reused} jobs are those of an earlier run in {study.out}/jobs")
    return said


def report_page(
    study: Study, found: Findings, made: Mapping[str, Table], environment: Mapping[str, Any], look: Look | None,
    first: Answer,
) -> Page:  # fmt: skip
    """Build one page that opens by itself; the replay is written beside it.

    Args:
        study: what was asked for.
        found: in all its parts.
        made: part -> its table.
        environment: of environment.json.
        look: at the first trial; None where nothing ran in closed loop.
        first: the first screen.
    """
    page = Page("Solvers of the null-space subproblem", "open loop and in closed loop, judged by one measure")
    first.begin(page)
    page.section("In more words")
    page.text(headline(found.summary, found.words))
    page.section(RULES)
    page.text(verdicts.__doc__ or "")
    page.section("How to read this")
    page.text(
        "An answer is verified when its primal residual is at most 1e-6, its relative natural residual 1e-3 and its "
        "self-motion loss 1e-2; the solver is not asked. Silently wrong: claimed as solved, and not verified. "
        "Infeasible claims are right where the set's certificate says so, refusals where the six rows given contradict "
        "each other, and wrong elsewhere; a wrong one counts among the failed too. Right: verified, or rightly called "
        "infeasible, as a share of the problems that were not refused; times are compared among solvers that "
        f"are right at {100 * RIGHTLY:g} % of the problems or more. Hung: no answer within the time limit, the process "
        "was killed; the rest of a set is not asked after two of them, and no further set after three such sets. "
        "Update: of a warm solve, the part that hands the new problem to the library, where that can be told apart. "
        "A time marked ? was spoilt by other work on the machine: too many of its calls lost the core, or the process "
        "had less than nine tenths of one. "
        "Percentiles of times stand beside each other (p50, p99, p99.9); no mean of times is shown anywhere, and of "
        f"several sets the slowest is quoted. {STEADY}\n\n" + FOOTNOTE
    )
    if "settings" in made:
        page.table(made["settings"])
    _testsets(page, found, made)
    _open_loop(page, study, found, made)
    _closed_loop(page, study, found, made)
    if look is not None:
        look.add_section(page, study.out)
    _sweeps(page, found, made)
    for part, title in LAST.items():
        if part in made:
            page.section(title)
            page.table(made[part])
    page.environment(environment)
    return page


def _testsets(page: Page, found: Findings, made: Mapping[str, Table]) -> None:
    summary = found.summary
    if "testsets" not in made:
        return
    page.section(CERTIFIED)
    page.table(made["testsets"])
    costs = {name: cost for name, cost in found.samples.get("profile", {}).items() if np.isfinite(cost).any()}
    if costs:
        tau, shares = compare.profile(costs)
        page.figure(
            study_figures.performance_profile(tau, shares),
            "Performance profiles (Dolan and Moré): the share of all problems of all sets that a solver under our "
            "settings answered rightly within a multiple of the fastest right answer's time. Where a line ends "
            "below 1, the rest was never answered rightly, or refused as inconsistent.",
            name="performance-profile",
        )
    points = {
        label.removesuffix("@recommended"): (row["solve_p50_us_worst_set"], row["relative_max"])
        for label, row in summary["testsets"].items()
        if label.endswith("@recommended") and answers_rightly(row)
        if row.get("solve_p50_us_worst_set") and row.get("relative_max") is not None
        and not isinstance(row["solve_p50_us_worst_set"], Doubtful)
    }
    if points:
        page.figure(
            figures.accuracy_against_time(
                points,
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
        page.text(found.words.get("duals", ""))
        for rows in ("six", "five"):
            if f"duals on {rows} rows" in made:
                page.table(made[f"duals on {rows} rows"])


def _open_loop(page: Page, study: Study, found: Findings, made: Mapping[str, Table]) -> None:
    if "open_loop_warm" not in made:
        return
    page.section(RECORDED)
    page.table(made["open_loop_warm"])
    samples = {name: times for name, times in found.samples.get("open_loop", {}).items() if len(times)}
    if samples:
        deadline = study.config.scenario.deadline_us
        rows = found.summary["open_loop_warm"]
        spoilt = [name for name in samples if isinstance(rows.get(name, {}).get("solve_p99_us"), Doubtful)]
        page.figure(
            figures.latency_ecdf(samples, deadline),
            "Solve time, warm: empirical distribution, with the deadline of a tick.",
        )
        page.figure(
            figures.latency_ecdf(samples, deadline, tail=True),
            "The same, its tail: how rare are the late ones?"
            + (f" Other work on the machine spoilt it for {', '.join(spoilt)}." if spoilt else ""),
        )
    page.table(made["open_loop_cold"])


def _closed_loop(page: Page, study: Study, found: Findings, made: Mapping[str, Table]) -> None:
    if "closed_loop" not in made:
        return
    page.section(CLOSED_LOOP)
    cut = study.config.closed_loop.duration_s
    page.text(
        "Each trial begins at a random pose and shows "
        + (f"the first {cut:g} s of its task." if cut else "its whole task.")
    )
    page.table(made["closed_loop"])
    first = found.runs[0].trial if found.runs else ""
    whole = [r for r in found.runs if r.trial == first and not r.short]
    shown = {r.controller: r.trace for r in whole if r.trace is not None}
    if shown:
        page.figure(
            figures.time_series(shown),
            f"Trial {first}: manipulability, tip error, RCM error and trocar force over time.",
        )


def _sweeps(page: Page, found: Findings, made: Mapping[str, Table]) -> None:
    summary = found.summary
    names = [part for part in summary if part.startswith("sweep ")]
    if not names:
        return
    page.section("Where inaccuracy begins to cost")
    page.text(
        "The supervisor's check of residuals is off here, so that the arm follows the answer as it is and not what "
        "would be put in its place. " + found.words.get("cost_begins", "")
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
        page.text(found.words.get("prediction", ""))
        page.table(made["prediction"])
        if summary.get("disagreements"):
            page.text("\n\n".join(d["words"] + "." for d in summary["disagreements"].values()))

"""The tables, the page and the headline of ``python -m benchmarks.solvers``, all from its numbers."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console

from benchmarks.closed_loop import BASELINE, Run
from benchmarks.open_loop import Answers
from moc_opt.report import figures
from moc_opt.report.page import Page
from moc_opt.report.tables import Column, Table

Summary = Mapping[str, Mapping[str, Mapping[str, Any]]]

OPEN = [
    Column("solver", "solver"),
    Column("solves", "solves", format=".0f"),
    Column("claimed_solved", "claimed", format=".0f", help="answers that the solver calls solved"),
    Column("verified_solved", "verified", format=".0f", help="of these, optimal by our residuals"),
    Column("silently_wrong", "silently wrong", format=".0f", better="low", help="claimed, but not optimal"),
    Column("failed", "failed", format=".0f", better="low"),
    Column("primal_max", "primal", format=".1e", better="low", help="max |A x - b|, box violation"),
    Column("natural_max", "natural", format=".1e", help="natural residual with the solver's own duals"),
    Column(
        "relative_max",
        "relative",
        format=".1e",
        better="low",
        help="natural residual, best duals, cost scaled",
    ),
    Column(
        "loss_max", "loss", format=".1e", better="low", help="self-motion loss: 0 optimum, 1 opposite end"
    ),
    Column("solve_p50_us", "p50", unit="us", format=".1f", better="low"),
    Column("solve_p99_us", "p99", unit="us", format=".1f", better="low"),
]
CLOSED = [
    Column("solver", "controller"),
    Column("mu_mean", "mu", format=".4f", better="high"),
    Column(
        "mu_gain_percent", "gain", unit="%", format=".1f", better="high", help="over DCAC with the same gains"
    ),
    Column("mu_fraction_of_bound", "of bound", digits=3, better="high"),
    Column("tip_error_mean_mm", "tip", unit="mm", digits=3, better="low"),
    Column("rcm_error_mean_mm", "RCM", unit="mm", digits=3, better="low"),
    Column("trocar_force_mean_N", "force", unit="N", digits=2, better="low"),
    Column("torque_rate_rms_Nm_per_s", "chatter", unit="Nm/s", format=".0f", better="low"),
    Column("claimed_solved", "claimed", format=".0f"),
    Column("verified_solved", "verified", format=".0f"),
    Column("silently_wrong", "silently wrong", format=".0f", better="low"),
    Column("deadline_misses", "misses", format=".0f", better="low", help="ticks longer than the deadline"),
    Column("tick_p50_us", "tick p50", unit="us", format=".1f", better="low"),
    Column("tick_p99_us", "tick p99", unit="us", format=".1f", better="low"),
    Column("broke_off", "broke off", format=".0f", better="low"),
]


def tables(summary: Summary) -> list[Table]:
    """Open loop warm and cold, closed loop, and what did not run."""

    def rows(part: str) -> list[dict[str, Any]]:
        return [{"solver": name, **metrics} for name, metrics in summary[part].items()]

    found = [
        Table("Open loop, warm: one session through the sequence", OPEN, rows("open_loop_warm")),
        Table("Open loop, cold: a fresh session for each", OPEN, rows("open_loop_cold")),
        Table("Closed loop: the same trials under every controller", CLOSED, rows("closed_loop")),
    ]
    if summary["not_run"]:
        columns = [Column("solver", "not run"), Column("reason", "reason")]
        found.append(Table("What could not run here", columns, rows("not_run")))
    return found


def headline(summary: Summary) -> str:
    """The result in words, computed."""
    warm, closed = summary["open_loop_warm"], summary["closed_loop"]
    right = [n for n, m in warm.items() if m["verified"] == m["solves"]]
    liars = {n: m["silently_wrong"] for n, m in warm.items() if m["silently_wrong"]}
    parts = [f"{len(right)} of {len(warm)} solvers answered every recorded subproblem optimally"]
    if right:
        fastest = min(right, key=lambda n: warm[n]["solve_p50_us"])
        parts[0] += (
            f"; the fastest of them is {fastest} with a median of {warm[fastest]['solve_p50_us']:.1f} us"
        )
    if liars:
        parts.append(
            "claimed success for wrong answers: " + ", ".join(f"{n} ({k})" for n, k in liars.items())
        )
    gains = {n: m["mu_gain_percent"] for n, m in closed.items() if n != BASELINE and "mu_gain_percent" in m}
    if gains:
        best = max(gains, key=lambda n: gains[n])
        worst = min(gains, key=lambda n: gains[n])
        parts.append(
            f"in closed loop manipulability rose by {gains[best]:.1f} % with {best} "
            f"and by {gains[worst]:.1f} % with {worst}"
        )
    return ". ".join(part[0].upper() + part[1:] for part in parts) + "."


def print_tables(console: Console, summary: Summary, out: Path) -> None:
    """The tables on the screen, and where the files are."""
    for table in tables(summary):
        console.print(table.to_rich())
    console.print(headline(summary))
    console.print(f"written: {out}/summary.json rows.parquet environment.json report.html")


def write_report(
    path: Path,
    summary: Summary,
    answers: list[Answers],
    runs: list[Run],
    environment: Mapping[str, Any],
    deadline_us: float,
) -> None:
    """One page that opens by itself."""
    page = Page("Solvers of the null-space subproblem", "open loop and in closed loop, judged by one measure")
    page.headline(headline(summary))
    open_warm, open_cold, closed, *missing = tables(summary)
    warm = [a for a in answers if a.mode == "warm"]
    page.section("Open loop")
    page.text(
        f"A 500 Hz sequence of {len(warm[0].solutions) if warm else 0} subproblems, recorded from a closed-loop "
        "run, solved by every solver. An answer is verified when primal residual <= 1e-6, relative natural "
        "residual <= 1e-3 and self-motion loss <= 1e-2; the solver is not asked."
    )
    page.table(open_warm)
    page.figure(
        figures.latency_ecdf({a.solver: a.us for a in warm}, deadline_us),
        "Solve time, warm: empirical distribution, with the deadline of a tick.",
    )
    page.figure(
        figures.accuracy_against_time(
            {n: (m["solve_p50_us"], m["primal_max"]) for n, m in summary["open_loop_warm"].items()},
            x_label="median solve time [us]",
            y_label="largest primal residual [m/s, rad/s]",
        ),
        "Accuracy against time, warm; the line joins what nothing else beats in both.",
    )
    page.table(open_cold)
    page.section("Closed loop")
    page.table(closed)
    first = runs[0].trial if runs else ""
    page.figure(
        figures.time_series(
            {r.controller: r.trace for r in runs if r.trial == first and r.trace is not None}
        ),
        f"Trial {first}: manipulability, tip error, RCM error and trocar force over time.",
    )
    if missing:
        page.section("Not run")
        page.table(missing[0])
    page.environment(environment)
    page.save(path)

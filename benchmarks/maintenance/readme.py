"""The figures of the README, from results.

python -m benchmarks.readme [--solvers DIR] [--paper DIR] [--speed DIR] [--readme FILE]

What stands between ``<!-- solvers -->`` and ``<!-- /solvers -->`` is written anew, and the same with the others.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks import cli
from benchmarks.latency.goals import GOALS
from benchmarks.markdown import fill_section, table
from benchmarks.output import write_atomically
from benchmarks.paper_experiment import ablation
from benchmarks.solver_study.cases import BASELINE
from benchmarks.solver_study.tables import STEADY
from moc_opt.comparison.statistics import spread
from moc_opt.errors import MocOptError

Summary = Mapping[str, Any]

# The native back-ends: qpsolvers' libraries are the same ones, called another way.
LISTED = (
    "exact", "daqp", "casadi:qrqp", "quadprog", "proxqp", "piqp", "osqp", "clarabel", "nlp-sqp", "nlp-fatrop",
    "nlp-ipopt", "rnn", "rnn-printed",
)  # fmt: skip
COLUMNS = (
    "solver", "verified", "silently wrong", "primal", "loss", "p50 [us]", "p99 [us]", "mu", "gain [%]", "tip [mm]",
    "RCM [mm]", "steady RCM [mm]", "trials", "chatter [Nm/s]",
)  # fmt: skip
CLOSED = {
    "mu_mean": ".4f", "mu_gain_percent": ".1f", "tip_error_model_mean_mm": ".3f",
    "rcm_error_model_mean_mm": ".3f", "rcm_error_model_settled_mean_mm": ".3f", "runs": ".0f",
    "torque_rate_rms_Nm_per_s": ".0f",
}  # fmt: skip
OPEN = {"primal_max": ".0e", "loss_max": ".0e", "solve_p50_us": ".1f", "solve_p99_us": ".1f"}


class ReadmeError(MocOptError, ValueError):
    """Results or a README that do not go together."""


def solvers_section(summary: Summary, environment: Summary) -> str:
    """Return the table of the main job: recorded subproblems on the left, closed loop on the right."""
    warm, closed = summary["open_loop_warm"], summary["closed_loop"]
    rows = [["`dcac` (no third level)", *[""] * 6, *_figures(closed[BASELINE], CLOSED)]]
    for name in LISTED:
        if name in warm:
            given = warm[name]
            star = "*" if name.startswith("nlp-") else ""
            counts = [f"{given['verified_solved']}/{given['solves']}", str(given["silently_wrong"])]
            figures = [*_figures(given, OPEN), *_figures(closed.get(name, {}), CLOSED)]
            rows.append([f"`{name}`{star}", *counts, *figures])
    runs = closed[BASELINE].get("runs", 0)
    trials = f"{runs} {'trial' if runs == 1 else 'trials'} from random poses"
    cut = environment.get("config", {}).get("closed_loop", {}).get("duration_s")
    trials += f" (the first {cut:g} s of each)" if cut else ""
    gain = spread(closed.get("exact", {}), "mu_gain_percent") or "not measured"
    wrong = {
        name.removesuffix("@default"): row["silently_wrong"]
        for name, row in summary.get("testsets", {}).items()
        if name.endswith("@default") and row["silently_wrong"] and ":" not in name and not name.startswith("nlp-")
    }
    listed = ", ".join(f"{name} {count}" for name, count in sorted(wrong.items(), key=lambda item: -item[1]))
    asked = max((row["solves"] for row in summary.get("testsets", {}).values()), default=0)
    return f"""\
`python -m benchmarks.solvers` ({_where(environment)}): on the left
a 500 Hz sequence of recorded subproblems solved warm, on the right means over {trials} in the realistic plant, the
same for all controllers; the gain is that of the mean over DCAC's (`exact`: {gain} %, 95 % interval).

{table(COLUMNS, rows)}

\\* The NLP solvers answer the nonlinear one-step problem, which lies about 1e-3 m/s off the linear subproblem that the
judge knows: they count as not verified, and in closed loop it costs nothing.

As the libraries come, without our settings, many claim success for wrong answers on the {asked} problems of the
certified sets: {listed}. {STEADY}"""


def paper_section(summary: Summary, environment: Summary) -> str:
    """Return the goals of the experiment, each with what was measured and its interval."""
    away = {goal["goal"]: goal for goal in summary.get("goals_elsewhere", [])}
    heads = ["MOC with `exact`, preset `tuned`", "wanted", "home pose", *(["random poses"] if away else [])]
    rows = []
    for goal in summary["goals"]:
        what, _, side = goal["text"].rpartition(", ")
        found = [_goal(row) for row in (goal, away.get(goal["goal"])) if row is not None]
        rows.append([what, f"{side} {goal['limit']:g}", *found])
    trials = max((row["trials"] for row in summary.get("tuned", {}).values()), default=0)
    said = f"`python -m benchmarks.paper` (seed {environment['seed']}), {trials:g} trials, mean and 95 % interval:\n\n"
    return "\n\n".join([said + table(heads, rows), *_claims(summary)])


def _goal(goal: Mapping[str, Any]) -> str:
    return (spread(goal, "value") or "not measured") + ("" if goal["reached"] else " (not reached)")


def _claims(summary: Summary) -> list[str]:
    """Return the paper's claims with its own Table I, by solver, and which entry of the table decides."""
    mine = [row for row in summary.get("verdict", []) if row["group"] == "paper"]
    if not mine:
        return []
    solvers = list(dict.fromkeys(row["controller"] for row in mine))
    cells = {
        (row["text"], row["controller"]): f"{row['matched_percent']:+.1f} ({row['matched_percent_low']:+.1f} to "
        f"{row['matched_percent_high']:+.1f}): {row['verdict']}"
        for row in mine
        if None not in (row.get("matched_percent"), row.get("matched_percent_low"))
    }
    texts = dict.fromkeys(row["text"] for row in mine)
    shown = table(
        ["claim", *(f"`{name}` [%]" for name in solvers)],
        [[text, *(cells.get((text, name), "") for name in solvers)] for text in texts],
    )
    said = (
        "The paper's claims with the paper's parameters (preset `paper`, Table I as printed): change against DCAC with "
        "the same gains, 95 % interval, verdict by the interval's end."
    )
    decided = " ".join(ablation.headline(summary.get("ablation", [])))
    return [said, shown, *([decided] if decided else [])]


def speed_section(summary: Summary, environment: Summary) -> str:
    """Return what everything costs beside what was wanted, and the ticks of others in the same run."""
    rows = []
    for goal in (summary["goals"][key] for key in GOALS if key in summary["goals"]):
        unit = f" [{goal['unit']}]" if goal["unit"] else ""
        found = "not measured" if goal["value"] is None else f"{goal['value']:.3g}"
        mark = " (not reached)" if goal["reached"] == "no" else ""
        rows.append([goal["what"] + unit, found + mark, f"{goal['kind']} {goal['goal']:g}"])
    own = _medians(summary["tick"])
    daggers = {name: "†" for name, row in summary["peers"].items() if row["installed"] == "hand"}
    peers = {f"{name}{daggers.get(name, '')} ({row['level']})": row for name, row in summary["peers"].items()}
    others = _medians(peers)
    notes = ["† not installed by `make`: built by hand on the machine of this run."] if daggers else []
    absent = {key.removeprefix("peer "): row["reason"] for key, row in summary["not_run"].items() if key[:5] == "peer "}
    notes += [f"Not measured in this run: {name} ({reason})." for name, reason in absent.items()]
    return f"""\
`python -m benchmarks.speed` ({_where(environment)}), all in one run:

{table(["", "measured", "wanted"], rows)}

Median of our tick by solver, and in C [us]: {own}.
Median of other libraries' ticks at the same job [us]: {others or "none is installed"}.
{chr(10).join(notes)}""".rstrip()


def _medians(rows: Mapping[str, Mapping[str, float]]) -> str:
    ordered = sorted(rows.items(), key=lambda item: item[1]["tick_p50_us"])
    return ", ".join(f"{name} {row['tick_p50_us']:.1f}" for name, row in ordered)


def fill(given: argparse.Namespace) -> int:
    """Write the sections whose results are there."""
    makers = {"solvers": solvers_section, "paper": paper_section, "speed": speed_section}
    text = given.readme.read_text(encoding="utf-8")
    for name, make in makers.items():
        folder = getattr(given, name)
        if folder is not None:
            read = (_read(folder / f"{kind}.json") for kind in ("summary", "environment"))
            text = fill_section(text, name, make(*read), "README")
    write_atomically(given.readme, text.encode())
    return 0


def main(arguments: Sequence[str] | None = None) -> int:
    """Fill the README; see `cli.run` for the exit status."""
    options = argparse.ArgumentParser(prog="python -m benchmarks.readme", description=__doc__)
    options.add_argument("--solvers", type=Path, help="results of benchmarks.solvers")
    options.add_argument("--paper", type=Path, help="results of benchmarks.paper")
    options.add_argument("--speed", type=Path, help="results of benchmarks.speed")
    options.add_argument("--readme", type=Path, default=Path("README.md"))
    return cli.run(options, fill, arguments)


def _where(environment: Summary) -> str:
    machine = environment["machine"]
    threads = environment["threads"]
    own = "one thread unless said otherwise" if threads == "1" else f"OMP_NUM_THREADS {threads or 'not set'}"
    what = f"{machine['cores']} cores, {machine['processor']}, {own}, load {machine['load_1min']:.1f}"
    return f"{what}, Python {machine['python']}, seed {environment['seed']}"


def _read(path: Path) -> Summary:
    try:
        found: Summary = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ReadmeError(f"{path}: not JSON: {error}; run the benchmark again") from error
    return found


def _figures(row: Mapping[str, Any], formats: Mapping[str, str]) -> list[str]:
    values = [(row.get(name), form) for name, form in formats.items()]
    return ["" if value is None else format(value, form) for value, form in values]


if __name__ == "__main__":
    sys.exit(main())

"""The figures of the README, from results.

python -m benchmarks.readme [--paper DIR] [--speed DIR] [--readme FILE]

What stands between ``<!-- paper -->`` and ``<!-- /paper -->`` is written anew, and the same with the others.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.common import cli
from benchmarks.common.markdown import fill_section, table
from benchmarks.common.output import write_atomically
from benchmarks.latency.verdict import GOALS
from benchmarks.paper_experiment.verdict import ABOUT_FRAMES, UNDECIDED, goal_value, in_words, what_decides
from moc_opt.errors import MocOptError
from moc_opt.inputs.files import read_json
from moc_opt.study.statistics import spread
from moc_opt.study.timing import read_doubts

Summary = Mapping[str, Any]


class ReadmeError(MocOptError, ValueError):
    """Results or a README that do not go together."""


def paper_section(summary: Summary, environment: Summary) -> str:
    """Return the goals of the experiment, each with what was measured and its interval."""
    away = {goal["goal"]: goal for goal in summary.get("goals_elsewhere", [])}
    heads = ["MOC with `exact`, preset `tuned`", "wanted", "home pose", *(["random poses"] if away else [])]
    rows = []
    for goal in summary["goals"]:
        what, _, side = goal["text"].rpartition(", ")
        found = [_goal(row) for row in (goal, away.get(goal["goal"])) if row is not None]
        rows.append([what, "–" if goal["limit"] is None else f"{side} {goal['limit']:g}", *found])
    trials = max((row["trials"] for row in summary.get("tuned", {}).values()), default=0)
    seed = environment["seed"]
    said = f"`python -m benchmarks.paper` (seed {seed}), {trials:g} trials a column, mean and 95 % interval:"
    return "\n\n".join([said, table(heads, rows), ABOUT_FRAMES, *_claims(summary)])


def _goal(goal: Mapping[str, Any]) -> str:
    """Return what was found, and where the goal is not reached or open, that."""
    word = in_words(goal)
    mark = f" (not reached{word.removeprefix('no')})" if goal["reached"] is False else f" ({word})"
    return (goal_value(goal) or "not measured") + ("" if word in ("yes", "no goal") else mark)


def _claims(summary: Summary) -> list[str]:
    """Return the paper's claims with its own Table I, by solver, and which entry of the table decides."""
    mine = [row for row in summary.get("verdict", []) if row["group"] == "paper"]
    if not mine:
        return []
    solvers = list(dict.fromkeys(row["controller"] for row in mine))
    cells = {
        (row["text"], row["controller"]): f"{row['matched_percent']:+.1f} ({row['matched_percent_low']:+.1f} to "
        f"{row['matched_percent_high']:+.1f}){_ratios(row)}: {row['verdict']}"
        for row in mine
        if None not in (row.get("matched_percent"), row.get("matched_percent_low"))
    }
    texts = dict.fromkeys(row["text"] for row in mine)
    shown = table(
        ["claim", *(f"`{name}` [%]{_shook(summary.get('paper', {}).get(name, {}))}" for name in solvers)],
        [[text, *(cells.get((text, name), "") for name in solvers)] for text in texts],
    )
    said = (
        "The paper's claims with the paper's parameters (preset `paper`, Table I as printed): change against DCAC with "
        "the same gains (*matched*), 95 % interval, verdict by the interval's end. *Holds only against softer gains*: "
        "against DCAC with its own gains of Table I, and not with the same ones. The claims without a frame stand by "
        "the robot's own kinematics, as in the paper; *in the patient*: in the frame registered at the start."
    )
    decided = " ".join(what_decides(summary.get("ablation", [])))
    return [said, shown, *([decided] if decided else [])]


def _ratios(row: Mapping[str, Any]) -> str:
    """Return the mean of the trials' ratios where it decides that nothing is decided."""
    return f", mean of ratios {spread(row, 'matched_percent_of_ratios')}" if row["verdict"] == UNDECIDED else ""


def _shook(found: Mapping[str, Any]) -> str:
    """Say how many of a controller's runs oscillated: their means count, and no claim that holds can hide them."""
    return f"; {found['oscillated']:g} of {found['trials']:g} runs oscillate" if found.get("oscillated") else ""


def speed_section(summary: Summary, environment: Summary) -> str:
    """Return what everything costs beside what was wanted, and the ticks of others in the same run."""
    rows = []
    for goal in (summary["goals"][key] for key in GOALS if key in summary["goals"]):
        unit = f" [{goal['unit']}]" if goal["unit"] else ""
        found = "not measured" if goal["value"] is None else f"{goal['value']:.3g}"
        mark = " (not reached)" if goal["reached"] == "no" else ""
        rows.append([goal["what"] + unit, found + mark, f"{goal['kind']} {goal['goal']:g}", goal["made_of"]])
    own = _medians(summary["tick"])
    daggers = {name: "†" for name, row in summary["peers"].items() if row["installed"] == "hand"}
    peers = {f"{name}{daggers.get(name, '')} ({row['level']})": row for name, row in summary["peers"].items()}
    others = _medians(peers)
    notes = ["† not installed by `make`: built by hand on the machine of this run."] if daggers else []
    absent = {key.removeprefix("peer "): row["reason"] for key, row in summary["not_run"].items() if key[:5] == "peer "}
    notes += [f"Not measured in this run: {name} ({reason})." for name, reason in absent.items()]
    return f"""\
`python -m benchmarks.speed` ({_where(environment)}), all in one run:

{table(["", "measured", "wanted", "made of"], rows)}

Median of our tick by solver, and in C [us]: {own}.
Median of other libraries' ticks at the same job [us]: {others or "none is installed"}.
{chr(10).join(notes)}""".rstrip()


def _medians(rows: Mapping[str, Mapping[str, float]]) -> str:
    ordered = sorted(rows.items(), key=lambda item: item[1]["tick_p50_us"])
    return ", ".join(f"{name} {row['tick_p50_us']:.1f}" for name, row in ordered)


def fill(given: argparse.Namespace) -> int:
    """Write the sections whose results are there."""
    makers = {"paper": paper_section, "speed": speed_section}
    text = given.readme.read_text(encoding="utf-8")
    for name, make in makers.items():
        folder = getattr(given, name)
        if folder is not None:
            read = (read_json(folder / f"{kind}.json", "results", ReadmeError) for kind in ("summary", "environment"))
            text = fill_section(text, name, make(*map(read_doubts, read)), "README")
    write_atomically(given.readme, text.encode())
    return 0


def main(arguments: Sequence[str] | None = None) -> int:
    """Fill the README; see `cli.run` for the exit status."""
    options = argparse.ArgumentParser(prog="python -m benchmarks.readme", description=__doc__)
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


if __name__ == "__main__":
    sys.exit(main())

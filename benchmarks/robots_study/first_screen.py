"""The first screen of ``python -m benchmarks.robots``: what holds on every arm, what on some, and by how much not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.common.answer import NO, UNKNOWN, YES, Answer, Picture, interval_of, interval_picture
from benchmarks.robots_study.tables import FINDINGS, LEAST_GAIN_PERCENT, MOST_CHANGE_PERCENT, of
from moc_opt.comparison.statistics import spread
from moc_opt.figures.notation import Mark
from moc_opt.figures.style import BAD, GOOD, WORST
from moc_opt.report.tables import Column, Table

RESULTS, FOUND, EACH = "Results", "Which findings hold where", "One picture an arm"
JUDGED = {
    "gains": "mu_gain_percent", "tip": "tip_change_percent", "rcm": "rcm_change_percent",
    "rcm_model": "rcm_model_change_percent",
}  # fmt: skip
"""Finding -> the change that it is about."""


def answer(summary: Mapping[str, Any]) -> Answer:
    """Make the first screen out of the summary."""
    return Answer(_sentences(summary), _table(summary), _pictures(summary))


def _sentences(summary: Mapping[str, Any]) -> list[str]:
    """Say what mu gains on which arm, which findings do not hold where, and whether solvers rank alike."""
    arms, gained = summary["robots"], []
    for arm, figures in arms.items():
        row = figures.get(of(figures) or "", {})
        if (text := spread(row, "mu_gain_percent")) is not None:
            gained.append(f"{arm} {text}")
    if not gained:
        return ["No trial was run by a solver and by DCAC."]
    name = next(of(figures) for figures in arms.values() if of(figures))
    trials = sorted({figures[name]["trials"] for figures in arms.values() if name in figures})
    count = " to ".join(str(trials[k]) for k in ((0, -1) if len(trials) > 1 else (0,)))
    said = [f"Gain of mean mu with `{name}` over DCAC with the same gains [%], {count} random poses an arm: "
            f"{', '.join(gained)}."]  # fmt: skip
    main = {key: text for key, text in FINDINGS.items() if not key.endswith("_model")}
    holds = [text for key, text in main.items() if all(by[key] for by in summary["findings"].values())]
    missed = {text: _missed(summary, key) for key, text in main.items()}
    fails = "; ".join(f"{text}: {', '.join(arms)}" for text, arms in missed.items() if arms)
    told = f"Missed, with the arms: {fails}." if fails else ""
    said.append((f"On every arm: {'; '.join(holds)}. " if holds else "") + told)
    rho, order = summary["ranking"]["mean"], summary["ranking"]["order"]
    best = dict.fromkeys(names[0] for names in order.values() if names)
    if rho is not None:
        said.append(f"The order of the solvers on one arm and on another: rank correlation {rho:.2f} on average.")
    elif max(map(len, order.values()), default=0) > 1:
        said.append(f"All solvers reach the same mu to a thousandth, or too few ran to rank them; first: "
                    f"{', '.join(best)}.")  # fmt: skip
    return said


def _missed(summary: Mapping[str, Any], finding: str) -> list[str]:
    """Return the arms on which a finding does not hold, with the figure where there is one."""
    found = []
    for arm, by in summary["findings"].items():
        if by[finding] is False:
            figures = summary["robots"][arm]
            value = figures.get(of(figures) or "", {}).get(JUDGED.get(finding, ""))
            found.append(arm if value is None else f"{arm} ({value:+.0f} %)")
    return found


def _table(summary: Mapping[str, Any]) -> Table:
    """Return one row an arm: what `exact`, or the first solver there is, does there."""
    rows = []
    for arm, figures in summary["robots"].items():
        row = figures.get(of(figures) or "", {})
        holds = summary["findings"][arm]
        cells = {key: _mark(holds[key], _short(row.get(change))) for key, change in JUDGED.items()}
        tails = row.get("tip_much_worse")
        share = row.get("mu_fraction_of_best")
        rows.append({
            "robot": arm, **cells, "broken": sum(other["broken"] for other in figures.values()),
            "best": None if share is None else 100.0 * share,
            "tails": _mark(holds["tails"], "–" if tails is None else f"{tails}/{row['trials']}"),
        })  # fmt: skip
    columns = [
        Column("robot", "arm", section=EACH),
        Column("broken", "broke off", format="d", section=RESULTS, help="runs of all controllers"),
        Column("gains", "mu", unit="%", section=FOUND, help=f"gain of the mean; ✔ {FINDINGS['gains']}"),
        Column("best", "of best", unit="%", format=".1f", section=RESULTS,
               help="of the best course from any swivel and branch"),
        Column("tip", "tip", unit="%", section=FOUND, help=f"change, settled; ✔ {FINDINGS['tip']}"),
        Column("tails", "tails", section=FOUND, help=f"trials of that many; ✔ {FINDINGS['tails']}"),
        Column("rcm", "RCM", unit="%", section=FOUND, help=f"change, settled; ✔ {FINDINGS['rcm']}"),
        Column("rcm_model", "RCM, own", unit="%", section=FOUND, help=FINDINGS["rcm_model"]),
    ]  # fmt: skip
    return Table(
        "Every arm against DCAC with the same gains", columns, rows,
        "✔ the finding holds by the mean, ✘ it does not; intervals are in the pictures. Errors in space hold the arm's "
        "calibration, which no controller sees; own: by the arm's own kinematics, what control answers for.",
    )  # fmt: skip


def _mark(holds: bool | None, text: str) -> Mark:
    known = UNKNOWN if holds is None else YES if holds else NO
    return Mark(known.symbol, text, known.tone, known.rank)


def _short(percent: float | None) -> str:
    return "open" if percent is None else f"{percent:+.1f}" if abs(percent) < 9.95 else f"{percent:+.0f}"


def _pictures(summary: Mapping[str, Any]) -> Sequence[Picture]:
    """Draw gain, tip and RCM error of every arm with their intervals, coloured by whether the finding holds."""
    asked = {
        "gains": ("gain of mean mu [%]", {"no gain": 0.0, "goal": LEAST_GAIN_PERCENT},
                  "Gain in mu over DCAC with its 95 % interval over the trials: {} of {} arms lie right of the goal by "
                  "their mean."),
        "tip": ("change of the settled tip error [%]", {"goal": MOST_CHANGE_PERCENT},
                "Change of the tip error once no elbow moves: {} of {} arms stay left of the goal by their mean."),
        "rcm": ("change of the settled RCM error [%]", {"goal": MOST_CHANGE_PERCENT},
                "Change of the RCM error from the registered trocar: {} of {} arms stay left of the goal by "
                "their mean; what of it is calibration, the last column of the table says."),
    }  # fmt: skip
    found = []
    for key, (x_label, limits, says) in asked.items():
        change, intervals, tones = JUDGED[key], {}, {}
        for arm, figures in summary["robots"].items():
            row = figures.get(of(figures) or "", {})
            if (ends := interval_of(row, change)) is not None:
                intervals[arm] = ends
                tones[arm] = {True: GOOD, False: WORST}.get(summary["findings"][arm][key], BAD)
        if intervals:
            held = sum(summary["findings"][arm][key] is True for arm in intervals)
            picture = interval_picture(intervals, tones, x_label, limits)
            found.append(Picture(picture, says.format(held, len(intervals)), f"arms-{key}"))
    return found

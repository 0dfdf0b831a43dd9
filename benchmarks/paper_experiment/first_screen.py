"""The first screen of ``python -m benchmarks.paper``: do the paper's claims hold for its own kind of network?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import plotly.graph_objects as go

from benchmarks.common.answer import Answer, Picture, interval_picture
from benchmarks.paper_experiment.tables import Summary
from benchmarks.paper_experiment.verdict import CLAIMS, FAILS, GAINS_ONLY, HOLDS, Claim
from moc_opt.comparison.statistics import spread
from moc_opt.figures.notation import Mark
from moc_opt.figures.style import GOOD, SERIES, WORST
from moc_opt.report.tables import Column, Table

NETWORK = "rnn"
"""The paper's kind of solver: a recurrent network that runs on from tick to tick."""
PRINTED = "paper"
"""The group with the paper's parameters, Table I as printed."""
MARKS = {HOLDS: ("✔", "good", 0), GAINS_ONLY: ("≈", "fair", 1), FAILS: ("✘", "bad", 2)}
TONES = {HOLDS: GOOD, GAINS_ONLY: list(SERIES)[4], FAILS: WORST}
WORDS = {"mu": "mu", "tip": "tip error", "rcm": "RCM error"}

Rows = Sequence[Mapping[str, Any]]


def answer(summary: Summary, groups: Sequence[str], drawn: Mapping[str, go.Figure]) -> Answer:
    """Make the first screen out of the summary.

    Args:
        groups: names, in the order of the report.
        drawn: every figure of the report by its file's name.
    """
    claims = _claims(summary)
    order = sorted(claims, key=lambda key: (key[0] != PRINTED, list(groups).index(key[0]), key[1] != NETWORK))
    found = [_sentence(summary, key, claims[key]) for key in order if key[0] == PRINTED]
    sentences = [*found[:2], _goals(summary, claims)]
    return Answer(sentences, _table(summary, order, claims), _pictures(order, claims, drawn))


def _claims(summary: Summary) -> dict[tuple[str, str], dict[str, Mapping[str, Any]]]:
    """Return (group, solver) -> claim -> its row of the verdicts."""
    names = {claim.name for claim in CLAIMS}
    found: dict[tuple[str, str], dict[str, Mapping[str, Any]]] = {}
    for row in summary["verdict"]:
        if row["claim"] in names:
            found.setdefault((row["group"], row["controller"]), {})[row["claim"]] = row
    return found


def _sentence(summary: Summary, key: tuple[str, str], mine: Mapping[str, Mapping[str, Any]]) -> str:
    """Return what the paper's parameters give with one solver."""
    group, solver = key
    held = [name for name, row in mine.items() if row["verdict"] == HOLDS]
    count = "All" if len(held) == len(mine) else "None" if not held else str(len(held))
    said = f"{count} of the paper's {len(mine)} claims {'holds' if len(held) == 1 else 'hold'} with `{solver}`"
    said += " (its own kind of network)" if solver == NETWORK else ""
    effects = [f"{WORDS[name]} {spread(row, 'matched_percent')} %" for name, row in mine.items()
               if spread(row, "matched_percent")]  # fmt: skip
    entries = summary.get(group, {}).get(solver, {})
    said += f" and Table I as printed: {', '.join(effects)} against DCAC with the same gains"
    trials, shook = entries.get("trials", 0), entries.get("oscillated", 0)
    return f"{said} ({trials:g} trials{f', {shook:g} of them shake' if shook else ''})."


def _goals(summary: Summary, claims: Mapping[tuple[str, str], Any]) -> str:
    """Return what fails, and how far our own goals are reached."""
    none = [solver for (group, solver), mine in claims.items()
            if group == PRINTED and all(row["verdict"] != HOLDS for row in mine.values())]  # fmt: skip
    goals = summary["goals"]
    missed = [goal["text"] for goal in goals if not goal["reached"]]
    said = f"No claim holds with `{'`, `'.join(none)}`. " if none else ""
    said += f"With our own gains {len(goals) - len(missed)} of {len(goals)} goals are reached"
    return said + (f"; missed: {'; '.join(missed)}." if missed else ".")


def _table(summary: Summary, order: Sequence[tuple[str, str]], claims: Mapping[tuple[str, str], Any]) -> Table:
    trials = max((summary.get(group, {}).get(solver, {}).get("trials", 0) for group, solver in order), default=0)
    rows = []
    for group, solver in order:
        entries = summary.get(group, {}).get(solver, {})
        cells = {claim.name: _mark(claim, row) for claim in CLAIMS if (row := claims[group, solver].get(claim.name))}
        rows.append({"group": group, "solver": solver, "shook": entries.get("oscillated"), **cells})
    columns = [
        Column("group", "parameters"),
        Column("solver", "solver"),
        *(Column(claim.name, WORDS[claim.name], unit="%", section=f"Group {order[0][0] if order else PRINTED}",
                 help=f"{claim.text}: change against DCAC with the same gains, 95 % interval") for claim in CLAIMS),
        Column("shook", "shook", format=".0f", better="low", help="trials in which a joint oscillated"),
    ]  # fmt: skip
    return Table(
        f"Do the paper's claims hold? Change against DCAC with the same gains, {trials:g} trials each", columns, rows,
        f"✔ {HOLDS}, ≈ {GAINS_ONLY} of DCAC, ✘ {FAILS}. In brackets the end of the 95 % interval that decides; mu is "
        f"claimed to rise by more than {CLAIMS[0].bound_percent:g} %.",
    )  # fmt: skip


def _mark(claim: Claim, row: Mapping[str, Any]) -> Mark:
    """Return the effect, and the end of its interval that decides."""
    symbol, tone, rank = MARKS[row["verdict"]]
    value, end = row.get("matched_percent"), row.get(f"matched_percent_{'low' if claim.upwards else 'high'}")
    said = "no trial" if value is None else _short(value)
    if value is not None and end is not None and end == end:
        said += f" ({'≥' if claim.upwards else '≤'}{_short(end)})"
    return Mark(symbol, said, tone, rank)


def _short(percent: float) -> str:
    return f"{percent:+.1f}" if abs(percent) < 9.95 else f"{percent:+.0f}"


def _pictures(
    order: Sequence[tuple[str, str]], claims: Mapping[tuple[str, str], Any], drawn: Mapping[str, go.Figure]
) -> list[Picture]:
    """Draw the effects with the paper's parameters, Figure 7 for mu, and what the start decides."""
    effects, tones = {}, {}
    for group, solver in order:
        for name, row in claims[group, solver].items():
            value, low, high = (row.get(f"matched_percent{end}") for end in ("", "_low", "_high"))
            if group == PRINTED and value is not None and low is not None and low == low:
                effects[f"{solver}: {WORDS[name]}"] = low, value, high
                tones[f"{solver}: {WORDS[name]}"] = TONES[row["verdict"]]
    found = []
    if effects:
        picture = interval_picture(effects, tones, "change against DCAC with the same gains [%]", {"no change": 0.0})
        found.append(Picture(
            picture, "Table I as printed: mu should lie right of +7 %, both errors left of zero, with their whole "
            "95 % interval.", "claims",
        ))  # fmt: skip
    if f"figure7-{PRINTED}-mu" in drawn:
        says = "The paper's Figure 7, upper row: manipulability over the ticks of all trials; higher is better."
        found.append(Picture(drawn[f"figure7-{PRINTED}-mu"], says, f"figure7-{PRINTED}-mu"))
    if "swivel" in drawn:
        says = "The start decides how much there is to gain: nothing from the best swivel (star), most from the worst."
        found.append(Picture(drawn["swivel"], says, "swivel"))
    return found

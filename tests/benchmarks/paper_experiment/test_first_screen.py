"""The paper's first screen opens with the verdict for the paper's own kind of network, whatever `exact` does."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from benchmarks.paper_experiment.first_screen import answer
from benchmarks.paper_experiment.verdict import FAILS, GAINS_ONLY, HOLDS

EFFECTS = {"mu": (16.3, 12.7, 20.1), "tip": (-8.6, -13.5, -3.6), "rcm": (-0.3, -10.6, 14.2)}


def row(group: str, solver: str, claim: str, verdict: str) -> dict[str, object]:
    value, low, high = EFFECTS[claim]
    return {"group": group, "controller": solver, "claim": claim, "verdict": verdict, "matched_percent": value,
            "matched_percent_low": low, "matched_percent_high": high}  # fmt: skip


def made(**verdicts: str) -> dict[str, object]:
    rows = [row("tuned", "exact", claim, FAILS) for claim in EFFECTS]
    rows += [row("paper", name, claim, said) for name, said in verdicts.items() for claim in EFFECTS]
    rows += [{"group": "paper", "controller": "exact", "claim": "force", "verdict": "follows", "text": "not counted"}]
    group = {name: {"trials": 45.0, "oscillated": 27 if name == "exact" else 0} for name in verdicts}
    goals = [{"text": "gain", "reached": True}, {"text": "RCM", "reached": False}]
    return {"verdict": rows, "paper": group, "tuned": {}, "goals": goals}


def test_it_opens_with_the_networks_verdict():
    first = answer(made(**{"exact": FAILS, "rnn": HOLDS, "rnn-printed": GAINS_ONLY}), ["tuned", "paper"], {})
    assert first.sentences[0].startswith("All of the paper's 3 claims hold with `rnn` (its own kind of network)")
    assert "mu 16.3 [12.7, 20.1] %" in first.sentences[0]
    assert "(45 trials)" in first.sentences[0]
    assert first.sentences[1].startswith("None of the paper's 3 claims hold with `exact`")
    assert "27 of them shake" in first.sentences[1]
    assert "No claim holds with `exact`, `rnn-printed`" in first.sentences[2]
    assert first.sentences[2].endswith("1 of 2 goals are reached; missed: RCM.")
    names = [(line["group"], line["solver"]) for line in first.table.rows]
    assert names == [("paper", "rnn"), ("paper", "exact"), ("paper", "rnn-printed"), ("tuned", "exact")]


@pytest.mark.parametrize(("verdict", "symbol"), [(HOLDS, "✔"), (GAINS_ONLY, "≈"), (FAILS, "✘")])
def test_the_end_of_the_interval_that_decides_stands_beside(verdict, symbol):
    (first, *_) = answer(made(rnn=verdict), ["paper", "tuned"], {}).table.rows
    assert [f"{first[claim].symbol} {first[claim].word}" for claim in EFFECTS] == [
        f"{symbol} +16 (≥+13)", f"{symbol} -8.6 (≤-3.6)", f"{symbol} -0.3 (≤+14)",
    ]  # fmt: skip


def test_it_fits_a_terminal():
    screen = Console(file=io.StringIO(), width=80, color_system=None)
    for part in answer(made(**{"exact": FAILS, "rnn": HOLDS}), ["paper", "tuned"], {}).screens(80):
        screen.print(part, markup=False)
    text = screen.file.getvalue()
    assert max(map(len, text.splitlines())) <= 80
    assert "…" not in text
    assert all(word in text for word in ("mu", "RCM", "shook", "tuned"))

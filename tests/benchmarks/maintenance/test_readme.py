"""The figures of the README come from results, and from nowhere else."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks.common.markdown import fill_section
from benchmarks.maintenance import readme

NAMES = ("paper", "speed")
README = "before\n" + "between\n".join(f"<!-- {name} -->\nold\n<!-- /{name} -->\n" for name in NAMES) + "after\n"
MACHINE = {"cores": 2, "processor": "a processor", "python": "3.11", "load_1min": 0.4}
GOALS = [
    {"goal": "gain", "text": "mean gain in mu [%], at least", "limit": 15.0, "reached": True, "open": "",
     "value": 24.27, "value_low": 16.5, "value_high": 33.7},
    {"goal": "rcm", "text": "mean of rcm_error_mean_mm, at most", "limit": 0.5, "reached": False, "open": "",
     "value": 0.6, "value_low": None, "value_high": None},
    {"goal": "tip_true_mean", "text": "mean tip error, base frame [mm], upper end at most", "limit": None,
     "reached": None, "open": "no goal", "value": 0.7},
    {"goal": "settled", "text": "a change [%], at most", "limit": 5.0, "reached": None, "open": "undecided",
     "value": 3.0, "value_of_ratios": 8.0},
]  # fmt: skip


SPEED = {
    "goals": {
        "first_torque": dict(what="first torque", unit="s", goal=0.5, kind="at most", value=0.342, reached="yes",
                             made_of="libraries 0.3 s"),
        "tick": dict(what="a peer over ours", unit="", goal=4.0, kind="at least", value=0.9, reached="no", made_of=""),
        "c_tick": dict(what="moc_step", unit="us", goal=4.0, kind="at most", value=None, reached="not measured",
                       made_of=""),
    },
    "tick": {"exact": {"tick_p50_us": 13.42}, "c": {"tick_p50_us": 2.51}},
    "peers": {
        "tsid": {"tick_p50_us": 12.64, "level": "torque", "installed": "hand"},
        "mink": {"tick_p50_us": 79.2, "level": "velocity", "installed": "make"},
    },
    "not_run": {"peer pink": {"reason": "package 'pink' is not installed"}, "solver osqp": {"reason": "no"}},
}  # fmt: skip


VERDICT = [
    {"group": group, "controller": name, "text": text, "verdict": verdict, "matched_percent": value,
     "matched_percent_low": value - 5.0, "matched_percent_high": value + 5.0}
    for group, name, text, verdict, value in (
        ("paper", "exact", "tip accuracy is better", "holds", -7.5),
        ("paper", "exact", "the RCM error is smaller", "does not hold", 3.0),
        ("paper", "rnn", "tip accuracy is better", "does not hold", -1.0),
        ("tuned", "exact", "tip accuracy is better", "holds", -77.0),
    )
]  # fmt: skip
ABLATION = [
    {"case": case, "about": about, "controller": "exact", "draw": "all", "claim": "tip", "trials": 45,
     "confirmed": case == "printed", "decides": case == "one"}
    for case, about in (("printed", "as printed"), ("one", "one number"), ("idle", "another lambda"))
]  # fmt: skip
SHOOK = {"exact": {"oscillated": 27, "trials": 45.0}, "rnn": {"oscillated": 0, "trials": 45.0}}
PAPER = {"goals": GOALS, "verdict": VERDICT, "ablation": ABLATION, "paper": SHOOK}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, summary in (("paper", PAPER), ("speed", SPEED)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "summary.json").write_text(json.dumps(summary))
        (tmp_path / name / "environment.json").write_text(json.dumps({"machine": MACHINE, "seed": 4, "threads": "1"}))
    (tmp_path / "README.md").write_text(README)
    return tmp_path


def arguments(folder: Path, *names: str) -> list[str]:
    given = [part for name in names for part in (f"--{name}", str(folder / name))]
    return [*given, "--readme", str(folder / "README.md")]


def test_a_section_is_written_and_nothing_else_is_touched(folder):
    assert readme.main(arguments(folder, "paper")) == 0
    text = (folder / "README.md").read_text()
    assert text.startswith("before\n<!-- paper -->\n")
    assert text.endswith("<!-- speed -->\nold\n<!-- /speed -->\nafter\n")
    assert text.count("\nold\n") == 1
    assert "between" in text
    assert "| mean gain in mu [%] | at least 15 | 24.3 [16.5, 33.7] |" in text
    assert "| mean of rcm_error_mean_mm | at most 0.5 | 0.6 (not reached) |" in text
    assert "| mean tip error, base frame [mm] | – | 0.7 |" in text
    assert "| a change [%] | at most 5 | 3 (mean of ratios 8) (undecided) |" in text
    assert readme.main(arguments(folder, "paper")) == 0
    assert (folder / "README.md").read_text() == text


def test_the_papers_claims_stand_beside_what_decides_on_them(folder):
    assert readme.main(arguments(folder, "paper")) == 0
    text = (folder / "README.md").read_text()
    assert "| claim | `exact` [%]; 27 of 45 runs oscillate | `rnn` [%] |" in text
    first = "| tip accuracy is better | -7.5 (-12.5 to -2.5): holds | -1.0 (-6.0 to +4.0): does not hold |"
    assert first in text
    assert "| the RCM error is smaller | +3.0 (-2.0 to +8.0): does not hold |  |" in text
    assert "-77" not in text
    assert "Replacements in Table I that turn a claim: one number (tip)." in text
    (folder / "paper" / "summary.json").write_text(json.dumps({"goals": GOALS}))
    assert readme.main(arguments(folder, "paper")) == 0
    assert "claim" not in (folder / "README.md").read_text()


def test_what_everything_costs(folder):
    assert readme.main(arguments(folder, "speed")) == 0
    text = (folder / "README.md").read_text()
    assert "| first torque [s] | 0.342 | at most 0.5 | libraries 0.3 s |" in text
    assert "| a peer over ours | 0.9 (not reached) | at least 4 |  |" in text
    assert "| moc_step [us] | not measured | at most 4 |  |" in text
    assert "[us]: c 2.5, exact 13.4." in text
    assert "[us]: tsid† (torque) 12.6, mink (velocity) 79.2.\n† not installed by `make`" in text
    assert "Not measured in this run: pink (package 'pink' is not installed).\n<!-- /speed -->" in text
    assert "osqp" not in text.split("<!-- speed -->")[1]
    assert "2 cores, a processor, one thread unless said otherwise, load 0.4" in text
    alone = {**SPEED, "peers": {}, "not_run": {}}
    unset = json.dumps({"machine": MACHINE, "seed": 4, "threads": None})
    (folder / "speed" / "environment.json").write_text(unset)
    (folder / "speed" / "summary.json").write_text(json.dumps(alone))
    assert readme.main(arguments(folder, "speed")) == 0
    text = (folder / "README.md").read_text()
    assert "none is installed" in text
    assert "†" not in text
    assert "a processor, OMP_NUM_THREADS not set, load" in text  # no claim of one thread where nobody limited them


def test_a_section_without_results_stays(folder):
    assert readme.main(arguments(folder, "paper")) == 0
    assert "<!-- speed -->\nold\n<!-- /speed -->" in (folder / "README.md").read_text()


@pytest.mark.parametrize(
    ("break_it", "said"),
    [
        (lambda folder: (folder / "README.md").write_text("<!-- speed -->\n"), "no lines <!-- speed -->"),
        (lambda folder: (folder / "speed" / "summary.json").write_text("{"), "not JSON"),
        (lambda folder: (folder / "speed" / "summary.json").unlink(), "summary.json"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_and_the_readme_stays(folder, break_it, said, capsys):
    break_it(folder)
    before = (folder / "README.md").read_text()
    assert readme.main(arguments(folder, "speed")) == 2
    assert said in capsys.readouterr().err
    assert (folder / "README.md").read_text() == before


def test_this_readme_has_both_places():
    text = (Path(__file__).resolve().parents[3] / "README.md").read_text()
    for name in ("solvers", "paper"):
        assert fill_section(text, name, "new", "README") != text

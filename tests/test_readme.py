"""The figures of the README come from results, and from nowhere else."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks import readme

README = "before\n<!-- solvers -->\nold\n<!-- /solvers -->\nbetween\n<!-- paper -->\nold\n<!-- /paper -->\nafter\n"
MACHINE = {"cores": 2, "processor": "a processor", "python": "3.11", "load_1min": 0.4}
OPEN = {
    "verified_solved": 9, "solves": 10, "silently_wrong": 1, "primal_max": 2e-9, "loss_max": 0.3, "solve_p50_us": 1.74,
    "solve_p99_us": 3.1,
}  # fmt: skip
CLOSED = {"mu_mean": 0.31, "tip_error_mean_mm": 0.3, "rcm_error_mean_mm": 1.5, "torque_rate_rms_Nm_per_s": 7.2}
SOLVERS = {
    "open_loop_warm": {"exact": OPEN, "nlp-sqp": OPEN, "qpsolvers:daqp": OPEN},
    "closed_loop": {"dcac": CLOSED, "exact": {**CLOSED, "mu_gain_percent": 65.5}},
    "testsets": {
        "osqp@default": {"silently_wrong": 3, "solves": 50}, "daqp@default": {"silently_wrong": 30, "solves": 50},
        "piqp@default": {"silently_wrong": 0, "solves": 50}, "exact@recommended": {"silently_wrong": 0, "solves": 50},
    },
}  # fmt: skip
GOALS = [
    {"text": "mean gain in mu [%], at least", "limit": 15.0, "reached": True, "value": 24.27, "value_low": 16.5,
     "value_high": 33.7},
    {"text": "mean of rcm_error_mean_mm, at most", "limit": 0.5, "reached": False, "value": 0.6, "value_low": None,
     "value_high": None},
]  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, summary in (("solvers", SOLVERS), ("paper", {"goals": GOALS})):
        (tmp_path / name).mkdir()
        (tmp_path / name / "summary.json").write_text(json.dumps(summary))
        (tmp_path / name / "environment.json").write_text(json.dumps({"machine": MACHINE, "seed": 4}))
    (tmp_path / "README.md").write_text(README)
    return tmp_path


def arguments(folder: Path, *names: str) -> list[str]:
    given = [part for name in names for part in (f"--{name}", str(folder / name))]
    return [*given, "--readme", str(folder / "README.md")]


def test_both_sections_are_written_and_nothing_else_is_touched(folder):
    assert readme.main(arguments(folder, "solvers", "paper")) == 0
    text = (folder / "README.md").read_text()
    assert text.startswith("before\n<!-- solvers -->\n")
    assert text.endswith("<!-- /paper -->\nafter\n")
    assert "old" not in text
    assert "between" in text
    assert "| `exact` | 9/10 | 1 | 2e-09 | 3e-01 | 1.7 | 3.1 | 0.3100 | 65.5 | 0.300 | 1.500 |  | 7 |" in text
    assert "`nlp-sqp`*" in text
    assert "qpsolvers" not in text
    assert "50 problems" in text
    assert "daqp 30, osqp 3." in text
    assert "piqp" not in text
    assert "| mean gain in mu [%] | at least 15 | 24.3 | 16.5 to 33.7 |" in text
    assert "| mean of rcm_error_mean_mm | at most 0.5 | 0.6 (not reached) |  |" in text
    assert readme.main(arguments(folder, "solvers", "paper")) == 0
    assert (folder / "README.md").read_text() == text


def test_a_section_without_results_stays(folder):
    assert readme.main(arguments(folder, "paper")) == 0
    assert "<!-- solvers -->\nold\n<!-- /solvers -->" in (folder / "README.md").read_text()


@pytest.mark.parametrize(
    ("break_it", "said"),
    [
        (lambda folder: (folder / "README.md").write_text("<!-- solvers -->\n"), "no lines <!-- solvers -->"),
        (lambda folder: (folder / "solvers" / "summary.json").write_text("{"), "not JSON"),
        (lambda folder: (folder / "solvers" / "summary.json").unlink(), "summary.json"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_and_the_readme_stays(folder, break_it, said, capsys):
    break_it(folder)
    before = (folder / "README.md").read_text()
    assert readme.main(arguments(folder, "solvers")) == 2
    assert said in capsys.readouterr().err
    assert (folder / "README.md").read_text() == before


def test_this_readme_has_both_places():
    text = (Path(__file__).parent.parent / "README.md").read_text()
    for name in ("solvers", "paper"):
        assert readme.filled(text, name, "new") != text

"""One run as a table and as JSON: the ending first, figures of a part marked, nothing that JSON does not know."""

import json

import numpy as np
import pytest

from moc_opt.__main__ import main
from moc_opt.report.console import print_json
from moc_opt.report.run_table import part, run_json, run_table, warnings
from moc_opt.trace.trace import Trace

WARNING = {"of": "the RCM error", "first_s": 1.25, "largest": 11.04, "unit": "mm", "level": 6.0}


def trace(ended="completed", ticks=4, **meta):
    counts = {"period_s": 0.1, "ticks": ticks, "ticks_planned": 4}
    return Trace({"t_s": 0.1 * np.arange(ticks)}, {"ended": ended, **counts, **meta})


def test_only_a_run_that_was_broken_off_is_a_part():
    assert part(trace()) == part(trace("oscillated: joint_7")) == ""
    assert part(trace("stopped: x", 3)) == " (first 0.3 s of 0.4 s)"
    assert part(Trace({"t_s": [0.0]})) == ""  # of an older version: nothing is known


def test_the_ending_is_the_first_row_and_a_parts_figures_say_so():
    metrics = {"completed": 0.0, "share_of_run": 0.75, "mu_mean": 0.25}
    table = run_table("slip", trace("stopped: x", 3, warnings=[WARNING]), metrics)
    assert [row["metric"] for row in table.rows] == [
        "ended", "completed", "share_of_run", "mu_mean (part)"
    ]  # fmt: skip
    assert table.title == "slip (first 0.3 s of 0.4 s)"
    assert table.rows[0]["value"] == "stopped: x"
    assert "the RCM error was above 6 mm from t = 1.250 s on, 11 mm at most" in " ".join(table.to_text().split())
    whole = run_table("slip", trace(), metrics)
    assert [row["metric"] for row in whole.rows] == ["ended", *metrics]
    assert warnings(trace()) == []


@pytest.mark.parametrize(("raised", "most"), [(1, False), (2, False), (3, True)])
def test_a_solver_that_was_replaced_is_named_before_any_figure(raised, most):
    """A run whose answers all came from the fallback completes like any other: it must not read like one."""
    faults = {"raised": {"count": raised, "first_at_s": 0.0, "first": "ZeroDivisionError"}}
    table = run_table("slip", trace(faults=faults), {"mu_mean": 0.25})
    assert [row["metric"] for row in table.rows] == ["ended", "solver replaced", "mu_mean"]
    said = table.rows[1]["value"]
    assert said.startswith(f"at {raised} of 4 ticks")
    assert f"raised {raised}" in said
    assert ("not this solver's" in said) == most
    found = run_json(trace(faults=faults), {"mu_mean": 0.25})
    assert found["solver_replaced"] == said
    assert list(found).index("solver_replaced") < list(found).index("mu_mean")
    assert "solver_replaced" not in run_json(trace(), {})


def test_json_begins_with_the_ending_and_is_json(capsys):
    found = run_json(trace("stopped: x", 3, warnings=[WARNING]), {"mu_mean": float("nan"), "loss_max": np.inf})
    print_json(found)
    text = capsys.readouterr().out
    assert text.lstrip("{ \n").startswith('"ended": "stopped: x"')
    assert json.loads(text, parse_constant=pytest.fail) == {
        "ended": "stopped: x", "part": "first 0.3 s of 0.4 s", "mu_mean": None, "loss_max": None,
        "warnings": [WARNING], "faults": {},
    }  # fmt: skip
    assert "part" not in run_json(trace(), {})


@pytest.mark.parametrize(
    ("solver", "law", "shown"), [("nlp-sqp", "moc", "–"), ("osqp", "moc", "4"), ("nlp-sqp", "dcac", "4")]
)
def test_verdicts_of_the_linear_problem_are_not_passed_on_answers_to_another(solver, law, shown):
    run = trace(scenario={"solver": {"name": solver}, "control": {"law": law}})
    metrics = {"mu_mean": 0.2, "verified_solved": 4.0, "silently_wrong": 4.0}
    table = run_table("x", run, metrics, first=True)
    (value,) = (cells for column in table.columns if column.key == "value" for cells in [table.cells(column)])
    assert [cell.text for cell in value] == ["completed", "0.2000", shown, shown]
    assert ("nonlinear" in table.caption) == (shown == "–")
    assert run_json(run, metrics)["silently_wrong"] == (None if shown == "–" else 4.0)
    assert "silently_wrong" not in run_json(run, {})


@pytest.mark.parametrize(
    ("table", "status", "ended"),
    [
        ("", 0, "completed"),
        ("[plant]\nfriction = 0.0\n", 3, "oscillated: joint_7 at "),
        ("[guard]\nrcm_error_m = 1e-5\nrcm_warning_m = 1e-5\n", 3, "stopped: the RCM error has been above 0.01 mm"),
    ],
    ids=["completed", "oscillated", "stopped"],
)
def test_the_exit_status_tells_success_from_the_rest(tmp_path, capsys, table, status, ended):
    file = tmp_path / "s.toml"
    file.write_text(
        'name = "one"\nduration_s = 2.0\nbound_samples = 0\njudge = false\n'
        f"[control]\nK_X = 3000.0\nD_X = 80.0\nK_N = 800.0\nD_N = 60.0\nK_N2 = 80.0\nD_N2 = 1.0\n{table}"
    )
    assert main(["run", str(file), "--json"]) == status
    said = capsys.readouterr()
    found = json.loads(said.out, parse_constant=pytest.fail)
    assert found["ended"].startswith(ended)
    assert found["completed"] == float(status == 0)
    assert ("one: " + found["ended"] in said.err) == (status != 0)
    if ended.startswith("stopped"):
        assert found["share_of_run"] < 1.0
        assert [w["of"] for w in found["warnings"]] == ["the RCM error"]
        # DCAC is stopped even sooner, or later: a part is compared with the same part, or with nothing
        assert "mu_gain_percent" in found or "not compared with DCAC" in said.err
    else:
        assert "mu_gain_percent" in found

"""One run as a table and as JSON: the ending first, figures of a part marked, nothing that JSON does not know."""

import json

import numpy as np
import pytest

from moc_opt.__main__ import main
from moc_opt.report.console import print_json
from moc_opt.report.run_table import MATTER, below_best, in_short, part, run_json, run_table, warnings
from moc_opt.trace.metrics import METRICS
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


def test_the_share_of_the_largest_mu_comes_with_how_that_was_found():
    figures = {"mu_fraction_of_bound": 0.9, "tip_error_mean_mm": 0.3}
    found = trace(mu_bound_method="best found of 96 starts")
    rows = run_table("rail", found, figures).rows
    assert [row["metric"] for row in rows[1:3]] == ["mu_fraction_of_bound", "mu_bound_method"]
    assert rows[2]["says"]
    assert rows[2]["value"] == run_json(found, figures)["mu_bound_method"] == "best found of 96 starts"
    assert "mu_bound_method" not in run_json(trace(), figures)


END = {"top_mu": 0.2, "top_swivel_deg": 40.0, "at_limit": False, "best_mu": 0.3, "best_swivel_deg": -103.0, "mu": 0.2}


@pytest.mark.parametrize(
    ("mu", "end", "third_level", "said"),
    [
        (0.295, {}, "local", ""),
        (0.24, {}, "local", "trapped: mean mu is 20.0 % below the best course from this start; it ends at the local "
         "maximum at swivel 40 deg (0.200 m^3), the course at -103 deg (0.300 m^3)"),
        (0.24, {"at_limit": True}, "local", "held by a joint limit"),
        ([0.2, 0.22, 0.242, 0.298], {"top_mu": 0.298}, "local", "ends at the best pose"),
        (0.24, {"top_mu": 0.298}, "local", "at its end it is still 19.5 % below the local maximum uphill of it"),
        (0.24, {}, "planned", "20.0 % below"),
    ],
)  # fmt: skip
def test_what_holds_a_run_below_its_best_course_is_said(mu, end, third_level, said):
    run = trace(
        best_courses={"absent": "", "end": {**END, **end}},
        scenario={"control": {"law": "moc", "third_level": third_level}},
    ).with_columns(mu=np.broadcast_to(mu, 4), mu_best_from_start=[0.3] * 4)
    assert said in below_best(run)
    assert bool(said) == bool(below_best(run))
    assert ("the local law" in below_best(run)) == (bool(said) and third_level == "local" and "uphill" not in said)


def test_why_there_is_no_best_course_is_said():
    assert "three freedoms" in below_best(trace(best_courses={"absent": "three freedoms"}))
    assert below_best(trace()) == ""


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


def test_each_figure_has_the_notation_that_suits_it():
    """In one notation for all, one rounding error would turn millimetres and counts into powers of ten."""
    figures = {"tip_error_mean_mm": 0.28412, "claimed_solved": 4034.0, "primal_max": 2.91e-16, "mu_mean": float("nan")}
    table = run_table("circle", trace(), figures)
    assert [row["value"] for row in table.rows[1:4]] == ["0.2841", "4034", "2.910e-16"]
    assert table.to_text().count("e-") == 1


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


def test_help_says_what_the_status_means(capsys):
    with pytest.raises(SystemExit):
        main(["run", "--help"])
    assert "Exit status: 0" in capsys.readouterr().out


def test_numbers_are_written_as_people_write_them():
    metrics = {"claimed_solved": 4034.0, "mu_mean": 0.31471, "primal_max": 2.7e-16, "torque_rate_rms_Nm_per_s": 5069.4}
    values = [row["value"] for row in run_table("run", trace(), metrics).rows][1:]
    assert values == ["4034", "0.3147", "2.700e-16", "5069"]


def test_what_to_look_at_first_is_a_part_of_the_whole_and_says_what_it_is():
    figures = dict.fromkeys(METRICS, 0.5)
    short, whole = (run_table("run", trace(), figures, first=first) for first in (True, False))
    names = [row["metric"] for row in short.rows]
    assert names[0] == "ended"
    assert set(names[1:]) == set(MATTER)
    assert all(row["says"] == MATTER[row["metric"]] for row in short.rows[1:])
    assert set(METRICS) <= {row["metric"] for row in whole.rows}
    assert set(MATTER) <= set(METRICS)
    cut = run_table("run", trace("stopped: x", 3), figures, first=True)
    assert "mu_mean (part)" in [row["metric"] for row in cut.rows]


def test_the_main_figures_in_one_sentence():
    figures = {"mu_gain_percent": -3.21, "tip_error_model_mean_mm": 0.126, "rcm_error_max_mm": 1.5, "silently_wrong": 2}
    assert in_short(figures) == (
        "mean mu is 3.2 % below DCAC's, the tip is 0.13 mm off its path on average, the shaft at most 1.50 mm off the "
        "trocar, 2 answers were silently wrong"
    )
    assert in_short({"silently_wrong": 0.0, "mu_gain_percent": 8.0}) == (
        "mean mu is 8.0 % above DCAC's, no answer was silently wrong"
    )
    assert in_short({"silently_wrong": 1.0}) == "1 answer was silently wrong"
    assert in_short({"mu_mean": 0.3}) == ""

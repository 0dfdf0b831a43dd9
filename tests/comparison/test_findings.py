"""What a comparison shows: means over whole trials, verdicts that fit, tables as wide as the terminal."""

import io

import pytest
from rich.console import Console

import moc_opt as mo
from moc_opt.comparison.findings import Comparison

SHORT = mo.Scenario(duration_s=0.3, bound_samples=0)


def row(solver, seed, **more):
    """A run that came to its end."""
    figures = {"solve_p50_us": 12.34, "solve_p99_us": 345.6, "tip_error_model_mean_mm": 0.0412 + 0.01 * seed,
               "rcm_error_model_mean_mm": 0.246 - 0.1 * seed, "mu_mean": 0.2123 + 0.01 * seed}  # fmt: skip
    return {"solver": solver, "seed": seed, "ended": "completed", "asked": 4, **figures, **more}


def drawn(found, width):
    console = Console(file=io.StringIO(), width=width, color_system=None)
    for table in found.tables(width):
        console.print(table)
    return console.file.getvalue()


@pytest.fixture(scope="module")
def wide():
    names = ["dcac", "exact", "qpsolvers:quadprog", "nlp-sqp"]
    judged = {"verified_solved": 4, "silently_wrong": 0}
    rows = [row(n, seed, **({} if n == "nlp-sqp" else judged)) for seed in range(3) for n in names[1:]]
    return Comparison([*rows, *(row("dcac", seed, asked=0) for seed in range(3))], names, SHORT)


def test_runs_that_broke_off_are_counted_and_enter_no_mean():
    rows = [
        {"solver": name, "seed": seed, "ended": ended, "asked": 0, "mu_mean": mu}
        for name, seed, ended, mu in (
            ("dcac", 0, "completed", 0.2), ("dcac", 1, "completed", 0.2), ("exact", 0, "stopped: off", 9.0),
            ("exact", 1, "oscillated: joint_3", 0.3),
        )
    ]  # fmt: skip
    found = Comparison(rows, ["dcac", "exact"], SHORT)
    assert found.mean("exact", "mu_mean").value == pytest.approx(0.3)
    assert found.change("exact", "mu_mean").value == pytest.approx(50.0)
    assert [row["trials"] for row in found.table.rows] == ["2", "1 of 2"]
    assert "oscillated" in found.table.to_text()


def test_one_run_that_fails_leaves_the_figures_of_the_others():
    rows = [
        {"solver": "exact", "seed": 0, "ended": "failed: MemoryError", "asked": 0},
        {"solver": "exact", "seed": 1, "ended": "completed", "asked": 4, "verified_solved": 4, "silently_wrong": 0,
         "solve_p50_us": 1.0, "solve_p99_us": 2.0, "mu_mean": 0.3},
    ]  # fmt: skip
    summary = Comparison(rows, ["dcac", "exact"], SHORT).summary()["exact"]
    assert (summary["verified"], summary["solve_p50_us"], summary["trials"], summary["of"]) == (100.0, 1.0, 1, 2)


@pytest.mark.parametrize("width", [60, 80, 100, 200])
def test_no_terminal_breaks_a_cell_or_a_heading(wide, width):
    text = drawn(wide, width)
    assert max(map(len, text.splitlines())) <= width
    assert "\u2026" not in text
    assert "..." not in text
    low, high = wide.mean("exact", "tip_error_model_mean_mm")[1:3]
    for whole in ("qpsolvers:quadprog ", " silently ", " verified ", f"[{low:.3g}, {high:.3g}]"):
        assert any(whole in f" {line} " for line in text.splitlines()), whole
    assert text.count("(continued)") == 0


def test_at_80_columns_every_mean_stands_in_one_table_and_the_intervals_in_the_other(wide):
    means, limits = (text.splitlines() for text in drawn(wide, 80).split("The same: 95 % intervals"))
    for name in wide.solvers:
        (line,) = (line.split() for line in means if line.split()[:1] == [name])
        assert line[1] == "3"
        assert "0.0512" in line  # the mean tip error
        (line,) = (line for line in limits if line.split()[:1] == [name])
        low, high = wide.mean(name, "tip_error_model_mean_mm")[1:3]
        assert f"[{low:.3g}, {high:.3g}]" in line


@pytest.mark.parametrize("columns", [60, 80, 300])
def test_its_text_is_as_wide_as_the_terminal(wide, columns, monkeypatch):
    monkeypatch.setenv("COLUMNS", str(columns))
    said = repr(wide)
    assert max(map(len, said.splitlines())) <= columns
    assert ("The same: 95 %" in said) == (columns < 300)
    assert said.split() == drawn(wide, columns).split()
    title = repr(wide.table).splitlines()[0]
    assert title == "circle: solvers on the same trials"


@pytest.mark.parametrize(("trials", "told"), [(1, False), (2, True), (7, True), (8, False)])
def test_few_trials_are_told_to_have_too_short_intervals(trials, told):
    found = Comparison([row("dcac", seed) for seed in range(trials)], ["dcac"], SHORT)
    assert ("intervals are too short" in found.table.caption) == told


def test_one_trial_has_no_table_of_intervals():
    names = ["dcac", "a_rather_long_name_of_a_solver"]
    found = Comparison([row(name, 0) for name in names], names, SHORT)
    assert "intervals of the means" not in drawn(found, 70)


def test_an_answer_to_another_problem_is_neither_verified_nor_wrong():
    found = mo.compare(["nlp-sqp", "exact"], mo.Scenario(duration_s=0.04, bound_samples=0), trials=1)
    summary = found.summary()
    assert "silently_wrong" not in summary["nlp-sqp"]
    assert "verified" not in summary["nlp-sqp"]
    assert summary["exact"]["verified"] == 100.0
    assert "nlp-* answer the nonlinear problem" in found.table.caption
    assert "solve_p50_us" in summary["nlp-sqp"]
    alone = Comparison([r for r in found.rows if r["solver"] != "nlp-sqp"], ["dcac", "exact"], SHORT)
    assert "nlp-" not in alone.table.caption

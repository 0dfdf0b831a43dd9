"""What is shown while the study runs: the answer grows, a new headline is said once, Ctrl-C leaves what is known."""

from __future__ import annotations

import io

from rich.console import Console

from benchmarks.solver_study.progress import Progress

ALL = {"solves": 8, "right": 8, "claimed_solved": 8, "verified_solved": 8, "optima_asked": 8, "infeasible_asked": 0,
       "refused_inconsistent": 0}  # fmt: skip
SETS = {"exact@recommended": {**ALL, "silently_wrong": 0, "hung": 0}}
WARM = {"exact": {**ALL, "solve_p50_us": 1.0, "solve_p99_us": 2.0}}
LOOP = {"exact": {"runs": 3, "mu_mean": 0.3}}


class Bar:
    """Counts what a bar is told."""

    def __init__(self) -> None:
        self.done, self.now = 0.0, ""

    def at(self, text: str) -> None:
        self.now = text

    def advance(self, steps: float) -> None:
        self.done += steps


def watch(**settings: object) -> tuple[Progress, io.StringIO]:
    file = io.StringIO()
    screen = Console(file=file, width=80, color_system=None, **settings)  # type: ignore[arg-type]
    return Progress({"testsets": 2.0, "growth": 0.5}, screen, 2000.0), file


def test_steps_weigh_what_their_part_takes():
    shown, _ = watch()
    shown.bar = bar = Bar()  # type: ignore[assignment]
    for part, text in (("testsets", "a"), ("growth", "b"), ("other", "c")):
        shown.enter(part)
        shown.advance(text)
    assert (bar.done, bar.now) == (2.5, "c")


def test_a_headline_is_said_once_it_stands_and_when_it_changes():
    shown, file = watch()
    shown.show({"open_loop_warm": {**WARM, "osqp": WARM["exact"]}})
    shown.show({"testsets": SETS})
    assert file.getvalue() == "", "osqp has not answered yet"
    shown.show({"testsets": {**SETS, "osqp@recommended": {**SETS["exact@recommended"], "silently_wrong": 8}}})
    shown.show({"closed_loop": LOOP})
    assert file.getvalue().count("so far: Take `exact`") == 1
    shown.show({"testsets": {"exact@recommended": {**SETS["exact@recommended"], "silently_wrong": 1}}})
    assert file.getvalue().count("so far: ") == 1, "osqp has no answer any more"
    wrong = {**SETS["exact@recommended"], "silently_wrong": 1}
    shown.show({"testsets": {"exact@recommended": wrong, "osqp@recommended": wrong}})
    assert "No solver is sound" in file.getvalue()


def test_a_terminal_sees_the_table_fill():
    shown, file = watch(force_terminal=True)
    assert list(shown.below()) == []
    shown.show({"open_loop_warm": WARM})
    assert file.getvalue() == ""
    sentence, table = shown.below()
    assert "exact" in sentence
    assert table.row_count == 1
    shown.show({"open_loop_warm": {**WARM, "osqp": WARM["exact"]}})
    assert list(shown.below())[1].row_count == 2


def test_what_is_known_is_printed_when_it_is_stopped():
    shown, _ = watch()
    out = Console(file=io.StringIO(), width=80, color_system=None)
    shown.interrupted(out)
    assert out.file.getvalue() == ""
    shown.show({"testsets": SETS, "open_loop_warm": WARM})
    shown.interrupted(out)
    assert "As far as the study has come" in out.file.getvalue()
    assert "★ take" in out.file.getvalue()

"""The terminal: silent where nobody watches, JSON that machines can read."""

from __future__ import annotations

import io
import json
import math
import time

import numpy as np
import pytest
from rich.console import Console

from moc_opt.inputs.files import plain
from moc_opt.report.console import console, print_json, progress
from moc_opt.report.tables import Column, Table


def terminal() -> tuple[Console, io.StringIO]:
    file = io.StringIO()
    return Console(file=file, force_terminal=True, width=100), file


@pytest.mark.parametrize(("columns", "width"), [(None, 80), ("132", 132), ("wide", 80)])
def test_a_file_gets_plain_text_as_wide_as_a_terminal(
    columns: str | None, width: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("COLUMNS", raising=False)
    if columns is not None:
        monkeypatch.setenv("COLUMNS", columns)
    file = io.StringIO()
    long = "x" * 300
    console(file=file).print(Table("t", [Column("a", "a")], [{"a": long}]).to_rich())
    lines = file.getvalue().splitlines()
    assert "".join(line.strip() for line in lines).count("x") == 300, "nothing is cut off"
    assert width - 4 <= max(map(len, lines)) <= width
    assert "\x1b" not in file.getvalue()


def test_progress_is_silent_without_a_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    with progress("working", 3, patience_s=0.0) as bar:
        for _ in range(3):
            bar.advance()
            time.sleep(0.02)
    assert capsys.readouterr() == ("", "")


def test_a_file_gets_a_line_now_and_then(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = iter(range(0, 1000, 4))
    monkeypatch.setattr("moc_opt.report.console.time.monotonic", lambda: float(next(clock)))
    file = io.StringIO()
    with progress("trials", 8, on=console(file=file)) as bar:
        for k in range(8):
            bar.at(f"step {k}")
            bar.advance()
    lines = file.getvalue().splitlines()
    assert 1 <= len(lines) < 8, "not one a step"
    assert all(line.startswith("trials: ") and " left  step " in line for line in lines)
    assert "\x1b" not in file.getvalue()


def test_the_time_left_does_not_count_what_the_first_step_took(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 0.0
    monkeypatch.setattr("moc_opt.report.console.time.monotonic", lambda: now)
    file = io.StringIO()
    with progress("run", 100, on=console(file=file)) as bar:
        now = 480.0  # it compiled
        bar.advance()
        now = 495.0
        bar.advance()
    first, second = file.getvalue().splitlines()
    assert first.rstrip() == "run: 1 % after 0:08:00"
    assert second.rstrip() == "run: 2 % after 0:08:15, about 0:24:30 left"


def test_what_is_known_stands_below_the_bar() -> None:
    where, file = terminal()
    with progress("working", 3.0, on=where, patience_s=0.0, below=lambda: ["the answer so far"]) as bar:
        bar.advance(1.5)
        deadline = time.monotonic() + 60.0
        while "the answer so far" not in file.getvalue() and time.monotonic() < deadline:
            time.sleep(0.02)
    assert "the answer so far" in file.getvalue()


def test_short_work_shows_no_bar() -> None:
    where, file = terminal()
    with progress("working", 3, on=where) as bar:
        bar.advance()
    assert file.getvalue() == ""


def test_long_work_shows_a_bar_even_within_its_first_step() -> None:
    where, file = terminal()
    with progress("working [bold]", 3, on=where, patience_s=0.02) as bar:
        bar.at("first\x1b[31m")
        deadline = time.monotonic() + 60.0
        while "first" not in file.getvalue() and time.monotonic() < deadline:
            time.sleep(0.02)
    shown = file.getvalue()
    assert "working [bold]" in shown
    assert "first" in shown
    assert "\x1b[31mfirst" not in shown
    assert "first\x1b[31m" not in shown


def test_a_file_is_told_what_takes_long_within_the_first_step(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("moc_opt.report.console.LINE_EVERY_S", 0.02)
    file = io.StringIO()
    with progress("ticks", 3, on=console(file=file)) as bar:
        bar.at("compiles")
        deadline = time.monotonic() + 60.0
        while not file.getvalue() and time.monotonic() < deadline:
            time.sleep(0.02)
    assert file.getvalue().splitlines() == ["ticks  compiles"]


def test_an_error_ends_the_bar() -> None:
    where, file = terminal()

    def work() -> None:
        with progress("working", 3, on=where, patience_s=0.0):
            time.sleep(0.05)
            raise RuntimeError

    with pytest.raises(RuntimeError):
        work()
    assert "\x1b[?25h" in file.getvalue(), "the cursor is back"


def test_json_has_no_nan() -> None:
    file = io.StringIO()
    values = {
        "a": np.float64(1.5),
        "b": [np.nan, math.inf],
        "c": {"d": np.arange(2)},
        "e": True,
        "f": None,
        "g": "x",
    }
    print_json(values, file)
    read = json.loads(file.getvalue(), parse_constant=lambda name: pytest.fail(name))
    assert read == {"a": 1.5, "b": [None, None], "c": {"d": [0, 1]}, "e": True, "f": None, "g": "x"}
    assert plain((np.int64(3),)) == [3]

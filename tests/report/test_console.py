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


def terminal() -> tuple[Console, io.StringIO]:
    file = io.StringIO()
    return Console(file=file, force_terminal=True, width=100), file


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

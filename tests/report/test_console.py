"""The terminal: silent where nobody watches, JSON that machines can read."""

from __future__ import annotations

import io
import json
import math

import numpy as np
import pytest
from rich.console import Console

from moc_opt.inputs.files import plain
from moc_opt.report.console import console, print_json, progress


@pytest.mark.parametrize("every_s", [10.0, 0.0])
def test_without_a_terminal_progress_writes_a_line_now_and_then(
    every_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("moc_opt.report.console.LINE_EVERY_S", every_s)
    file = io.StringIO()
    with progress("trials", on=console(file=file)) as bar:
        bar.of(4)
        for k in range(4):
            bar.at(f"step {k}")
            bar.advance()
    lines = file.getvalue().splitlines()
    assert len(lines) == (0 if every_s else 4)
    assert all(line.startswith(f"trials: {25 * (k + 1)} % after 0:00:0") for k, line in enumerate(lines))
    assert all(line.endswith(f"left  step {k}") for k, line in enumerate(lines))
    assert "\x1b" not in file.getvalue()


def test_a_terminal_shows_a_bar_what_is_done_and_what_is_known() -> None:
    file = io.StringIO()
    where = Console(file=file, force_terminal=True, width=100)
    with progress("working [bold]", 3, on=where, below=lambda: ["so far: nothing"]) as bar:
        bar.at("first\x1b[31m")
        bar.refresh()
    shown = file.getvalue()
    assert all(words in shown for words in ("working [bold]", "first", "so far: nothing"))
    assert "first\x1b[31m" not in shown


def test_json_has_no_nan() -> None:
    file = io.StringIO()
    values = {"a": np.float64(1.5), "b": [np.nan, math.inf], "c": {"d": np.arange(2)}, "e": True, "f": None, "g": "x"}
    print_json(values, file)
    read = json.loads(file.getvalue(), parse_constant=lambda name: pytest.fail(name))
    assert read == {"a": 1.5, "b": [None, None], "c": {"d": [0, 1]}, "e": True, "f": None, "g": "x"}
    assert plain((np.int64(3),)) == [3]

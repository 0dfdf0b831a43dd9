"""Tables and progress in the terminal."""

import io
import math
import re
from datetime import timedelta

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from moc_opt.figures.notation import Missing, Notation
from moc_opt.report.console import Bar, console
from moc_opt.report.tables import Cell, Column, Table


def cells(values: list[object], **options: object) -> list[Cell]:
    column = Column("value", "time", "us", **options)  # type: ignore[arg-type]
    return Table("Times", [column], [{"value": value} for value in values]).cells(column)


def texts(values: list[object], **options: object) -> list[str]:
    return [cell.text for cell in cells(values, **options)]


def best(values: list[object], **options: object) -> list[bool]:
    return [cell.best for cell in cells(values, **options)]


def test_numbers_of_a_column_have_the_same_notation() -> None:
    assert texts([1.702, 2370.16, 48.04]) == ["1.70", "2370", "48.0"]
    assert texts([5.4e-16, 0.0, 0.12]) == ["5.40e-16", "0", "1.20e-1"]
    assert texts([4034.0, 0, np.int64(7)]) == ["4034", "0", "7"]
    assert texts([12_000, 1]) == ["12\u202f000", "1"]
    assert texts([1.25, -2.0], format="+.1f") == ["+1.2", "-2.0"]
    assert texts([3.0, 2.5], format="d") == ["3", "2"]
    assert texts([1.2e-7, 0.0, 3.0e12], format=".1e") == ["1.2e-7", "0", "3.0e12"]
    assert texts([9.996, 0.5]) == ["10.0", "0.500"]


@given(st.floats(1e-4, 9.9e5), st.integers(1, 8))
def test_the_digits_asked_for_are_kept(value: float, digits: int) -> None:
    written = Notation(digits)(value)
    assert "e" not in written
    assert float(written) == pytest.approx(value, rel=0.51 * 10 ** (1 - digits))


def test_special_values_are_written_as_symbols_or_words() -> None:
    values = [None, math.nan, Missing("not asked"), math.inf, -math.inf, 1.5]
    assert texts(values) == ["–", "–", "–", "∞", "-∞", "1.50"]
    assert texts([True, np.bool_(False)]) == ["yes", "no"]


def test_best_values_are_marked() -> None:
    assert best([2.0, 1.0, None, math.inf, 1.0004], better="low") == [False, True, False, False, True]
    assert best([2.5, 1.0, -math.inf, math.inf], better="high") == [True, False, False, False]
    assert best([1.0, 1.0, 1.0, 2.0], better="low") == [False] * 4, "no value is marked if most are best"
    assert best([1.0, 1.0, 2.0], better="low") == [False] * 3
    assert best([1.0, 1.0, 3.0, 2.0], better="low") == [True, True, False, False]
    assert (best([2.0, 1.0]), best([2.0, None], better="low")) == ([False, False], [False, False])
    made = Table("t", [Column("us", "time", better="low", among="ok")],
                 [{"us": 0.1, "ok": False}, {"us": 9.0, "ok": True}, {"us": 2.0, "ok": True}])  # fmt: skip
    assert [cell.best for cell in made.cells(made.columns[0])] == [False, False, True]


@given(st.integers(30, 200), st.integers(2, 14), st.floats(1e-3, 1e6))
def test_a_narrow_terminal_shows_every_word_and_number_whole(width: int, count: int, size: float) -> None:
    columns = [Column("name", "solver"), *(Column(f"c{k}", f"a long heading c{k}", unit="us") for k in range(count))]
    columns.insert(2, Column("says", "what it is"))
    rows = [{"name": name, "says": "the network with larger weights", **{f"c{k}": size * (k + 1) for k in range(count)}}
            for name in ("exact", "rnn-printed", "solver_with_a_name_of_30_chars")]  # fmt: skip
    table = Table("Times", columns, rows, "What they mean.")
    screen = Console(file=io.StringIO(), width=width, color_system=None, highlight=False)
    screen.print(table)
    text = screen.file.getvalue()  # type: ignore[attr-defined]
    words = [word for column in columns[1:] for cell in table.cells(column) for word in cell.text.split()]
    assert [word for word in words if word not in text] == []
    assert set(re.findall(r"\bc\d+\b", text)) == {f"c{k}" for k in range(count)}, "a column is missing"


@pytest.mark.parametrize(("step_s", "written"), [(10.0, [1, 2, 3, 4]), (6.0, [1, 3]), (1.0, [1])])
def test_without_a_terminal_progress_is_written_in_lines(step_s: float, written: list[int]) -> None:
    """Times are counted from the call of `of`: the set-up before it does not count."""
    file, now = io.StringIO(), [0.0]
    screen = console(file=file)
    screen.get_time = lambda: now[0]
    with Bar("trials", on=screen) as bar:
        now[0] = 60.0 - step_s
        bar.of(4)
        for k in range(1, 5):
            now[0] += step_s
            bar.step(f"step {k}")
    after = {k: (timedelta(seconds=k * step_s), timedelta(seconds=(4 - k) * step_s)) for k in written}
    assert file.getvalue().splitlines() == [
        f"trials: {25 * k} % after {spent}, about {left} left  step {k}" for k, (spent, left) in after.items()
    ]

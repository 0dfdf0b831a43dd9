"""Tables: notation, emphasis, missing values, and that no name from elsewhere becomes markup."""

from __future__ import annotations

import io
import math
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from moc_opt.errors import MocOptError, ReportError
from moc_opt.figures.notation import Doubtful, Missing, Notation
from moc_opt.report.tables import Column, Table


def table(rows: list[dict[str, object]], **options: object) -> Table:
    columns = [Column("name", "solver"), Column("value", "time", "us", **options)]  # type: ignore[arg-type]
    return Table("Times", columns, rows)


def texts(values: list[object], **options: object) -> list[str]:
    made = table([{"name": "a", "value": value} for value in values], **options)
    return [cell.text for cell in made.cells(made.columns[1])]


def best(values: list[object], **options: object) -> list[bool]:
    made = table([{"name": "a", "value": value} for value in values], **options)
    return [cell.best for cell in made.cells(made.columns[1])]


def test_a_column_has_one_notation() -> None:
    assert texts([1.702, 2370.16, 48.04]) == ["1.70", "2370", "48.0"]
    assert texts([5.4e-16, 0.0, 0.12]) == ["5.40e-16", "0", "1.20e-1"]
    assert texts([4034.0, 0, np.int64(7)]) == ["4034", "0", "7"]
    assert texts([12_000, 1]) == ["12\u202f000", "1"]
    assert texts([1.25, -2.0], format="+.1f") == ["+1.2", "-2.0"]
    assert texts([3.0, 2.5], format="d") == ["3", "2"]
    assert texts([1.2e-7, 0.0, 3.0e12], format=".1e") == ["1.2e-7", "0", "3.0e12"]
    assert texts([9.996, 0.5], digits=3) == ["10.0", "0.500"]


@given(st.floats(1e-4, 9.9e5), st.integers(1, 8))
def test_the_digits_asked_for_are_kept(value: float, digits: int) -> None:
    written = Notation(digits)(value)
    assert "e" not in written
    assert float(written) == pytest.approx(value, rel=0.51 * 10 ** (1 - digits))


def test_missing_infinite_and_flags() -> None:
    assert texts([None, math.nan, Missing("not asked"), math.inf, -math.inf, 1.5]) == [
        "–",
        "–",
        "–",
        "∞",
        "-∞",
        "1.50",
    ]
    assert texts([True, np.bool_(False)]) == ["yes", "no"]
    made = table([{"name": "a"}])
    assert made.cells(made.columns[1])[0].text == "–"


def test_the_best_value_is_what_reads_best() -> None:
    assert best([2.0, 1.0, None, math.inf, 1.0004], better="low") == [False, True, False, False, True]
    assert best([2.5, 1.0, -math.inf, math.inf], better="high") == [True, False, False, False]
    assert best([1.0, 1.0, 1.0, 2.0], better="low") == [False] * 4, "most of them: no emphasis"
    assert best([1.0, 1.0, 3.0, 2.0], better="low") == [True, True, False, False]
    assert best([2.0, 1.0]) == [False, False]
    assert best([2.0, None], better="low") == [False, False]


@pytest.mark.parametrize(
    ("make", "word"),
    [
        (lambda: Column("k", "t", digits=0), "digits"),
        (lambda: Column("k", "t", format="%.2f"), "format"),
        (lambda: Column("k", "t", better="less"), "better"),  # type: ignore[arg-type]
        (lambda: Table("t", []), "columns"),
        (lambda: Table("t", [Column("k", "a"), Column("k", "b")]), "same key"),
    ],
)
def test_bad_settings_name_the_field(make: object, word: str) -> None:
    with pytest.raises(ReportError, match=word) as caught:
        make()  # type: ignore[operator]
    assert isinstance(caught.value, MocOptError)


def test_only_rows_with_the_flag_compete_for_the_emphasis():
    rows = [{"solver": "wrong", "us": 0.1, "ok": False}, {"solver": "slow", "us": 9.0, "ok": True},
            {"solver": "good", "us": 2.0, "ok": True}, {"solver": "silent", "us": 0.2}]  # fmt: skip
    names = {}
    for among in ("", "ok"):
        column = Column("us", "time", better="low", among=among)
        cells = Table("t", [Column("solver", "solver"), column], rows).cells(column)
        names[among] = [row["solver"] for row, cell in zip(rows, cells, strict=True) if cell.best]
    assert names == {"": ["wrong"], "ok": ["good"]}


@given(st.integers(30, 200), st.integers(2, 14), st.floats(1e-3, 1e6))
def test_a_narrow_terminal_shows_every_number_whole(width: int, count: int, size: float) -> None:
    columns = [Column("name", "solver"), *(Column(f"c{k}", f"a long heading c{k}", unit="us") for k in range(count))]
    rows = [{"name": name, **{f"c{k}": size * (k + 1) for k in range(count)}} for name in ("exact", "rnn-printed")]
    table = Table("Times", columns, rows, "What they mean.")
    screen = Console(file=io.StringIO(), width=width, color_system=None, highlight=False)
    screen.print(table)
    text = screen.file.getvalue()  # type: ignore[attr-defined]
    assert "exact" in text
    assert "rnn-printed" in text
    assert "…" not in text
    assert sorted(set(re.findall(r"\bc\d+\b", text))) == sorted(c.key for c in columns[1:]), "shown or named"


def test_a_doubtful_number_is_marked_and_never_the_best():
    made = Table("t", [Column("name", "name"), Column("us", "time", unit="us", format=".1f", better="low")], [
        {"name": "a", "us": Doubtful(3.0)}, {"name": "b", "us": 12.0}, {"name": "c", "us": 50.0},
        {"name": "d", "us": 60.0},
    ])  # fmt: skip
    cells = made.cells(made.columns[1])
    assert [cell.text for cell in cells] == ["?3.0", "12.0", "50.0", "60.0"]
    assert [cell.best for cell in cells] == [False, True, False, False]
    assert [cell.sort for cell in cells] == [3.0, 12.0, 50.0, 60.0]
    assert "?3.0" in made.to_text()

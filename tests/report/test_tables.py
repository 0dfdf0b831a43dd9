"""Tables: notation, emphasis, missing values, and that no name from elsewhere becomes markup."""

from __future__ import annotations

import io
import math
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from moc_opt.errors import MocOptError, ReportError
from moc_opt.figures.notation import Missing, Notation, fraction_length, pretty_power, pretty_unit
from moc_opt.report.document import macros
from moc_opt.report.table_html import draw
from moc_opt.report.tables import Column, Table

NASTY = "<script>alert(1)</script>\"'&[bold]\x1b[31m\u202e"


class Cells(HTMLParser):
    """Every element that was opened, with its attributes, and all text."""

    def __init__(self, source: str) -> None:
        super().__init__()
        self.opened: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.feed(source)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.opened.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.text += data

    def of(self, tag: str) -> list[dict[str, str | None]]:
        return [attrs for name, attrs in self.opened if name == tag]


def html(made: Table, number: int | None = None) -> str:
    return str(draw(made, number))


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


@given(st.floats(allow_nan=False, allow_infinity=False, min_value=-1e300, max_value=1e300))
def test_scientific_notation_reads_back(value: float) -> None:
    assert float(Notation(17, scientific=True)(value)) == value


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


def test_html_escapes_every_text() -> None:
    made = Table(
        NASTY,
        [Column("k", NASTY, NASTY, help=NASTY), Column("v", "v")],
        [{"k": NASTY, "v": Missing(NASTY)}],
        NASTY,
    )
    parsed = Cells(html(made, 1))
    assert "script" not in {tag for tag, _ in parsed.opened}
    assert parsed.text.count("<script>alert(1)</script>") >= 5
    assert not {name for _, attrs in parsed.opened for name in attrs if name.startswith("on")}
    for character in ("\x1b", "\u202e"):
        assert character not in html(made) + made.to_text()
    assert "[bold]" in made.to_text()


def test_html_says_how_to_sort() -> None:
    made = table([{"name": "a", "value": 2.5}, {"name": "b", "value": None}], better="high")
    parsed = Cells(html(made))
    headings = [attrs for attrs in parsed.of("th") if attrs["scope"] == "col"]
    assert [attrs["aria-sort"] for attrs in headings] == ["none", "none"]
    assert [attrs["data-first"] for attrs in headings] == ["ascending", "descending"]
    assert len(parsed.of("button")) == 2
    rows = [attrs for attrs in parsed.of("th") if attrs["scope"] == "row"]
    assert [attrs["data-sort"] for attrs in rows] == ["a", "b"]
    values = parsed.of("td")
    assert values[0]["data-sort"] == "2.5"
    assert "data-sort" not in values[1]
    assert all(str(attrs["class"]).startswith("right") for attrs in values)


def test_html_numbers_align_on_their_points() -> None:
    made = table([{"name": "a", "value": 1.25}, {"name": "b", "value": 1250.4}, {"name": "c", "value": 12.5}])
    source = html(made)
    assert ">1250\u2008\u2007\u2007</td>" in source
    assert ">12.5\u2007</td>" in source
    assert ">1.25</td>" in source


def test_reasons_become_footnotes_once() -> None:
    rows: list[dict[str, object]] = [
        {"name": n, "value": Missing(w)} for n, w in zip("abc", "xyx", strict=True)
    ]
    source = html(table([*rows, {"name": "d", "value": None}]))
    notes = source.partition('<p class="notes">')[2]
    assert notes.count("<sup>") == 2
    assert source.count('aria-label="missing: x"') == 2
    assert source.count('aria-label="missing: no value"') == 1


def test_plain_text_has_every_cell_and_no_escape_codes() -> None:
    made = table([{"name": "a rather long name of a solver " * 8, "value": 1.5}], better="low")
    written = made.to_text()
    assert "a rather long name of a solver " * 7 in written
    assert "1.50" in written
    assert "µs" in written
    assert "\x1b" not in written


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


def test_typesetting() -> None:
    assert macros("table.html").typeset("-5.4e-16") == "−5.4×10<sup>−16</sup>"
    assert fraction_length("1.25") == 3
    assert fraction_length("1.2e5") == 0
    assert pretty_unit("us") == "µs"
    assert pretty_unit("kg m^2 us^-1") == "kg m² µs⁻¹"
    assert [pretty_power(power) for power in (0, 1, -12)] == ["1", "10", "10⁻¹²"]


def test_only_rows_with_the_flag_compete_for_the_emphasis():
    rows = [{"solver": "wrong", "us": 0.1, "ok": False}, {"solver": "slow", "us": 9.0, "ok": True},
            {"solver": "good", "us": 2.0, "ok": True}, {"solver": "silent", "us": 0.2}]  # fmt: skip
    names = {}
    for among in ("", "ok"):
        column = Column("us", "time", better="low", among=among)
        cells = Table("t", [Column("solver", "solver"), column], rows).cells(column)
        names[among] = [row["solver"] for row, cell in zip(rows, cells, strict=True) if cell.best]
    assert names == {"": ["wrong"], "ok": ["good"]}


@pytest.mark.parametrize(("title", "ends"), [("Times", "Times.</b>"), ("Do they hold?", "Do they hold?</b>")])
def test_a_title_ends_with_one_mark(title: str, ends: str) -> None:
    source = html(Table(title, [Column("name", "name")], [{"name": "a"}]), 1)
    assert ends in source


@given(st.integers(30, 200), st.integers(2, 14), st.floats(1e-3, 1e6))
def test_a_narrow_terminal_shows_every_number_whole(width: int, count: int, size: float) -> None:
    columns = [Column("name", "solver"), *(Column(f"c{k}", f"a long heading c{k}", unit="us") for k in range(count))]
    rows = [{"name": name, **{f"c{k}": size * (k + 1) for k in range(count)}} for name in ("exact", "rnn-printed")]
    table = Table("Times", columns, rows, "What they mean.")
    shown = []
    for part in table.fitted(width):
        screen = Console(file=io.StringIO(), width=width, color_system=None, highlight=False)
        screen.print(part)
        text = screen.file.getvalue()  # type: ignore[attr-defined]
        assert "exact" in text
        assert "rnn-printed" in text
        shown += re.findall(r"c\d+\b", text)
        assert "…" not in text
    assert sorted(shown) == sorted(c.key for c in columns[1:]), "every column once"
    assert [part.caption is not None for part in table.fitted(width)].count(True) == 1
    assert len(table.fitted(10_000)) == 1


def test_a_table_shows_itself_in_a_terminal_and_in_a_notebook(monkeypatch):
    made = table([{"name": NASTY, "value": 1.5}])
    monkeypatch.setenv("COLUMNS", "100")
    assert repr(made) == made.to_text()
    page = Cells(made._repr_html_())
    assert "1.5" in page.text
    assert "time [us]" in page.text
    assert not page.of("script")


def test_in_a_notebook_the_text_is_written_and_not_shown(monkeypatch, capsys):
    made = table([{"name": "exact", "value": 1.5}])
    outside = made.to_text()
    monkeypatch.setattr("rich.console._is_jupyter", lambda: True)
    assert made.to_text() == outside
    assert capsys.readouterr() == ("", "")

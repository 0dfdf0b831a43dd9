"""The first screen of any benchmark: few sentences, goals missed first, intervals drawn, on 80 columns."""

from __future__ import annotations

import io

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from benchmarks.common.answer import (
    MOST_COLUMNS,
    Answer,
    Picture,
    goals_answer,
    in_sentences,
    interval_picture,
    marked_answer,
    reached,
)
from moc_opt import figures
from moc_opt.report.page import Page
from moc_opt.report.tables import Column, Table

GOALS = [Column("goal", "goal"), Column("value", "found"), Column("reached", "reached")]


def test_missed_goals_come_first_and_are_marked():
    rows = [{"goal": name, "reached": said} for name, said in (("a", "yes"), ("b", False), ("c", "not measured"))]
    made = goals_answer("One. Two.", "Goals", GOALS, rows)
    assert [(row["goal"], row["reached"].symbol) for row in made.table.rows] == [("b", "✘"), ("c", "–"), ("a", "✔")]
    assert made.sentences == ["One.", "Two."]


@pytest.mark.parametrize(
    ("value", "word"), [(True, "yes"), ("yes", "yes"), (False, "no"), ("no", "no"), (None, "open")]
)
def test_a_goal_is_reached_missed_or_open(value, word):
    assert reached(value).word == word


def test_verdicts_of_a_table_are_marked_and_its_columns_are_few():
    columns = [Column(f"c{k}", f"c{k}") for k in range(10)]
    rows = [{"c0": "a goal", "c1": "met", "c2": 3.0}, {"c0": "missed", "c1": "missed"}]
    made = marked_answer("It holds.", Table("t", columns, rows)).table
    assert len(made.columns) == MOST_COLUMNS
    assert [row["c1"].symbol for row in made.rows] == ["✔", "✘"]
    assert (made.rows[0]["c0"], made.rows[0]["c2"]) == ("a goal", 3.0)


def test_sentences_end_where_they_end_and_are_few():
    assert in_sentences("It takes 20.0 us. Others take 3 times as long.") == [
        "It takes 20.0 us.", "Others take 3 times as long.",
    ]  # fmt: skip
    assert in_sentences("One. Two. Three. Four.") == ["One.", "Two.", "Three. Four."]


def test_a_page_begins_with_it_and_folds_the_rest():
    drawn = figures.latency_ecdf({"a": [1.0, 2.0]})
    page = Page("t")
    Answer(["It holds."], Table("Goals", GOALS, [{"goal": "g"}]), [Picture(drawn, "See.", "seen")]).begin(page)
    page.section("More")
    source = page.html()
    places = [source.index(part) for part in ("It holds.", "Goals", 'id="seen"', 'id="find"', 'id="more"')]
    assert places == sorted(places)
    assert '<meta name="description" content="It holds.">' in source


def test_intervals_stand_in_order_around_their_values():
    drawn = interval_picture(
        {"one": (1.0, 2.0, 4.0), "two": (3.0, 3.0, 3.0)}, {"one": "#000000", "two": "#ffffff"}, "x", {"limit": 10.0},
        log=True,
    )  # fmt: skip
    low = {trace.y[0]: trace.x[0] - trace.error_x.arrayminus[0] for trace in drawn.data}
    high = {trace.y[0]: trace.x[0] + trace.error_x.array[0] for trace in drawn.data}
    assert (low, high) == ({"one": 1.0, "two": 3.0}, {"one": 4.0, "two": 3.0})
    assert [trace.y[0] for trace in drawn.data] == ["two", "one"], "the first name is drawn last, at the top"
    assert drawn.layout.xaxis.type == "log"


@given(st.lists(st.text("abc-:@", min_size=1, max_size=60), min_size=1, max_size=9), st.integers(40, 120))
def test_any_table_is_narrowed_to_the_terminal_and_nothing_ends_in_dots(names, width):
    columns = [Column("name", "a solver"), *(Column(f"c{k}", f"column {k}", unit="us", format=".1f") for k in range(7))]
    rows = [{"name": name, **{f"c{k}": 10.0**k for k in range(7)}} for name in names]
    screen = Console(file=io.StringIO(), width=width, color_system=None)
    for part in Answer(["Said."], Table("Times", columns, rows)).screens(width):
        screen.print(part, markup=False)
    text = screen.file.getvalue()
    assert max(map(len, text.splitlines())) <= width
    assert "…" not in text
    assert all(name[:8] in text for name in names), "broken where it must be, never left out"
    assert "1.0" in text

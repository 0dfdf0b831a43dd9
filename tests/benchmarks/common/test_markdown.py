"""Markdown for README and docs/: tables, and sections between marks."""

import pytest
from jinja2 import UndefinedError

from benchmarks.common import markdown
from moc_opt.report.tables import Column


def test_a_table_has_a_line_for_its_heads_and_one_a_row():
    assert markdown.table(["a", "b"], [["1", "2"], ["3", ""]]) == "| a | b |\n|---|---|\n| 1 | 2 |\n| 3 |  |"


def test_a_table_of_results_is_in_the_notation_of_the_page():
    columns = [Column("name", "run"), Column("us", "time", unit="us", format=".1f")]
    found = markdown.of_columns(columns, [{"name": "x", "us": 1.234}, {"name": "y", "us": 20.0}])
    assert found.splitlines() == ["| run | time [us] |", "|---|---|", "| x | 1.2 |", "| y | 20.0 |"]


def test_a_section_is_replaced_and_nothing_else():
    page = "before\n<!-- a -->\nold\n<!-- /a -->\nbetween\n<!-- b -->\nkept\n<!-- /b -->\n"
    filled = markdown.fill_section(page, "a", r"new \1", "README")
    assert filled == page.replace("old", r"new \1")
    with pytest.raises(markdown.SectionError, match="README: no lines <!-- c -->"):
        markdown.fill_section(page, "c", "new", "README")


def test_a_value_that_is_not_given_is_an_error():
    with pytest.raises(UndefinedError, match="projector"):
        markdown.render("errata.md", poses=1)

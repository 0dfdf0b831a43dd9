"""Names with characters that are not allowed are refused, and text is escaped for Markdown."""

import html
from dataclasses import replace

import hypothesis.strategies as st
import pytest
from hypothesis import given, settings

from moc_opt.errors import RobotError, ScenarioError, SolverError
from moc_opt.inputs import names
from moc_opt.robots import load_data
from moc_opt.scenario import Scenario
from moc_opt.solvers import registry
from tests.odd_inputs import names as hostile_names

GOOD = [
    "a", "lwr4", "joint_1", "qpsolvers:daqp", "nlp-sqp", "exact+fail", "circle/0", "all of it", "_", "A1.b", "x" * 100,
]  # fmt: skip
BAD = [
    "", " ", "a ", " a", ".", "..", ".a", "a.", "a..b", "-a", "/a", "a/", "../a", "a\n", "a\nb", "a\\", "a??/", "*/",
    "/*", "a*b", 'a"b', "a'b", "a<b", "a>b", "a&b", "a;b", "a$b", "a`b", "a%b", "{a}", "[a]", "a=b", "é", "a\u2028b",
    "１", "\x00", "\x1b[2J", "x" * 101, "a\tb",
]  # fmt: skip


DATA = load_data()


def test_name_has_only_allowed_characters():
    for text in GOOD:
        assert names.checked(text) == text
    for text in BAD:
        with pytest.raises(ValueError, match="is no name: a name has 1 to 100 characters"):
            names.checked(text)
    assert not names.is_name(3)


@pytest.mark.parametrize("bad", ["a\\", "*/", "a\nb", "<b>", "../x", ""])
def test_bad_name_in_a_scenario_robot_or_plugin_is_refused(bad):
    for table in (
        {"name": bad}, {"solver": {"name": bad}}, {"task": {"path": bad}}, {"faults": {"bump_link": bad}},
        {"task": {"sizes": {bad: 1.0}}}, {"solver": {"settings": {bad: 1.0}}},
    ):  # fmt: skip
        with pytest.raises(ScenarioError, match="is no name"):
            Scenario(**table)
    for change in ({"name": bad}, {"joint_names": (bad, *DATA.joint_names[1:])}):
        with pytest.raises(RobotError, match="is no name"):
            replace(DATA, **change)
    with pytest.raises(SolverError, match="rename it"):
        registry._of_plugin(bad, [registry.EntryPoint(bad, "math:sqrt", registry.GROUP)])


@given(st.one_of(hostile_names, st.text(st.characters(codec="utf-8", exclude_categories=["Cc"]))))
@settings(max_examples=100)
def test_markdown_shows_any_text_as_it_is(text):
    """Markdown on the live page would interpret HTML, so special characters must be escaped."""
    shown = names.in_markdown(text)
    assert not set(shown) & set("<>*_`[]{}\\!|~$\"'\n")
    if text.isprintable():
        assert html.unescape(shown) == text

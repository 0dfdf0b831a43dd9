"""Templates: a text from elsewhere stays text at every place of a page where texts are shown."""

from __future__ import annotations

import json
from html.parser import HTMLParser

import plotly.graph_objects as go
import pytest
from jinja2 import UndefinedError
from markupsafe import Markup

from moc_opt.figures.notation import Missing
from moc_opt.model.robot_model import RobotModel
from moc_opt.report import document
from moc_opt.report.page import Page
from moc_opt.report.replay import Replay
from moc_opt.report.tables import Column, Table
from tests.report.test_replay import wave


def hostile(place: str) -> str:
    """A text that breaks out of elements, attributes, scripts and templates where any of them lets it."""
    return f"\"'></script></title><u onclick='{place}'>{{{{ 7*7 }}}} \x1b\u202e{place} & `code`"


class Read(HTMLParser):
    """What a browser would make of a page: elements, attributes, visible text, data of scripts."""

    def __init__(self, source: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str]] = []
        self.texts: list[str] = []
        self.feed(source)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += [(name, value or "") for name, value in attrs]

    def handle_data(self, data: str) -> None:
        self.texts.append(data)


PLACES = (
    "title", "subtitle", "headline", "section", "text", "link", "about", "table", "caption", "heading", "unit", "help",
    "cell", "reason", "figure", "environment", "key", "value", "deep-key", "deep-value", "list",
)  # fmt: skip


@pytest.fixture(scope="module")
def page() -> Page:
    """A hostile text of its own at every place."""
    made = Page(hostile("title"), hostile("subtitle"))
    made.headline(hostile("headline"))
    made.section(hostile("section"))
    made.text(hostile("text"))
    made.link("replay.html", hostile("link"), hostile("about"))
    columns = [Column("a", hostile("heading"), hostile("unit"), help=hostile("help")), Column("b", "b")]
    rows = [{"a": hostile("cell"), "b": Missing(hostile("reason"))}]
    made.table(Table(hostile("table"), columns, rows, hostile("caption")))
    made.figure(go.Figure(layout_title=hostile("inside")), hostile("figure"))
    values = {
        hostile("key"): hostile("value"), "list": [hostile("list")], "nothing": None,
        "deep": {hostile("deep-key"): {"further": hostile("deep-value")}},
    }  # fmt: skip
    made.environment(values, hostile("environment"))
    return made


def test_texts_are_shown_at_every_place_and_are_markup_at_none(page: Page) -> None:
    found = Read(page.html())
    assert "u" not in found.tags
    assert not [name for name, _ in found.attributes if name.startswith("on")]
    shown = "".join("".join(found.texts).split())  # a heading breaks into lines
    for place in PLACES:
        assert f"onclick='{place}'" in shown, place
    attributes = " ".join(value for _, value in found.attributes)
    for place in ("table", "help", "reason", "figure"):
        assert f"onclick='{place}'" in attributes, place


def test_no_text_runs_as_a_template_or_steers_the_reader(page: Page) -> None:
    source = page.html()
    assert source.count("{{ 7*7 }}") >= len(PLACES) - 1
    for character in ("\x1b", "\u202e"):
        assert character not in source


def test_the_names_and_the_title_of_a_replay_stay_texts(robot: RobotModel) -> None:
    found = Read(Replay({hostile("run"): wave(robot, 20)}, robot, title=hostile("title")).html())
    assert "u" not in found.tags
    (value,) = [text for text in found.texts if text.startswith('{"times"')]
    assert json.loads(value)["runs"][0]["name"] == hostile("run")
    assert "".join(found.texts).count("onclick='title'") == 2


def test_a_value_is_escaped_unless_it_is_markup() -> None:
    definitions = document.macros("parts.html").definitions
    assert "<dd>&lt;i&gt;</dd>" in definitions({"a": "<i>"})
    assert "<main>\n<i>" in document.render(
        "page.html", title="", subtitle="", sections={}, parts=[Markup("<i>")], about="", data={}, figures={}
    )


def test_a_value_that_a_template_lacks_is_an_error() -> None:
    with pytest.raises(UndefinedError, match="title"):
        document.render("page.html")

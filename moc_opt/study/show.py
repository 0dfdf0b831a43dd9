"""The report of a study."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any, NamedTuple

import plotly.graph_objects as go

from moc_opt.control import ControlSettings
from moc_opt.control.presets import PRESETS
from moc_opt.figures.notation import Mark, pretty_units
from moc_opt.figures.style import Styles, figure, label, log_axis, rule
from moc_opt.report.page import Page
from moc_opt.report.tables import Column, Table
from moc_opt.robots import load_data
from moc_opt.scenario import Scenario
from moc_opt.study.results import TITLES, change_name
from moc_opt.trace.metrics import METRICS

YES, NO, OPEN = Mark("✔", "yes", "good", 0), Mark("✘", "no", "bad", 2), Mark("–", "open", "other", 1)
MARKS = {True: YES, False: NO, None: OPEN, "yes": YES, "no": NO, "open": OPEN}
FORMATS = {"%": "+.1f", "mm": ".3f", "us": ".1f", "m^3": ".4f", "N": ".2f"}


def mark(verdict: bool | str | None, text: str) -> Mark:
    """Return the verdict's `Mark` with ``text``. An open verdict shows "text?"."""
    known = MARKS.get(verdict, OPEN)
    symbol, word = ("", f"{text}?") if known is OPEN else (known.symbol, text)
    return Mark(symbol, word, known.tone, known.rank)


class Picture(NamedTuple):
    """A figure, a sentence about it, and a file name."""

    figure: go.Figure
    says: str
    name: str


@dataclass(frozen=True)
class Section:
    """A section of a report."""

    title: str
    text: str = ""
    parts: Sequence[Table | Picture] = ()


@dataclass(frozen=True)
class Report:
    """What a study found."""

    title: str  #: the question and the fixed conditions
    answer: Sequence[str]  #: up to three sentences, the most important one first
    table: Table  #: on the first screen
    pictures: Sequence[Picture] = ()
    sections: Sequence[Section] = ()
    load: str = ""  #: the machine's load while times were measured
    subtitle: str = ""

    def page(self, environment: Mapping[str, Any], failed: Sequence[Mapping[str, Any]] = ()) -> Page:
        """Return the report as a page."""
        page = Page(self.title, self.subtitle)
        for sentence in self.answer:
            page.headline(sentence)
        page.table(self.table)
        page.text(self.load)
        for picture in self.pictures:
            page.figure(picture.figure, picture.says, name=picture.name)
        page.fold()
        keys = [key for key in ("group", "robot", "trial", "controller", "error") if any(key in row for row in failed)]
        errors = Section("Runs that failed", "", [Table("Errors", [Column(key, key) for key in keys], failed)])
        for section in [*self.sections, errors] if failed else self.sections:
            page.section(section.title)
            page.text(section.text)
            for part in section.parts:
                if isinstance(part, Table):
                    page.table(part)
                else:
                    page.figure(part.figure, part.says, name=part.name)
        page.environment(environment)
        return page

    def markdown(self) -> str:
        """Return the report without its pictures as Markdown."""
        parts = [f"# {self.title}", *self.answer, _markdown(self.table), self.load]
        for section in self.sections:
            parts += [f"## {section.title}", section.text]
            parts += [_markdown(part) for part in section.parts if isinstance(part, Table)]
        return "\n\n".join(filter(None, parts)) + "\n"

    def screens(self) -> Iterator[object]:
        """Yield the parts that a terminal prints."""
        yield from self.answer
        yield self.table
        if self.load:
            yield self.load


def about(scenario: Scenario, *, solver: bool = False) -> str:
    """Name a scenario's arm, task, preset and, if ``solver``, solver."""
    control = scenario.control
    preset = next((name for name in PRESETS if control == ControlSettings.preset(name)), None)
    named = "default" if control == ControlSettings() else preset or "own settings"
    parts = [load_data(scenario.robot.name).name, scenario.task.path, f"preset {named}"]
    return ", ".join([*parts, *([scenario.solver.name] if solver else [])])


def _markdown(table: Table) -> str:
    headings, rows = table.texts()
    lines = [headings, ["---"] * len(headings), *([text.replace("|", "\\|") for text in row] for row in rows)]
    drawn = "\n".join("| " + " | ".join(line) + " |" for line in lines)
    return f"{drawn}\n\n{table.caption}".strip()


def columns(*metrics: str, of: str = "", **titles: str) -> list[Column]:
    """Return a column for each metric, or change of a metric from the baseline. ``of``: section to link to."""
    found = []
    for name in metrics:
        bare = name.removeprefix("settled_").removeprefix("travelling_")
        known = METRICS.get(bare)
        change = next((m for m in METRICS.values() if change_name(m.name) == bare), None)
        unit = "%" if bare.endswith("_percent") else known.unit if known and known.unit != "1" else ""
        about = f"Change of: {change.about}" if change else known.about if known else ""
        suffix = "_percent" if unit == "%" else f"_{unit.replace('/', '_per_')}"
        plain = TITLES.get(change.name if change else bare) or bare.removesuffix(suffix)
        title = titles.get(name, plain.replace("_", " "))
        found.append(Column(name, title, unit=unit, format=FORMATS.get(unit, ""), help=about, section=of))
    return found


def intervals_picture(
    found: Mapping[str, tuple[float, float, float]], x_label: str, limits: Mapping[str, float],
    tones: Mapping[str, str] | None = None, *, log: bool = False,
) -> go.Figure:  # fmt: skip
    """Draw each name's value with a bar from low to high, and a line per limit."""
    drawn = figure(showlegend=False, height=90 + 24 * max(len(found), 4))
    for name, (low, value, high) in reversed(list(found.items())):
        tone = (tones or {}).get(name)
        drawn.add_scatter(
            x=[value], y=[label(name)], mode="markers", name=label(name),
            error_x={"type": "data", "symmetric": False, "array": [high - value], "arrayminus": [value - low],
                     "thickness": 1.5, "width": 5, "color": tone},
            marker={"color": tone, "size": 9},
            hovertemplate=f"%{{x:.3g}} [{low:.3g}, {high:.3g}]<extra>%{{fullData.name}}</extra>",
        )  # fmt: skip
    if log:
        log_axis(drawn, "x", x_label, [*chain(*found.values()), *limits.values()])
    else:
        drawn.update_xaxes(title_text=pretty_units(x_label))
    for words, at in limits.items():
        rule(drawn, "x", at, words)
    drawn.update_yaxes(type="category", automargin=True)
    return drawn


def lines_picture(
    lines: Mapping[str, Sequence[tuple[float, float, float, float]]], x_title: str, y_title: str, *, log: bool = False
) -> go.Figure:
    """Draw a line for each name through its points (x, low, value, high)."""
    drawn, styles = figure(), Styles(lines)
    for name, points in lines.items():
        drawn.add_scatter(
            x=[x for x, *_ in points], y=[value for _, _, value, _ in points], name=label(name), mode="lines+markers",
            line={"color": styles[name].color, "dash": styles[name].dash},
            error_y={"type": "data", "symmetric": False, "array": [high - value for *_, value, high in points],
                     "arrayminus": [value - low for _, low, value, _ in points]},
        )  # fmt: skip
    drawn.update_xaxes(title_text=pretty_units(x_title), type="log" if log else "linear")
    drawn.update_yaxes(title_text=pretty_units(y_title))
    return drawn


def ends(figures: Mapping[str, Any], name: str) -> tuple[float, float, float] | None:
    """Return (low, value, high) of a summary's ``name``, or None if absent. Without interval, low = high = value."""
    value, low, high = (figures.get(f"{name}{end}") for end in ("", "_low", "_high"))
    if value is None:
        return None
    return (low, value, high) if low is not None and high is not None and low == low else (value, value, value)

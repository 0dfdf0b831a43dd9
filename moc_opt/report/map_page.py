"""The manipulability map as a part of a page, with its result in words and numbers, and as a page of its own."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence

import numpy as np

from moc_opt.figures.notation import Missing
from moc_opt.figures.style import Styles
from moc_opt.redundancy.manipulability_map import SwivelMap, manipulability_map
from moc_opt.redundancy.map_analysis import (
    ALIKE_RAD,
    CLOSE_RAD,
    END,
    NEAR,
    End,
    Reading,
    alike,
    read_trajectory,
)
from moc_opt.report.map_figure import map_figure
from moc_opt.report.page import Page
from moc_opt.report.run_table import below_best
from moc_opt.report.runs import load_runs
from moc_opt.report.tables import Column, Table
from moc_opt.trace.trace import Trace

MOST_LINES = 8
COLUMNS = (
    Column("name", "trajectory"),
    Column(
        "near", "at the optimum", unit="%", format=".0f", better="high",
        help=f"of the time: mu at most {100 * NEAR:.0f} % below the best at that time",
    ),
    Column("from_s", "for good from", unit="s", format=".1f", better="low", help="from then on it stays there"),
    Column("mu_percent", "of the best mu", unit="%", format=".1f", better="high", help="mean over mean"),
    Column("travel", "elbow turns", unit="deg", format="+.0f", help="from its start to its end"),
    Column(
        "at_edge", "at the feasible edge", unit="%", format=".0f", better="low",
        help="of the time: no farther than a row of the map from a pose that is not allowed",
    ),
    Column(
        "end", "in the end",
        help=f"over the last {100 * END:.0f} % of the time; held by a local maximum or the feasible edge: less than "
        f"{np.degrees(CLOSE_RAD):.0f} deg before it, mu rising",
    ),
)  # fmt: skip
PLURAL = {"touches": "touch", "is": "are", "ends": "end", "rests": "rest"}


def add_map(
    page: Page, found: SwivelMap, *, name: str = "map", what: str = "", styles: Styles | None = None
) -> list[Reading]:
    """Append words, figure and table of one map.

    Of more than eight trajectories those that cannot be told apart are drawn as one.

    Args:
        found: of `manipulability_map`.
        name: of the figure's file.
        what: it is a map of, in a few words, for caption and table.
        styles: of each run, as in the page's other figures.

    Returns:
        What each trajectory amounts to, those that are not drawn among them.

    Raises:
        ReportError: no pose of the map is allowed.
    """
    kinds, titles = kinds_of(found), lines(found)
    readings = {trajectory: read_trajectory(found, trajectory) for trajectory in found.trajectories}
    figure = map_figure(found, styles, titles=titles)
    if found.held:
        page.text(slice_words(found.held))
    page.text(in_words([readings[first] for first in kinds], titles))
    page.figure(figure, caption(found, what), name=name)
    page.table(trajectory_table(readings, kinds, what))
    return list(readings.values())


def kinds_of(found: SwivelMap) -> dict[str, list[str]]:
    """Return the trajectories to speak of -> those that go the same way and are not spoken of, where there are many."""
    return alike(found) if len(found.trajectories) > MOST_LINES else {name: [] for name in found.trajectories}


def lines(found: SwivelMap) -> dict[str, str]:
    """Return the trajectories to draw, eight at most -> what to call each in the legend."""
    kinds = list(kinds_of(found).items())[:MOST_LINES]
    return {first: first + (f" and {len(others)} more" if others else "") for first, others in kinds}


def caption(found: SwivelMap, what: str = "") -> str:
    """Say what the figure shows, and how finely."""
    times, swivels = found.mu.shape
    begin = f"{what[:1].upper()}{what[1:]}: every" if what else "Every"
    return (
        f"{begin} pose that keeps tip and trocar, over time ({times} by {swivels} poses): upwards the swivel of the "
        "elbow, as colour the manipulability mu; grey where a joint would be beyond its limit or the arm does not "
        "reach. A line is the trajectory of a run, from the marker at its start, and of several colours where runs go "
        "the same way; the dotted one joins the best poses, and may leap where no arm can follow."
    )


def slice_words(held: Sequence[str]) -> str:
    """Say which poses a map of several freedoms leaves out."""
    several = len(held) > 1
    return (
        f"A slice: tip and trocar leave this arm {len(held) + 1} freedoms, and the map shows one. {', '.join(held)} "
        f"{'stand' if several else 'stands'} as in the longest run; poses with {'them' if several else 'it'} elsewhere "
        "may have a larger mu than the best shown here."
    )


def in_words(readings: Sequence[Reading], titles: Mapping[str, str] | None = None) -> str:
    """Say which runs are at the optimum, which are not, and why.

    Args:
        titles: name -> what the figure calls it.
    """
    called = {reading.name: (titles or {}).get(reading.name, reading.name) for reading in readings}
    known = sorted((r for r in readings if np.isfinite(r.near)), key=lambda reading: -reading.near)
    timed = []
    for reading in known:
        if not _never(reading):
            since = (
                f" (from {reading.from_s:.1f} s on for good)" if reading.from_s > 0.0 and reading.near < 1.0 else ""
            )
            timed.append(f"{called[reading.name]} for {100.0 * reading.near:.0f} %{since}")
    limit = f"mu at most {100.0 * NEAR:.0f} % below the best pose of that time"
    said = [f"At the optimum ({limit}), as a share of the time: {'; '.join(timed) or 'none'}."] if known else []
    groups: dict[str, list[str]] = {}
    for reading in readings:
        never = "never gets there: it " if _never(reading) else ""
        for words in (edge_in_words(reading), never + end_in_words(reading)):
            groups.setdefault(words, []).append(called[reading.name])
    groups.pop("", None)
    for words, names in groups.items():
        several = len(names) > 1 or names[0].endswith(" more")
        said.append(f"{_listed(names)} {_plural(words) if several else words}.")
    return " ".join(said)


def _never(reading: Reading) -> bool:
    """Return whether it would read as 0 %."""
    return reading.near < 0.005


def _plural(words: str) -> str:
    """Return the same said of several: the verb that begins it, and one that follows a colon."""
    begin, colon, rest = words.partition("never gets there: it ")
    if colon:
        return f"never get there: they {_plural(rest)}"
    verb, space, rest = begin.partition(" ")
    return f"{PLURAL[verb]}{space}{rest}"


def end_in_words(reading: Reading) -> str:
    """Return a verb in the singular and what follows it."""
    limit = f"the limit of joint {reading.joint}" if reading.joint else "the arm's reach"
    return {
        End.OPTIMUM: "ends at the optimum",
        End.LOCAL_MAXIMUM: "ends at a local maximum: to either side mu falls before it rises to the best",
        End.FEASIBLE_EDGE: f"ends at the edge of the feasible poses: mu rises beyond {limit}",
        End.STILL: "rests in the end, though mu rises to one side (joint limits are in the map, the narrower "
        "box of the third level is not)",
        End.RISING: "is still gaining mu when the run ends",
        End.FALLING: "is losing mu when the run ends",
        End.OTHER_BRANCH: "is on another branch of the inverse kinematics: the map does not hold there",
        End.UNKNOWN: "is nowhere on the map, where no pose is allowed",
    }[reading.end]


def edge_in_words(reading: Reading) -> str:
    """Return a verb in the singular and what follows it; nothing for one that keeps away from the feasible edge."""
    if not reading.at_edge > 0.0 or reading.end is End.FEASIBLE_EDGE:
        return ""
    joints = [f"joint {joint}" for joint in reading.limits]
    return f"touches the feasible edge on the way ({_listed(joints) if joints else 'out of reach'})"


def trajectory_table(readings: Mapping[str, Reading], kinds: Mapping[str, Sequence[str]], what: str = "") -> Table:
    """Make a table with one row for each kind of trajectory, in their order."""
    rows = []
    for first in kinds:
        reading = readings[first]
        rows.append(
            {
                "name": first, "near": 100.0 * reading.near, "from_s": reading.from_s,
                "mu_percent": 100.0 * reading.mu_share, "travel": np.degrees(reading.travel_rad),
                "at_edge": 100.0 * reading.at_edge,
                "end": f"{reading.end}, joint {reading.joint}" if reading.joint else str(reading.end),
            }
        )  # fmt: skip
        if reading.end is not End.OPTIMUM:
            rows[-1]["from_s"] = Missing("not there in the end")
    stand_for = [f"{first} stands for {', '.join(others)} too" for first, others in kinds.items() if others]
    apart = f"within {np.degrees(ALIKE_RAD):.0f} deg of its elbow at all times"
    note = f"{'; '.join(stand_for)}: {apart}." if stand_for else ""
    return Table(f"Trajectories on the map{': ' * bool(what)}{what}", COLUMNS, rows, note)


def load_map(files: Sequence[str | os.PathLike[str]]) -> Page:
    """Return a page with the map of saved traces, named as their files are.

    Raises:
        ReportError: they are not of one robot, tool and path, or cannot be shown.
        RobotError: the arm has no elbow whose angle tells its poses apart.
        TraceError: a file is missing, damaged, or no trace.
    """
    traces, robot = load_runs(files)
    page = Page("Manipulability along the path", " and ".join(traces))
    for name, sentence in ((name, below_best(trace)) for name, trace in traces.items()):
        if sentence:
            page.text(f"{name}: {sentence}.")
    add_map(page, manipulability_map(robot, {**traces, **best_courses(traces)}))
    return page


def best_courses(traces: Mapping[str, Trace]) -> dict[str, Trace]:
    """Return the best courses that the traces hold as trajectories of their own, one for each start."""
    found: dict[str, Trace] = {}
    for name, trace in traces.items():
        course = trace.columns.get("q_best_from_start_rad")
        if course is not None and not any(np.array_equal(course[0], other.q_rad[0]) for other in found.values()):
            found[f"best course from the start of {name}"] = trace.with_columns(q_rad=course)
    return found


def _listed(names: Sequence[str]) -> str:
    """Return the names as a text; semicolons between those that have commas of their own."""
    if len(names) == 1:
        return names[0]
    comma = "; " if any("," in name for name in names) else ", "
    return f"{comma.join(names[:-1])} and {names[-1]}"

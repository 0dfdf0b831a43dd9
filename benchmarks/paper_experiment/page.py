"""What ``python -m benchmarks.paper`` shows: the answer, then tables and figures, all from its numbers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go

from benchmarks.common.answer import Answer, Picture, interval_of, interval_picture
from benchmarks.common.look import add_replay, trial_map
from benchmarks.paper_experiment.trials import BASELINES, MATCHED, Outcome, title
from benchmarks.paper_experiment.verdict import (
    ABOUT_FRAMES,
    CLAIMS,
    EVERY,
    FAILS,
    GAINS_ONLY,
    HOLDS,
    REPEATED,
    RULE,
    UNDECIDED,
    counted,
    goal_value,
    in_words,
    of_phase,
)
from moc_opt import figures
from moc_opt.figures.notation import Mark
from moc_opt.figures.style import GOOD, MUTED, SERIES, WORST, Styles, figure, label
from moc_opt.planning.swivel_map import SwivelMap, read_trajectory
from moc_opt.report.map_page import add_map
from moc_opt.report.page import Page
from moc_opt.report.tables import Column, Table
from moc_opt.robots.model import RobotModel
from moc_opt.study.statistics import spread, too_few
from moc_opt.trace.trace import Trace

Summary = Mapping[str, Any]
Rows = Sequence[Mapping[str, Any]]
Figures = Mapping[str, go.Figure]

NETWORK, PRINTED = "rnn", "paper"
"""The paper's kind of solver, and the group with Table I as printed."""
MARKS = {HOLDS: ("✔", "good", 0), GAINS_ONLY: ("≈", "fair", 1), FAILS: ("✘", "bad", 2)}
"""Of a verdict; one that is open has "–"."""
TONES = {HOLDS: GOOD, GAINS_ONLY: list(SERIES)[4], FAILS: WORST}
SHOWN = ("mu", "tip", "tip_registered", "tip_true", "rcm", "rcm_registered", "rcm_true")
"""Claims that the first table has a column for."""
CLAIM = {claim.name: claim for claim in EVERY}
PANELS = {
    "mu": ("mu", "manipulability [m³]", 1.0),
    "tip_error_model_m": ("tip", "tip error [mm]", 1e3),
    "rcm_error_m": ("rcm", "RCM error [mm]", 1e3),
    "trocar_force_N": ("force", "|force at the trocar| [N]", 1.0),
}
"""Column of a trace -> short name, label of the axis, factor to its unit."""


# The first screen: do the paper's claims hold for its own kind of network?


def answer(summary: Summary, groups: Sequence[str], drawn: Figures) -> Answer:
    """Make the first screen.

    Args:
        groups: names, in the order of the report.
        drawn: Figure 7 of the group with the paper's parameters, and what the start decides.
    """
    found: dict[tuple[str, str], dict[str, Mapping[str, Any]]] = {}
    for row in summary["verdict"]:
        found.setdefault((row["group"], row["controller"]), {})[row["claim"]] = row
    order = sorted(found, key=lambda key: (key[0] != PRINTED, groups.index(key[0]), key[1] != NETWORK))
    papers = {solver: [found[group, solver][claim.name] for claim in CLAIMS if claim.name in found[group, solver]]
              for group, solver in order if group == PRINTED}  # fmt: skip
    said = [_held(summary[PRINTED].get(solver, {}), solver, rows) for solver, rows in list(papers.items())[:2]]
    sentences = [*([" ".join(said)] if said else []), _reached(summary), ABOUT_FRAMES]
    pictures = [*_effects(papers), *_known(drawn)]
    return Answer(sentences, _claims_table(summary, order, found), pictures)


def _held(figures: Mapping[str, Any], solver: str, rows: Rows) -> str:
    """Say which of the paper's claims hold with its own parameters and this solver."""
    trials, shook = int(figures.get("trials", 0)), figures.get("oscillated", 0)
    whom = f"`{solver}`{' (its own kind of network)' if solver == NETWORK else ''} and Table I as printed"
    known = [(CLAIM[row["claim"]].title, spread(row, "matched_percent")) for row in rows]
    effects = "; ".join(f"{name} {change or 'no trial'}" for name, change in known)
    held = sum(row["verdict"] == HOLDS for row in rows)
    verdict = too_few(trials) or f"{held} of {len(rows)} hold"
    also = f", {shook:g} of them shake" if shook else ""
    return (
        f"The paper's claims with {whom}: {verdict}; change against DCAC with the same gains [%]: {effects} "
        f"({trials} trials{also})."
    )


def _reached(summary: Summary) -> str:
    """Say how far our own goals are reached; each missed goal with its limit and what was found."""
    told = []
    places = (("our own gains", "goals"), ("them from random poses", "goals_elsewhere"))
    for where, goals in ((where, summary[key]) for where, key in places if summary.get(key)):
        missed = [
            f"{goal['text']} {goal['limit']:g} (found {goal['value']:.3g})"
            for goal in goals
            if goal["reached"] is False
        ]
        told.append(f"With {where}: {counted(goals)}{'; missed: ' if missed else ''}{'; '.join(missed)}.")
    return " ".join(told)


def _claims_table(
    summary: Summary, order: Sequence[tuple[str, str]], found: Mapping[tuple[str, str], Mapping[str, Any]]
) -> Table:
    figures = {key: summary.get(key[0], {}).get(key[1], {}) for key in order}
    trials = int(max((entries.get("trials", 0) for entries in figures.values()), default=0))
    rows = []
    for key in order:
        shook = figures[key].get("oscillated")
        cells = {name: _mark(found[key][name]) for name in SHOWN if name in found[key]}
        rows.append({"name": f"{key[0]}, {key[1]}{f'; {shook:g} shook' if shook else ''}", **cells})
    section = f"Group {order[0][0] if order else PRINTED}"
    columns = [Column("name", "parameters, solver")]
    columns += [Column(name, CLAIM[name].title, unit="%", section=section, help=CLAIM[name].text) for name in SHOWN]
    return Table(
        f"Do the paper's claims hold? Change against DCAC with the same gains, {trials} trials each", columns, rows,
        f"✔ {HOLDS}, ≈ {GAINS_ONLY} of DCAC, ✘ {FAILS}, – {too_few(trials) or UNDECIDED}; intervals: below. mu is "
        f"claimed to rise by more than {CLAIMS[0].bound_percent:g} %. Own: the robot's own kinematics, in which the "
        "paper's claims stand; shook: trials in which a joint oscillated.",
    )  # fmt: skip


def _mark(row: Mapping[str, Any]) -> Mark:
    symbol, tone, rank = MARKS.get(row["verdict"], ("–", "other", 1))
    value = row.get("matched_percent")
    return Mark(symbol, "no trial" if value is None else f"{value:+.{1 if abs(value) < 9.95 else 0}f}", tone, rank)


def _effects(papers: Mapping[str, Rows]) -> list[Picture]:
    """Draw the effects with the paper's parameters; of one trial there is no interval to draw."""
    effects, tones = {}, {}
    for solver, row in ((solver, row) for solver, rows in papers.items() for row in rows):
        ends = interval_of(row, "matched_percent")
        if ends is not None and ends[0] < ends[2]:
            name = f"{solver}: {CLAIM[row['claim']].title}"
            effects[name], tones[name] = ends, TONES.get(row["verdict"], MUTED)
    bound = CLAIMS[0].bound_percent
    limits = {"no change": 0.0, f"+{bound:g}": bound}
    says = f"Table I as printed: with their whole 95 % interval mu right of +{bound:g} %, both errors left of zero."
    drawn = interval_picture(effects, tones, "change against DCAC with the same gains [%]", limits)
    return [Picture(drawn, says, "claims")] if effects else []


def _known(drawn: Figures) -> list[Picture]:
    says = {
        f"figure7-{PRINTED}-mu": "The paper's Figure 7, upper row: manipulability over the ticks of all trials; higher "
        "is better.",
        "swivel": "The start decides how much there is to gain: nothing from the best swivel (star), most from the "
        "worst.",
    }
    return [Picture(drawn[name], words, name) for name, words in says.items() if name in drawn]


# The page below the answer.


def page(
    summary: Summary, groups: Mapping[str, str], best: tuple[str, str], boxes: Mapping[str, Figures],
    looks: Sequence[Look], robot: RobotModel, out: Path, environment: Mapping[str, Any], first: Answer,
) -> Page:  # fmt: skip
    """Make the page; the replay is written to ``out``."""
    page = Page("The paper's experiment in simulation", "DCAC and MOC on three virtual tasks")
    first.begin(page)
    page.section("Goals")
    page.table(goal_table(summary, *best))
    for group, about in groups.items():
        page.section(f"Group {group}")
        page.text(f"{about[:1].upper()}{about[1:]}.")
        page.table(verdict_table(summary["verdict"], group))
        page.table(group_table(summary, group))
        page.table(phase_table(summary["phases"], group))
        for name, drawn in boxes[group].items():
            if name not in page.figures:
                page.figure(drawn, "Distribution over the ticks of all trials, by task.", name=name)
    if summary["ablation"]:
        page.section("Which entry of Table I decides")
        page.text("The paper's parameters with some entries exchanged, on both sides of the comparison.")
        page.table(ablation_table(summary["ablation"]))
    add_looks(page, looks, out, best, robot)
    page.section("The procedure")
    page.text(
        "A hand guides the tip to the incision, where the trocar is registered; the camera finds the board; the tip "
        "follows the task that is defined on it, and waits while the board is lost. Errors are against the truth."
    )
    page.table(procedure_table(summary))
    page.environment(environment)
    return page


def _of_group(rows: Rows, group: str, keys: Iterable[str], suffix: str) -> list[dict[str, Any]]:
    """Return the rows of a group, with the controller's title and each key's value with its interval."""
    return [
        {**row, "controller": title(row["controller"]), **{key: spread(row, f"{key}{suffix}") for key in keys}}
        for row in rows
        if row["group"] == group
    ]


def verdict_table(rows: Rows, group: str) -> Table:
    columns = [
        Column("controller", "controller"), Column("text", "claim"), Column("verdict", "verdict"),
        Column("own", "against DCAC, its own gains", unit="%", help="effect with its 95 % interval"),
        Column("matched", "MOC's gains", unit="%"), Column("damped", "MOC's gains, damped", unit="%"),
    ]  # fmt: skip
    drawn = _of_group(rows, group, ("own", "matched", "damped"), "_percent")
    return Table(f"Group {group}: do the paper's claims hold?", columns, drawn)


def group_table(summary: Summary, group: str) -> Table:
    """Make the table of a group's controllers: means over the trials with their intervals."""
    errors = [CLAIM[name] for name in SHOWN[1:]]
    units = {"mu_mean": "m^3", "mu_gain_percent": "%", **{one.metric: "mm" for one in errors}, REPEATED.metric: "N"}
    names = ["mu", "gain", *(one.title for one in errors), REPEATED.title]
    columns = [Column("controller", "controller")]
    columns += [Column(key, name, unit=unit) for name, (key, unit) in zip(names, units.items(), strict=True)]
    columns += [
        Column("mu_fraction_of_bound", "of bound", better="high"),
        Column("mu_fraction_of_best_from_start", "of best from start", better="high"),
        Column("mu_fraction_of_best", "of best", better="high"),
        Column("torque_rate_rms_Nm_per_s", "chatter", unit="Nm/s", better="low"),
        Column("broke_off", "broke off", format="d", better="low", help="stopped or failed; in no mean"),
        Column("oscillated", "oscillated", format="d", better="low", help="a joint shook; in the means"),
    ]
    rows = [
        {**entries, "controller": title(controller),
         **{key: spread(entries, key, 4 if key == "mu_mean" else 3) for key in units}}
        for controller, entries in summary[group].items()
    ]  # fmt: skip
    note = f"Mean over the trials, with its 95 % bootstrap interval; the gain is that of the mean mu. {ABOUT_FRAMES}"
    return Table(f"Group {group}", columns, rows, note)


def phase_table(rows: Rows, group: str) -> Table:
    columns = [Column("controller", "controller"), Column("phase", "phase"),
               Column("share_of_ticks", "share", format=".2f", help="of the ticks of a trial")]  # fmt: skip
    for name in (*SHOWN[1:], "force"):
        claim = CLAIM[name]
        columns.append(Column(claim.metric, claim.title, unit="N" if name == "force" else "mm"))
        columns.append(Column(name, "change", unit="%", help="against DCAC with the same gains, 95 % interval"))
    drawn = _of_group(rows, group, CLAIM, "_change_percent")
    return Table(
        f"Group {group}: while an elbow travels, and in the steady state", columns, drawn,
        "Steady (phase `settled`): the ticks of a trial at which no controller with a third level has its elbow on the "
        f"way to its optimum; the same ticks for all controllers. A trial counts by its ticks. {ABOUT_FRAMES}",
    )  # fmt: skip


def goal_table(summary: Summary, group: str, solver: str) -> Table:
    """Make the table of the goals of the best MOC, and what they are from other starts."""
    away = {row["goal"]: row for row in summary.get("goals_elsewhere", [])}
    drawn = []
    for row in summary["goals"]:
        there = away.get(row["goal"])
        found = {"away": goal_value(there), "away_reached": in_words(there)} if there else {}
        drawn.append({**row, "value": goal_value(row), "reached": in_words(row), **found})
    columns = [Column("text", "goal"), Column("limit", "limit"),
               Column("value", "value", help="with its 95 % interval"), Column("reached", "reached")]  # fmt: skip
    columns += [Column("away", "random poses"), Column("away_reached", "reached")] if away else []
    return Table(f"Goals: MOC with {solver}, group {group}", columns, drawn, ABOUT_FRAMES)


def ablation_table(rows: Rows) -> Table:
    """Make the table of Table I with entries exchanged: one row a case, the effect on every claim's metric."""
    drawn = []
    for case in dict.fromkeys(row["case"] for row in rows):
        mine = [row for row in rows if row["case"] == case]
        confirmed = ", ".join(row["claim"] for row in mine if row["confirmed"])
        drawn.append({
            **{key: mine[0][key] for key in ("about", "trials")},
            **{row["claim"]: spread(row, "effect_percent") for row in mine},
            "holds": too_few(mine[0]["trials"]) or confirmed,
            "decides": ", ".join(row["claim"] for row in mine if row.get("decides")),
        })  # fmt: skip
    columns = [Column("about", "entries"), Column("trials", "trials", format="d")]
    columns += [Column(claim.name, claim.title, unit="%", help="effect with its 95 % interval") for claim in CLAIMS]
    columns += [Column("holds", "claims confirmed"), Column("decides", "decides on")]
    return Table("Table I with entries exchanged, against matched DCAC", columns, drawn, RULE)


def procedure_table(summary: Summary) -> Table:
    columns = [
        Column("task", "task"), Column("ended", "ended"),
        Column("registration_error_mm", "trocar off", unit="mm", help="registered against true, after guiding"),
        Column("hand_force_max_N", "hand", unit="N", help="largest force of the hand"),
        Column("board_position_mm", "board off", unit="mm", help="as located by the camera, against the truth"),
        Column("board_angle_deg", "board off", unit="deg"),
        Column("waited_s", "waited", unit="s", help="for a board that could not be seen"),
        Column("tip_error_mean_mm", "tip", unit="mm", help="from the reference that the robot follows"),
        Column("path_deviation_mean_mm", "off the task", unit="mm", help="from the task as it lies on the phantom"),
        Column("rcm_error_mean_mm", "RCM", unit="mm", help="from the true incision"), Column("error", "error"),
    ]  # fmt: skip
    rows = [{"task": task, **entries} for task, entries in summary["procedure"].items()]
    pictures = summary["board_pictures"]
    caption = (
        f"Single pictures of the board at random poses: seen in {100 * pictures['seen']:.0f} %, "
        f"off by {pictures['position_median_mm']:.2f} mm and {pictures['angle_median_deg']:.2f} deg (medians)."
    )
    return Table("The operative procedure, whole", columns, rows, caption)


# Figures.


def box_figures(outcomes: Sequence[Outcome], group: str, tasks: Sequence[str]) -> dict[str, go.Figure]:
    """Draw one figure a quantity: boxes over the ticks of all trials, by task, a colour a controller."""
    mine = [o for o in outcomes if any(m.group == group for m in o.measurements)]
    controllers, drawn = dict.fromkeys(controller for o in mine for controller, _ in o.samples), {}
    for column, (short, axis, factor) in PANELS.items():
        boxes: dict[str, dict[str, Any]] = {}
        for controller, task in ((controller, task) for controller in controllers for task in tasks):
            parts = [o.samples[controller, task][column] for o in mine if (controller, task) in o.samples]
            if parts:
                boxes.setdefault(title(controller), {})[task] = factor * np.concatenate(parts)
        if boxes:
            drawn[f"figure7-{group}-{short}"] = figures.box_plots(boxes, axis)
    return drawn


def swivel_figure(rows: Rows) -> go.Figure:
    """Draw the gain in mu and mu at the start against the place on the feasible self-motion."""
    known = [row for row in rows if "gain_percent" in row]
    top = [row for row in known if row["at_maximum"]]
    drawn, colors = figure(), list(SERIES)
    for shown, key, name, how in (
        (known, "gain_percent", "gain over DCAC [%]", {"mode": "lines+markers", "line": {"color": colors[0]}}),
        (known, "mu_start", "µ at the start [m³]",
         {"mode": "lines", "line": {"color": colors[1], "dash": "dash"}, "yaxis": "y2"}),
        (top, "gain_percent", "start at the largest µ",
         {"mode": "markers", "marker": {"color": colors[0], "size": 13, "symbol": "star"}}),
    ):  # fmt: skip
        places, values = [row["fraction"] for row in shown], [row[key] for row in shown]
        drawn.add_scatter(x=places, y=values, name=label(name), hovertemplate="%{y:.3g}<extra></extra>", **how)
    drawn.update_xaxes(title_text="start on the feasible self-motion (0: one end, 1: the other)")
    drawn.update_yaxes(title_text="gain in mean µ over DCAC [%]")
    drawn.update_layout(
        yaxis2={"overlaying": "y", "side": "right", "title": {"text": "µ at the start [m³]"}, "showgrid": False,
                "linecolor": MUTED, "ticks": "outside", "showline": True, "zeroline": False},
        margin_r=64,
    )  # fmt: skip
    return drawn


# One trial a task is looked at: the one in which the best MOC gained what the middle one of the task's trials gained.


@dataclass(frozen=True)
class Look:
    """One trial of a task, chosen from ``of``: its runs by their titles, and their map or why there is none."""

    task: str
    trial: str
    gain_percent: float
    of: int
    traces: Mapping[str, Trace]
    found: SwivelMap | str

    def rows(self) -> list[dict[str, Any]]:
        if isinstance(self.found, str):
            return []
        about = {"task": self.task, "trial": self.trial}
        return [about | asdict(read_trajectory(self.found, name)) for name in self.found.trajectories]


def looks(robot: RobotModel, outcomes: Sequence[Outcome], group: str, solver: str) -> list[Look]:
    """Choose a trial of each task: that with the middle gain, of an even number the lower middle.

    The best MOC is shown with the parameters of the other groups that leave the path as it is, too.
    """
    gains: dict[str, list[tuple[float, int]]] = {}
    for place, outcome in enumerate(outcomes):
        for m in of_phase(outcome.measurements, group, solver):
            if outcome.traces and "mu_gain_percent" in m.metrics:
                gains.setdefault(m.task, []).append((m.metrics["mu_gain_percent"], place))
    found = []
    for task, known in gains.items():
        gain, place = sorted(known)[(len(known) - 1) // 2]
        trial = outcomes[place].measurements[0].trial
        traces = {title(name): trace for name, trace in outcomes[place].traces.items()}
        for other in outcomes:
            about = other.measurements[0] if other.measurements else None
            if about and about.trial == trial and about.group != group and solver in other.traces:
                traces[f"{title(solver)}, group {about.group}"] = other.traces[solver]
        found.append(Look(task, trial, gain, len(known), traces, trial_map(robot, traces)))
    return found


def add_looks(page: Page, looks: Sequence[Look], out: Path, best: tuple[str, str], robot: RobotModel) -> None:
    """Add the maps, and the replay of the first trial, which is written to ``out``."""
    if not looks:
        return
    moc = title(best[1])
    chosen = "; ".join(f"{look.trial}: {look.gain_percent:+.1f} %, of {look.of} trials" for look in looks)
    page.section("Where the elbow goes")
    page.text(
        f"One trial of each task, from the group {best[0]}: the one in which {moc} gained the middle of what it gained "
        f"over DCAC with the same gains in all trials of that task ({chosen}). All controllers start from the same "
        f"pose, on the same plant; where a group changes parameters alone, {moc} is shown with these too."
    )
    for look in looks:
        if isinstance(look.found, str):
            page.text(f"{look.task}: there is no map: {look.found}")
        else:
            what, styles = f"trial {look.trial}", Styles(look.traces)
            add_map(page, look.found, name=f"map-{look.task}", what=what, styles=styles)
    look = looks[0]
    pair = {name: look.traces[name] for name in (BASELINES[MATCHED], moc) if name in look.traces}
    add_replay(page, out, robot, pair, f"Trial {look.trial}: {' and '.join(pair)}", Styles(look.traces))

"""A plan as tables and as JSON: whether the path can be executed comes first, then what its courses are worth."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from moc_opt.report.tables import Column, Table

if TYPE_CHECKING:
    from moc_opt.planning.plan import Placement, Plan
    from moc_opt.robots.model import RobotModel

VERDICT = [Column("what", "plan"), Column("value", "value")]
COURSES = [
    Column("course", "course"),
    Column("mu_mean", "mean mu", unit="m^3", format=".4f", better="high"),
    Column("mu_worst", "worst mu", unit="m^3", format=".4f", better="high"),
    Column("share_percent", "of best", unit="%", format=".1f", help="mean mu over that of the best over all starts"),
    Column("certified", "optimum", help="'local' to the tolerance of the solver, or 'grid'"),
    Column("violation", "violation", unit="m, rad", format=".0e"),
]
VERDICT_TERMS = (
    "Swivel: angle of the elbow about the line from shoulder to wrist. Course: the poses along the path. "
    "Bound: what no course can exceed."
)
COURSES_TERMS = (
    "Local climb: an ideal climb of mu from the start, without dynamics or gains: a run with third_level = 'local' may "
    "reach another value, by what its controller can follow. Optimum: 'local' where no course nearby is "
    "better, 'grid' the best of the map's samples. Violation: the largest miss of the path or of a limit."
)
PLACES = [
    Column("shift", "moved by x, y, z", unit="mm"), Column("depth_mm", "tip below trocar", unit="mm", format=".0f"),
    Column("mu_mean", "mean mu", unit="m^3", format=".4f", better="high"),
    Column("mu_worst", "worst mu", unit="m^3", format=".4f", better="high"),
]  # fmt: skip


def plan_json(plan: Plan) -> dict[str, Any]:
    """Return the figures of a plan, nested as the tables are."""
    stuck = plan.blocked
    same = ("executable", "objective", "bound_from_start", "bound", "map_s", "search_s", "bound_s", "refine_s")
    return {
        **{name: getattr(plan, name) for name in same},
        "blocked": None if stuck is None else {
            "t_s": stuck.t_s, "arc_length_mm": 1e3 * stuck.arc_length_m, "tip_m": list(stuck.tip_m),
            "reason": stuck.reason,
        },
        "start_swivel_deg": math.degrees(plan.start_swivel_rad),
        "proposed_swivel_deg": math.degrees(plan.best_swivel_rad),
        "proposed_q_rad": None if plan.best is None else plan.best.q_rad[0].tolist(),
        "courses": {row["course"]: {name: row[name] for name in row if name != "course"} for row in _courses(plan)},
    }  # fmt: skip


def plan_tables(name: str, plan: Plan, **within: float) -> list[Table]:
    """Make the tables of the verdict and of the courses; both fit 80 columns.

    Args:
        name: of the scenario.
        plan: of it.
        within: margin_rad, margin_m, speed_share and shaft_margin that it was made with, as of
            `moc_opt.scenario.planned.plan`.
    """
    said = {"can be executed from this start": "yes" if plan.executable else "no"}
    if plan.blocked is not None:
        stuck = plan.blocked
        point = ", ".join(f"{x:.3f}" for x in stuck.tip_m)
        where = f"{1e3 * stuck.arc_length_m:.1f} mm along the path (t = {stuck.t_s:.2f} s), tip at {point} m"
        said |= {"first point out of reach": where, "why": stuck.reason}
    units = (("rad", within.get("margin_rad", 0.0)), ("m", within.get("margin_m", 0.0)))
    kept = " and ".join(f"{margin:g} {unit}" for unit, margin in units if margin > 0.0)
    limits = f"{kept} from the joint limits" if kept else "the joint limits"
    said["planned within"] = f"{limits}, {100.0 * within.get('speed_share', 1.0):.3g} % of their speed limits"
    if (shaft := within.get("shaft_margin", 0.0)) > 0.0:
        said["margin from losing the shaft"] = f"{shaft:.3g}, where there is a way"
    said["swivel at the start"] = _degrees(plan.start_swivel_rad)
    said["swivel of the best start"] = _degrees(plan.best_swivel_rad)
    for what, bound in (("bound from this start", plan.bound_from_start), ("bound over all starts", plan.bound)):
        if math.isfinite(bound):
            said[f"{what} ({_unit(plan)})"] = f"{bound:.5f}"
    parts = (("map", plan.map_s), ("search", plan.search_s), ("bounds", plan.bound_s), ("refinement", plan.refine_s))
    said["computed in"] = ", ".join(f"{what} {seconds:.2f} s" for what, seconds in parts)
    rows = [{"what": what, "value": value} for what, value in said.items()]
    return [
        Table(f"Plan of {name}", VERDICT, rows, VERDICT_TERMS),
        Table(f"Courses, best in {_unit(plan)}", COURSES, _courses(plan), COURSES_TERMS),
    ]


def place_json(places: Sequence[Placement]) -> list[dict[str, Any]]:
    """Return the places, the best first, with the start pose that each one's course begins at."""
    return [
        {
            "shift_mm": [1e3 * x for x in found.shift_m], "depth_m": found.depth_m,
            "mu_mean": None if found.course is None else found.course.mu_mean,
            "mu_worst": None if found.course is None else found.course.value("worst"),
            "q_rad": None if found.course is None else found.course.q_rad[0].tolist(),
        } for found in places
    ]  # fmt: skip


def start_toml(robot: RobotModel, plan: Plan, places: Sequence[Placement] = ()) -> str:
    """Write the tables that begin a scenario where the best course, or that of the best place, does; empty without one.

    A number is rounded towards the inside of its joint's limits.
    """
    course, depth, of = plan.best, None, "the best course"
    if places and places[0].course is not None:
        course, depth, of = places[0].course, places[0].depth_m, "the course of the first place"
    if course is None:
        return ""
    inside = np.ceil(1e6 * robot.q_min) / 1e6, np.floor(1e6 * robot.q_max) / 1e6
    q = np.clip(np.round(course.q_rad[0], 6), *inside)
    numbers = textwrap.fill(", ".join(f"{x:.6f}" for x in q), 76, initial_indent="  ", subsequent_indent="  ")
    trocar = [] if depth is None else ["[trocar]", f"depth_m = {depth:.6f}"]
    about = f"# to begin {of}, put in place of the scenario's own [start]{' and depth_m' if trocar else ''}:"
    return "\n".join([about, "[start]", f"q_rad = [\n{numbers},\n]", *trocar])


def place_table(title: str, candidates: int, box_m: float, took_s: float, places: Sequence[Placement]) -> Table:
    """Make the table of the places, the best first."""
    rows = []
    for found, row in zip(places, place_json(places), strict=True):
        x, y, z = row["shift_mm"]
        here = " (as it is)" if not any(found.shift_m) else ""
        rows.append({**row, "shift": f"{x:+.0f}, {y:+.0f}, {z:+.0f}{here}", "depth_mm": 1e3 * found.depth_m})
    about = f"{candidates} places drawn from a cube of +-{1e3 * box_m:.0f} mm, planned in {took_s:.0f} s."
    return Table(title, PLACES, rows, about)


def _unit(plan: Plan) -> str:
    return {"mean": "mean mu", "worst": "worst mu", "log": "mean log mu"}[plan.objective]


def _degrees(angle: float) -> str:
    return f"{math.degrees(angle):.1f} deg" if math.isfinite(angle) else "none: no course goes all the way"


def _courses(plan: Plan) -> list[dict[str, Any]]:
    climbed = "local climb" if plan.climbed_whole else f"local climb, stuck at {plan.climbed.t_s[-1]:.2f} s"
    rows = []
    for name, course in (("best from start", plan.from_start), ("best over all", plan.best), (climbed, plan.climbed)):
        if course is None:
            continue
        whole = len(course.mu) == len(plan.targets)
        share = 100.0 * course.mu_mean / plan.best.mu_mean if whole and plan.best is not None else None
        optimum = "" if name == climbed else ("local" if course.certified else "grid")
        rows.append({
            "course": name, "mu_mean": course.mu_mean, "mu_worst": course.value("worst"), "share_percent": share,
            "certified": optimum, "violation": course.violation,
        })  # fmt: skip
    return rows

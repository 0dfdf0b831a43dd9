"""A plan as tables and as JSON."""

from __future__ import annotations

import math
import textwrap
from typing import Any

import numpy as np

from moc_opt.planning.plan import Plan
from moc_opt.report.tables import Column, Table
from moc_opt.robots.model import RobotModel

COURSES = [
    Column("course", "course"), Column("mu_mean", "mean mu", unit="m^3", format=".4f", better="high"),
    Column("mu_worst", "worst mu", unit="m^3", format=".4f", better="high"),
    Column("share_percent", "of best", unit="%", format=".1f", help="mean mu / mean mu of the course 'best over all'"),
    Column("certified", "optimum", help="'local': no similar course is better. 'grid': the best of sampled courses."),
    Column("violation", "violation", unit="m, rad", format=".0e"),
]  # fmt: skip
STEPS = {"map": "map of poses", "search": "search on the map", "bound": "bound of mean mu", "refine": "refinement"}
VERDICT_TERMS = (
    "mu: manipulability. Swivel: angle of the elbow about the line from shoulder to wrist. In [start], swivel is "
    "no angle, but a share (0 to 1) of the elbow's range. To start at the swivel of the best start, use q_rad instead."
)
COURSES_TERMS = (
    "Course: joint motion along the path. Local climb: course up the gradient of mu, with ideal tracking. A run with "
    "third_level = 'local' may differ. Optimum 'local': no similar course is better. Optimum 'grid': the best "
    "of sampled courses. Violation: largest distance from the path, or largest excess over a limit."
)


def plan_json(plan: Plan) -> dict[str, Any]:
    """Return a plan as data for JSON."""
    stuck = plan.blocked
    return {
        "executable": plan.executable, "bound_from_start": plan.bound_from_start, "bound": plan.bound,
        **{f"{part}_s": seconds for part, seconds in plan.took_s.items()},
        "blocked": None if stuck is None else {
            "t_s": stuck.t_s, "arc_length_mm": 1e3 * stuck.arc_length_m, "tip_m": list(stuck.tip_m),
            "reason": stuck.reason,
        },
        "start_swivel_deg": math.degrees(plan.start_swivel_rad),
        "proposed_swivel_deg": math.degrees(plan.best_swivel_rad),
        "proposed_q_rad": None if plan.best is None else plan.best.q_rad[0].tolist(),
        "courses": {row.pop("course"): row for row in _courses(plan)},
    }  # fmt: skip


def plan_tables(name: str, plan: Plan, **within: float) -> list[Table]:
    """Make two tables of a plan: its verdict, and its courses.

    Args:
        within: margin_rad, margin_m, speed_share and shaft_margin, as in `moc_opt.scenario.planned.plan`.
    """
    said = {"can be executed from this start": "yes" if plan.executable else "no"}
    if (stuck := plan.blocked) is not None:
        point = ", ".join(f"{x:.3f}" for x in stuck.tip_m)
        where = f"{1e3 * stuck.arc_length_m:.1f} mm along the path (t = {stuck.t_s:.2f} s), tip at {point} m"
        said |= {"first point out of reach": where, "why": stuck.reason}
    margins = [f"{within[f'margin_{side}']:g} {side}" for side in ("rad", "m") if within.get(f"margin_{side}")]
    limits = f"{' and '.join(margins)} from the joint limits" if margins else "the joint limits"
    said["planned within"] = f"{limits}, {100.0 * within.get('speed_share', 1.0):.3g} % of the joints' speed limits"
    if within.get("shaft_margin"):
        said["shaft manipulability"] = f"at least {within['shaft_margin']:.3g} L^2 if possible (L: from wrist to tip)"
    for what, angle in {"at the start": plan.start_swivel_rad, "of the best start": plan.best_swivel_rad}.items():
        known = math.isfinite(angle)
        said[f"swivel {what}"] = f"{math.degrees(angle):.1f} deg" if known else "none: no course reaches the end"
    bounds = {"from this start": plan.bound_from_start, "from any start": plan.bound}
    said |= {f"largest mean mu {of}": f"{bound:.5f} (estimate)" for of, bound in bounds.items() if math.isfinite(bound)}
    took = {STEPS.get(part, part): seconds for part, seconds in plan.took_s.items()}
    said["computation time"] = ", ".join(f"{part} {seconds:.2f} s" for part, seconds in took.items())
    rows = [{"what": what, "value": value} for what, value in said.items()]
    columns = [Column("what", "plan"), Column("value", "value")]
    courses = Table("Courses of largest mean mu", COURSES, _courses(plan), COURSES_TERMS)
    return [Table(f"Plan of {name}", columns, rows, VERDICT_TERMS), courses]


def _courses(plan: Plan) -> list[dict[str, Any]]:
    climbed = "local climb" if plan.climbed_whole else f"local climb, stuck at {plan.climbed.t_s[-1]:.2f} s"
    known = {"best from start": plan.from_start, "best over all": plan.best, climbed: plan.climbed}
    rows = []
    for name, course in known.items():
        if course is None:
            continue
        best = plan.best if len(course.mu) == len(plan.targets) else None
        rows.append({
            "course": name, "mu_mean": course.mu_mean, "mu_worst": course.mu.min(),
            "share_percent": best and 100.0 * course.mu_mean / best.mu_mean,
            "certified": "" if name == climbed else "local" if course.certified else "grid",
            "violation": course.violation,
        })  # fmt: skip
    return rows


def start_toml(robot: RobotModel, plan: Plan) -> str:
    """Return a [start] table with the first pose of the best course, or "" if there is no course."""
    if plan.best is None:
        return ""
    inside = np.ceil(1e6 * robot.q_min) / 1e6, np.floor(1e6 * robot.q_max) / 1e6
    q = np.clip(np.round(plan.best.q_rad[0], 6), *inside)
    numbers = textwrap.fill(", ".join(f"{x:.6f}" for x in q), 76, initial_indent="  ", subsequent_indent="  ")
    about = "# to start on the best course, replace the [start] of the scenario by:"
    return "\n".join([about, "[start]", f"q_rad = [\n{numbers},\n]"])

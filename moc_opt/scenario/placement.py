"""Where the trocar, or the arm's base, serves a path best: a seeded search over a box, every candidate planned.

All candidates are planned on a coarse grid, the best few again on the plan's own: by dynamic programming over every
swivel and branch at the start, within joint limits and speeds. The path of the tip stays where it is.
"""

from __future__ import annotations

import numbers
from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from moc_opt.arrays import Array
from moc_opt.errors import ScenarioError, TaskError, is_number, shown
from moc_opt.planning.course import Limits, Objective, make_course
from moc_opt.planning.guides import margin_of
from moc_opt.planning.plan import Placement, best_course, check_limits
from moc_opt.planning.pose_map import SWIVELS, map_of
from moc_opt.planning.program import worth
from moc_opt.planning.search import Value, keeping_shaft
from moc_opt.scenario.config import Scenario
from moc_opt.scenario.planned import layout_of, targets_of

Movable = Literal["trocar", "base"]
MOVABLE: tuple[Movable, ...] = get_args(Movable)

COARSE_S, COARSE_SWIVELS = 0.05, 180
"""Of the grid on which all candidates are planned."""


def place(
    scenario: Scenario,
    what: Movable,
    *,
    box_m: float = 0.05,
    candidates: int = 40,
    seed: int = 0,
    best: int = 5,
    objective: Objective = "mean",
    margin_rad: float = 0.0,
    margin_m: float = 0.0,
    speed_share: float = 1.0,
    shaft_margin: float = 0.0,
) -> list[Placement]:
    """Search a cube for the place that serves the path best; the best first, the present place among them.

    Args:
        what: moves, in the world's axes: the "trocar", or the "base" without turning.
        box_m: half the edge of the cube about the present place [m].
        candidates: drawn evenly from the cube.
        best: places that are planned on the finer grid and returned, besides the present one.
        objective, margin_rad, margin_m, speed_share, shaft_margin: as of `moc_opt.scenario.planned.plan`.

    Raises:
        ScenarioError, TaskError: an argument is out of range.
        MocOptError: the scenario's start, path or trocar is not usable.

    Example:
        >>> from moc_opt.scenario.placement import place
        >>> places = place(mo.Scenario(duration_s=1.0), "base", candidates=2, best=1)
        >>> len(places), places[0].course.mu_mean >= places[1].course.mu_mean
        (2, True)
    """
    if what not in MOVABLE:
        raise ScenarioError(f"place = {what!r}: choose one of {', '.join(map(repr, MOVABLE))}")
    if not is_number(box_m) or not 0.0 < box_m <= 1.0:
        raise ScenarioError(f"box_m = {box_m!r}: give half the edge of a cube, above 0 to 1 m")
    for name, count, least in (("candidates", candidates, 1), ("best", best, 1), ("seed", seed, 0)):
        if not isinstance(count, numbers.Integral) or isinstance(count, bool) or count < least:
            raise ScenarioError(f"{name} = {shown(count)}: give a whole number, {least} or more")
    robot = scenario.robot.arm()
    layout = layout_of(scenario, robot)
    limits = Limits(margin_of(robot, margin_rad, margin_m), speed_share, shaft=shaft_margin)
    check_limits(robot, limits, objective)
    shifts = np.vstack([np.zeros(3), np.random.default_rng(seed).uniform(-box_m, box_m, (candidates, 3))])

    def planned(shift: Array, times: int | None, swivels: int) -> tuple[float, Placement]:
        moved, trocar = (float(shift[0]), float(shift[1]), float(shift[2])), layout.registered
        if what == "trocar":
            trocar = replace(trocar, point=np.asarray(trocar.point) + shift)
        depth = float(np.linalg.norm(trocar.at(0.0)[0] - robot.state(layout.q).tip))
        try:
            targets = targets_of(robot, replace(layout, registered=trocar), times)
        except TaskError:  # the trocar is off the shaft somewhere
            return -np.inf, Placement(moved, None, depth)
        if what == "base":
            targets = replace(targets, tip=targets.tip - shift, wrist=targets.wrist - shift)
        whole = map_of(robot, layout.q, targets, swivels)
        q = best_course(Value(keeping_shaft(whole, limits), limits, objective), limits, None)
        if q is None:
            return -np.inf, Placement(moved, None, depth)
        course = make_course(robot, targets, q, limits)
        return worth(robot, course, limits, objective, float(np.nanmax(whole.mu))), Placement(moved, course, depth)

    coarse_times = max(2, round(layout.duration_s / COARSE_S) + 1)
    coarse = [planned(shift, coarse_times, COARSE_SWIVELS)[0] for shift in shifts]
    order = [int(k) for k in np.argsort(coarse)[::-1] if np.isfinite(coarse[int(k)]) and k][:best]
    found = sorted((planned(shifts[k], None, SWIVELS) for k in (0, *order)), key=lambda each: each[0], reverse=True)
    return [each for _, each in found]

"""Plan a scenario before its run: `moc_opt.planning` on its path, trocar and start."""

from __future__ import annotations

import numbers
import os

import numpy as np

from moc_opt.errors import ScenarioError, TaskError, is_number, shown
from moc_opt.model.robot_model import RobotModel
from moc_opt.planning.course import Objective
from moc_opt.planning.plan import Plan, make_plan
from moc_opt.planning.pose_map import SWIVELS, Margin
from moc_opt.planning.targets import Targets, lay_targets
from moc_opt.scenario.config import Scenario
from moc_opt.scenario.layout import Layout, lay_out, seeds_of

PERIOD_S = 0.025
"""Between the times of a plan at most, if a path has no more than `MOST_TIMES` of them."""
MOST_TIMES = 1000


def plan(
    scenario: Scenario | str | os.PathLike[str],
    *,
    objective: Objective = "mean",
    times: int | None = None,
    swivels: int = SWIVELS,
    margin_rad: float = 0.0,
    margin_m: float = 0.0,
    speed_share: float = 1.0,
    acceleration: float = np.inf,
    shaft_margin: float = 0.0,
    refined: bool = True,
) -> Plan:
    """Plan a scenario's run: whether it can be executed, from which swivel, how well, and along which course.

    The plan uses the controller's data: the robot model, the registered trocar, the reference from the first
    tick to the last. A random start is drawn as the run draws it.

    Args:
        scenario: of the run, or the path of its file.
        objective: maximised by the best course: "mean" mu, "worst" mu, or the mean of "log" mu.
        times: points of the path; None: one each `PERIOD_S`, 2 to 1000.
        margin_rad: that every joint keeps from its limits [rad].
        margin_m: the same of a joint that slides [m].
        swivels: samples of one turn of the elbow; an arm without a closed form takes only those above the default.
        speed_share: of the joints' speed limits that a course may use, above 0 to 1.
        acceleration: most of any joint, from rest [rad/s^2]; the refinement keeps it, the grid does not know it.
        shaft_margin: least share of the squared lever that the shaft's manipulability keeps, where there is a way.
        refined: whether courses are improved beyond the grid.

    Raises:
        MocOptError: the scenario's start, path or trocar is not usable, or an argument is out of range.

    Example:
        >>> plan = mo.plan(mo.Scenario(duration_s=1.0), times=20, refined=False)
        >>> plan.blocked is None, abs(plan.best_swivel_rad) < 0.2
        (True, True)
    """
    scenario = Scenario.given(scenario)
    if times is not None and (not isinstance(times, numbers.Integral) or not 2 <= times <= 100_000):
        raise ScenarioError(f"times = {shown(times)}: give 2 to 100000 points of the path")
    robot = scenario.robot.arm()
    layout = layout_of(scenario, robot)
    return make_plan(
        robot, layout.q, targets_of(robot, layout, times), objective, swivels=swivels,
        margin=margin_of(robot, margin_rad, margin_m), speed_share=speed_share, acceleration=acceleration,
        shaft_margin=shaft_margin, refined=refined,
    )  # fmt: skip


def margin_of(robot: RobotModel, margin_rad: float, margin_m: float) -> Margin:
    """Return one number where no joint slides, else one per joint (n,).

    Raises:
        TaskError: a margin is no number of zero or more.
    """
    for name, value in (("margin_rad", margin_rad), ("margin_m", margin_m)):
        if not is_number(value) or not 0.0 <= value < np.inf:
            raise TaskError(f"{name} = {value!r}: give zero or more, and less than half of every joint's range")
    slides = robot.chain.prismatic
    return np.where(slides, margin_m, margin_rad) if slides.any() else margin_rad


def layout_of(scenario: Scenario, robot: RobotModel) -> Layout:
    """Lay a scenario's task out as its run does, whether or not the arm can follow the path from there.

    Raises:
        MocOptError: the scenario's start, path or trocar is not usable.
    """
    unchecked = scenario if scenario.start.pose == "random" else scenario.change(start={"check_path": False})
    return lay_out(unchecked, robot, np.random.default_rng(seeds_of(scenario)[0]))


def targets_of(
    robot: RobotModel, layout: Layout, times: int | None = None, *, period_s: float = PERIOD_S, finer: int = 1
) -> Targets:
    """Return the targets of tip and wrist on the path, from the first tick to the last.

    Args:
        times: so many evenly spaced ones; None: one each ``period_s`` at most, as long as there are no more than
            `MOST_TIMES` of them.
        finer: so many times as many.
    """
    spaces = int(np.clip(np.ceil(layout.duration_s / period_s), 1, MOST_TIMES - 1))
    count = times or finer * spaces + 1
    return lay_targets(
        layout.reference, layout.registered, robot.state(layout.q).tool_span, layout.duration_s, count,
        robot.data.tool_length,
    )  # fmt: skip

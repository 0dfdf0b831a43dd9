"""The exported C controller under extreme numbers (NaN, infinite, huge), beside the Python one in its guard."""

from __future__ import annotations

from functools import cache
from typing import Any, Literal

import hypothesis.strategies as st
import numpy as np

from moc_opt.control import Controller
from moc_opt.embedded.guarded import GuardedController
from moc_opt.model.robot_model import RobotModel
from moc_opt.numerics.arrays import Array
from moc_opt.scenario import Scenario, make_safety_filter, make_solver
from moc_opt.scenario.adapter import ControllerAdapter
from moc_opt.sim.filtered import FilteredController
from moc_opt.sim.sensors import Measurement

TICKS = 12
SAME_NM = 1e-9
ORDINARY = 1e3
"""Numbers above it lead to torques of which 1e-9 Nm is less than rounding: there only the limits are looked at."""
FIELDS = ("q", "v", "wrench", "tip_ref", "trocar", "stamp")
LAWS: tuple[dict[str, Any], ...] = (
    {}, {"fallback": "hold", "supervisor": {"hold_ticks": 2}}, {"law": "dcac", "dcac_damping": 3.0},
    {"preset": "paper"},
)  # fmt: skip

_strange = st.one_of(
    st.sampled_from([float("nan"), float("inf"), float("-inf"), 0.0, 1e300, -1e300, 5e-324]),
    st.floats(),
    st.floats(-3.0, 3.0),
)
cases = st.fixed_dictionaries({
    "law": st.integers(0, len(LAWS) - 1), "seed": st.integers(0, 2**16), "speed": st.floats(0.0, 1.0),
    "events": st.lists(
        st.tuples(st.integers(1, TICKS - 1), st.sampled_from(FIELDS), st.integers(0, 8), _strange), max_size=6
    ),
})  # fmt: skip
"""Law, pose and motion, and events: at a tick, an entry of a field gets a value, or the packet is one tick old."""


@cache
def _pair(law: int) -> tuple[Scenario, RobotModel, GuardedController]:
    scenario = Scenario(control=LAWS[law])
    robot = scenario.robot.arm()
    solver = make_solver("exact", robot) if scenario.control.law == "moc" else None
    period = scenario.plant.period_s
    return scenario, robot, GuardedController(robot, scenario.control, solver, period, scenario.told_guard)


def warm_up() -> None:
    """Compile every law: a compiler at work looks like a hang.

    Raises:
        CompilerError: there is none.
    """
    for law in range(len(LAWS)):
        exported({"law": law, "seed": 0, "speed": 0.0, "events": []})


def exported(case: dict[str, Any]) -> Literal["accepted", "refused"]:
    """Compare the torques of both: finite, within the limits, and the same; refused where the filter stopped the arm.

    Raises:
        AssertionError: one of them is not.
    """
    scenario, robot, c = _pair(case["law"])
    control, rng = scenario.control, np.random.default_rng(case["seed"])
    q = robot.random_regular_pose(rng)
    v = case["speed"] * rng.normal(scale=0.2, size=robot.n)
    solver = make_solver("exact", robot) if control.law == "moc" else None
    adapter = ControllerAdapter(Controller(robot, control, solver, scenario.plant.period_s))
    python = FilteredController(adapter, make_safety_filter(robot, scenario), robot.gravity(q))
    ordinary = True
    for k in range(TICKS):
        given = _inputs(robot, rng, q + k * scenario.plant.period_s * v, v)
        for _, field, entry, value in (e for e in case["events"] if e[0] == k and e[1] != "stamp"):
            given[field].flat[entry % given[field].size] = value
            ordinary = ordinary and not ORDINARY < abs(value) < np.inf
        stamp = k - sum(1 for tick, field, _, _ in case["events"] if field == "stamp" and tick == k)
        seen = Measurement(given["q"], given["v"], given["wrench"], stamp)
        if k == 0:
            python.start(seen, given["tip_ref"], given["trocar"])
            c.start(seen.q, seen.v, robot.gravity(q))
        with np.errstate(all="ignore"):
            expected = python.tick(seen, given["tip_ref"], given["trocar"])
        found = c.tick(given["q"], given["v"], given["tip_ref"], given["trocar"], given["wrench"], stamp)
        if not (np.isfinite(found).all() and (np.abs(found) <= robot.tau_max).all()):
            raise AssertionError(f"tick {k}: torque {found.tolist()} is beyond its limits")
        if ordinary and not (np.abs(found - expected).max() <= SAME_NM and python.stop_reason.startswith(c.reason)):
            raise AssertionError(
                f"tick {k}: C has {found.tolist()} ({c.reason}), Python {expected.tolist()} ({python.stop_reason})"
            )
    return "refused" if c.reason else "accepted"


def _inputs(robot: RobotModel, rng: np.random.Generator, q: Array, v: Array) -> dict[str, Array]:
    """Make a sound tick: the tip near its reference, the shaft through the trocar."""
    state = robot.state(q, v)
    tip_ref = rng.normal(size=(3, 3)) * [[1e-4], [1e-2], [1e-1]]
    tip_ref[0] += state.tip
    trocar = np.array([state.tip - 0.15 * state.tool_direction, np.zeros(3)])
    return {"q": q.copy(), "v": v.copy(), "wrench": np.zeros(6), "tip_ref": tip_ref, "trocar": trocar}

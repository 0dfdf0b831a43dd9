"""Commands and state of a live run: the data between it and its page."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree

import numpy as np

from moc_opt.control import ControlSettings
from moc_opt.errors import RobotError, ScenarioError, is_number
from moc_opt.model.robot_model import RobotModel
from moc_opt.numerics.arrays import Array

DCAC = "none (DCAC)"
MOST_OFFSET_M, MOST_BREATH_M, LEAST_PERIOD_S, MOST_PUSH_N, MOST_PUSH_S = 0.05, 0.03, 0.5, 60.0, 3.0


class LiveError(ScenarioError):
    """A live run cannot do what it was told; it goes on as it was."""


@dataclass(frozen=True, eq=False)
class Moment:
    """The state that a page shows."""

    t_s: float
    q: Array
    """(n,) [rad]"""
    tip: Array
    """(3,) [m]"""
    tip_ref: Array
    """(3,) [m]"""
    trocar: Array
    """(3,) [m]"""
    J_tip: Array
    """(3, n)"""
    mu: float
    solver: str
    """Its name, or `DCAC`."""
    status: str
    """Its last claim."""
    stopped: str
    """Why the arm was stopped; empty while it runs."""


def _check_numbers(what: str, *given: object) -> None:
    for value in given:
        if not is_number(value):
            raise LiveError(f"{what}: {value!r} is no number")


def checked_offset(x_m: float, y_m: float, z_m: float) -> Array:
    """Return the offset (3,) [m]; LiveError where it is no number, or farther than `MOST_OFFSET_M`."""
    _check_numbers("trocar offset", x_m, y_m, z_m)
    offset = np.array([x_m, y_m, z_m], dtype=np.float64)
    if not np.abs(offset).max() <= MOST_OFFSET_M:
        raise LiveError(f"trocar offset {offset.tolist()} m: give up to {MOST_OFFSET_M} m in each direction")
    return offset


def check_breathing(amplitude_m: float, period_s: float) -> None:
    """Raise LiveError where the breathing is out of range."""
    _check_numbers("breathing", amplitude_m, period_s)
    if not (0.0 <= amplitude_m <= MOST_BREATH_M and LEAST_PERIOD_S <= period_s < np.inf):
        raise LiveError(
            f"breathing of {amplitude_m} m in {period_s} s: give 0 to {MOST_BREATH_M} m, "
            f"and {LEAST_PERIOD_S} s or longer"
        )


def check_push(force_N: float, seconds: float) -> None:
    """Raise LiveError where the push is out of range."""
    _check_numbers("push", force_N, seconds)
    if not (abs(force_N) <= MOST_PUSH_N and 0.0 < seconds <= MOST_PUSH_S):
        raise LiveError(f"a push of {force_N} N for {seconds} s: give up to {MOST_PUSH_N} N, for up to {MOST_PUSH_S} s")


def changed(settings: ControlSettings, **changes: Any) -> ControlSettings:
    """Change settings with all the checks of the constructor, which `model_copy` leaves out."""
    return settings.replace(changes)


def child_link(robot: RobotModel, joint: int) -> str:
    """Return the link that a joint moves."""
    name = robot.data.joint_names[joint]
    child = ElementTree.fromstring(robot.data.urdf).find(f"joint[@name='{name}']/child")
    if child is None:
        raise RobotError(f"joint {name!r} has no child link in the URDF")
    return child.get("link", "")

"""The gains of the three levels as numbers: one for all joints or one per joint, from settings or an arm's table."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator

from moc_opt.errors import ControlError, UnknownNameError
from moc_opt.inputs.settings import LARGEST


def _number_or_numbers(value: Any) -> float | tuple[float, ...]:
    numbers = value if isinstance(value, list | tuple) else (value,)
    for number in numbers:
        if isinstance(number, bool) or not isinstance(number, int | float) or not 0.0 <= number <= LARGEST:
            raise ValueError("input should be a number of 0 or more, or a list with one for each joint")
    return float(value) if numbers is not value else tuple(float(number) for number in numbers)


PerJoint = Annotated[float | tuple[float, ...], BeforeValidator(_number_or_numbers)]
"""One number for all joints, or one per joint."""


class Gains(NamedTuple):
    """The gains of the three levels as a controller uses them."""

    K_X: float
    D_X: float
    K_N: float
    D_N: float
    K_N2: NDArray[np.float64]  #: (n,) [N m s/rad]
    D_N2: NDArray[np.float64]  #: (n,) [N m s/rad]


GAINS = Gains._fields


def resolve(
    law: str, given: Mapping[str, Any], tables: Mapping[str, Mapping[str, Any]], name: str, joints: int
) -> Gains:
    """Return K_X .. D_N2 as numbers: those ``given`` first, then the table ``name`` of the robot's [gains.*].

    Under law ``dcac`` K_N2 and D_N2 are zero; under ``moc`` they are spread to so many joints.

    Raises:
        UnknownNameError: ``name`` is no table of this robot.
        ControlError: a gain that this law needs stands nowhere, is no number of 0 or more, or has another
            length than the arm has joints.
    """
    if name not in tables:
        raise UnknownNameError("table of gains", name, tables)
    found: dict[str, Any] = {}
    for gain in GAINS if law == "moc" else GAINS[:4]:
        value, where = given[gain], ""
        if value is None:
            value, where = tables[name].get(gain), f" in [gains.{name}] of the robot"
        if value is None:
            raise ControlError(f"{gain}: not set, and [gains.{name}] of the robot has none; give a number")
        found[gain] = _one_number(gain, value, where) if gain in GAINS[:4] else per_joint(gain, value, joints, where)
    return Gains(**{"K_N2": np.zeros(joints), "D_N2": np.zeros(joints), **found})


def per_joint(name: str, value: Any, joints: int, where: str = "") -> NDArray[np.float64]:
    """Return one number for all joints, or one per joint, as (n,) numbers of 0 or more.

    Raises:
        ControlError: another length, or an entry that is no such number; the message contains ``where``.
    """
    numbers = value if isinstance(value, list | tuple) else [value] * joints
    if len(numbers) != joints:
        count = f"{len(numbers)} entries for {joints} joints"
        raise ControlError(f"{name} = {value!r}{where} has {count}: give one number, or one per joint")
    return np.array([_one_number(name, number, where) for number in numbers])


def _one_number(name: str, value: Any, where: str) -> float:
    if not isinstance(value, int | float) or not 0.0 <= value < float("inf"):
        raise ControlError(f"{name} = {value!r}{where}: give one number of 0 or more")
    return float(value)

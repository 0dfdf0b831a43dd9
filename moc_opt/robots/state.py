"""RobotState: the model's terms of an arm at one (q, v), in one flat read-only array."""

from __future__ import annotations

from functools import cache
from itertools import accumulate
from typing import Any, NoReturn

import numpy as np

from moc_opt.arrays import Array

_TIP, _WRIST = slice(0, 3), slice(3, 6)


def record_size(n: int) -> int:
    """Return the length of the flat record of an n-joint state."""
    return n * n + 13 * n + 18


@cache
def layout(n: int) -> dict[str, slice]:
    """Return where the parts of a record lie, in its order: that in which the core writes them."""
    parts = {
        "q": n, "v": n, "tip": 3, "wrist": 3, "u": 3, "A": 6 * n, "drift": 6, "grad_mu": n, "grad_mu_shaft": n,
        "M": n * n, "h": n, "energy_slope": n, "gravity": n, "scalars": 3,
    }  # fmt: skip
    ends = list(accumulate(parts.values()))
    return {name: slice(end - size, end) for (name, size), end in zip(parts.items(), ends, strict=True)}


def _part(name: str, doc: str, *, rows: slice | None = None, shape: tuple[int, ...] | None = None) -> Array:
    def view(state: RobotState) -> Array:
        part = state.record[layout(state.n)[name]]
        if shape is not None:
            part = part.reshape([size or state.n for size in shape])
        return part if rows is None else part[rows]

    return property(view, doc=doc)  # type: ignore[return-value]


def _scalar(index: int, doc: str) -> float:
    def number(state: RobotState) -> float:
        return float(state.record[layout(state.n)["scalars"].start + index])

    return property(number, doc=doc)  # type: ignore[return-value]


class RobotState:
    """The model's terms of an arm at one (q, v): read-only views of one flat array, `record`, in order of `layout`.

    Example:
        >>> robot = mo.load_robot("lwr4")
        >>> state = robot.state(robot.data.q_home, np.full(7, 0.1))
        >>> state.tip.shape, state.A.shape, state.M.shape, round(state.mu, 3)
        ((3,), (6, 7), (7, 7), 0.268)
        >>> np.allclose(state.tip - state.wrist, state.tool_span * state.tool_direction)
        True
        >>> np.allclose(state.A, np.vstack([state.J_tip, state.J_wrist]))
        True
    """

    record: Array
    n: int

    def __init__(self, record: Array, n: int) -> None:
        record.setflags(write=False)
        own = self.__dict__  # around our own __setattr__: a state is made at every tick
        own["record"], own["n"] = record, n

    def __setattr__(self, name: str, value: object) -> NoReturn:
        raise AttributeError(f"RobotState is frozen: {name} cannot be set")

    def __reduce__(self) -> tuple[Any, ...]:
        return RobotState, (self.record.copy(), self.n)

    def __repr__(self) -> str:
        return f"RobotState(n={self.n}, q={np.round(self.q, 4).tolist()}, mu={self.mu:.4g})"

    q = _part("q", "Joint positions (n,) [rad].")
    v = _part("v", "Joint velocities (n,) [rad/s].")
    tip = _part("tip", "Tool tip X (3,) [m].")
    wrist = _part("wrist", "Wrist centre N (3,) [m].")
    tool_direction = _part("u", "u = (X - N)/L (3,), the unit vector along the shaft.")
    tool_span = _scalar(1, "L = |X - N| [m], constant.")
    A = _part("A", "[J_tip; J_wrist] (6,n), of rank 5: tip and wrist are rigidly tied.", shape=(6, 0))
    J_tip = _part("A", "Translational Jacobian of the tip (3,n), world axes [m/rad].", rows=_TIP, shape=(6, 0))
    J_wrist = _part("A", "Translational Jacobian of the wrist (3,n), world axes [m/rad].", rows=_WRIST, shape=(6, 0))
    drift_tip = _part("drift", "dJ_tip/dt v (3,) [m/s^2].", rows=_TIP)
    drift_wrist = _part("drift", "dJ_wrist/dt v (3,) [m/s^2].", rows=_WRIST)
    mu = _scalar(0, "Manipulability sqrt(det(J_tip J_tip^T)) [m^3].")
    grad_mu = _part("grad_mu", "dmu/dq (n,) [m^3/rad]; zero at a singularity, where mu has a kink.")
    mu_shaft = _scalar(
        2, "Manipulability of the shaft once the tip is held [m^2]; see `moc_opt/core/manipulability.c`."
    )
    grad_mu_shaft = _part("grad_mu_shaft", "dmu_shaft/dq (n,) [m^2/rad]; zero at a singularity, where it has a kink.")
    M = _part("M", "Joint-space inertia (n,n), rotor inertia included [kg m^2].", shape=(0, 0))
    h = _part("h", "C v + g (n,) [Nm].")
    energy_slope = _part("energy_slope", "dT/dq = C^T v (n,) [Nm]: T the kinetic energy, C Christoffel's matrix.")
    gravity = _part("gravity", "g (n,) [Nm], the torque that carries the arm's weight.")

"""RobotState: what is known of the arm at one instant, in one flat immutable record."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from moc_opt.model import kinematics_kernels as kernels
from moc_opt.numerics.arrays import Array


@cache
def _layout(n: int) -> dict[str, slice]:
    """Return where each named view lies in a flat record, read off the views themselves."""
    index = np.arange(kernels.record_size(n), dtype=np.float64)
    views = kernels.state_views.py_func(index, n)._asdict()
    return {name: slice(int(view.flat[0]), int(view.flat[-1]) + 1) for name, view in views.items()}


class RobotState:
    """What is known of the arm at one (q, v): already computed, immutable, sharing memory with nothing.

    All numbers lie in one flat read-only array, `record`, whose layout is `kinematics_kernels.StateViews`; the
    attributes are read-only views of it, made when asked for. Kernels take `record` and call
    `state_views(record, n)`.

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

    __slots__ = ("n", "record")
    record: Array
    n: int

    def __init__(self, record: Array, n: int) -> None:
        """Wrap a complete record (record_size(n),), which becomes read-only; RobotModel.state makes them."""
        record.setflags(write=False)
        _put_record(self, record)
        _put_n(self, n)

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"RobotState is immutable: ask the model for a new state instead of setting {name!r}")

    def __delattr__(self, name: str) -> None:
        raise AttributeError(f"RobotState is immutable: {name!r} cannot be deleted")

    def __reduce__(self) -> tuple[Any, ...]:
        return RobotState, (self.record.copy(), self.n)

    def __repr__(self) -> str:
        return f"RobotState(n={self.n}, q={np.round(self.q, 4).tolist()}, mu={self.mu:.4g})"

    @property
    def _at(self) -> dict[str, slice]:
        return _layout(self.n)

    @property
    def q(self) -> Array:
        """Joint positions (n,) [rad]."""
        return self.record[self._at["q"]]

    @property
    def v(self) -> Array:
        """Joint velocities (n,) [rad/s]."""
        return self.record[self._at["v"]]

    @property
    def tip(self) -> Array:
        """Tool tip X (3,) [m]."""
        return self.record[self._at["tip"]]

    @property
    def wrist(self) -> Array:
        """Wrist centre N (3,) [m]."""
        return self.record[self._at["wrist"]]

    @property
    def tool_direction(self) -> Array:
        """u = (X - N)/L (3,), the unit vector along the shaft."""
        return self.record[self._at["u"]]

    @property
    def tool_span(self) -> float:
        """L = |X - N| [m], constant."""
        return float(self.record[self._at["scalars"].start + 1])

    @property
    def A(self) -> Array:
        """[J_tip; J_wrist] (6,n), of rank 5: tip and wrist are rigidly tied."""
        return self.record[self._at["A"]].reshape(6, self.n)

    @property
    def J_tip(self) -> Array:
        """Translational Jacobian of the tip (3,n), world axes [m/rad]."""
        return self.A[:3]

    @property
    def J_wrist(self) -> Array:
        """Translational Jacobian of the wrist (3,n), world axes [m/rad]."""
        return self.A[3:]

    @property
    def drift_tip(self) -> Array:
        """dJ_tip/dt v (3,) [m/s^2]."""
        return self.record[self._at["drift"]][:3]

    @property
    def drift_wrist(self) -> Array:
        """dJ_wrist/dt v (3,) [m/s^2]."""
        return self.record[self._at["drift"]][3:]

    @property
    def mu(self) -> float:
        """Manipulability sqrt(det(J_tip J_tip^T)) [m^3]."""
        return float(self.record[self._at["scalars"].start])

    @property
    def grad_mu(self) -> Array:
        """dmu/dq (n,) [m^3/rad]; zero at a singularity, where mu has a kink."""
        return self.record[self._at["grad_mu"]]

    @property
    def mu_shaft(self) -> float:
        """Manipulability of the shaft once the tip is held [m^2]; see `manipulability_kernels.shaft_manipulability`."""
        return float(self.record[self._at["scalars"].start + 2])

    @property
    def grad_mu_shaft(self) -> Array:
        """dmu_shaft/dq (n,) [m^2/rad]; zero at a singularity, where it has a kink."""
        return self.record[self._at["grad_mu_shaft"]]

    @property
    def M(self) -> Array:
        """Joint-space inertia (n,n), rotor inertia included [kg m^2]."""
        return self.record[self._at["M"]].reshape(self.n, self.n)

    @property
    def h(self) -> Array:
        """C v + g (n,) [Nm]."""
        return self.record[self._at["h"]]

    @property
    def energy_slope(self) -> Array:
        """dT/dq = C^T v (n,) [Nm], T the kinetic energy and C Christoffel's Coriolis matrix."""
        return self.record[self._at["energy_slope"]]

    @property
    def gravity(self) -> Array:
        """g (n,) [Nm]: what carries the arm's weight."""
        return self.record[self._at["gravity"]]


# Around our own __setattr__, which refuses everybody else: two are made every tick.
_put_record, _put_n = vars(RobotState)["record"].__set__, vars(RobotState)["n"].__set__

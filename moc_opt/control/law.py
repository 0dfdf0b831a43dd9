"""The constants of a control law, packed into one array for the compiled parts of a tick."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from moc_opt.control.gains import per_joint
from moc_opt.control.null_space import box_limits
from moc_opt.control.settings import PROJECTORS, ControlSettings
from moc_opt.model.robot_model import RobotModel
from moc_opt.numerics.arrays import Array
from moc_opt.numerics.cache import njit

DYNAMIC, STATIC, AS_PUBLISHED = range(len(PROJECTORS))
_NUMBERS, _ROWS = 14, 6


class Law(NamedTuple):
    """Named views of a packed law (14 + 6 n,); the order here is the layout."""

    K_X: float
    D_X: float
    K_N: float
    D_N: float
    rcm_lambda: float
    """constant lambda of the paper's |e_N1| = d / lambda; 0 takes |N_d - N| itself"""
    projector: float
    """DYNAMIC, STATIC or AS_PUBLISHED"""
    feedforward: float
    """1: add the accelerations of tip and desired wrist"""
    k0: float
    """velocity damper [1/s]"""
    weights: Array
    """(4,) c0, c1, c2, rho"""
    shaft_margin: float
    """below this mu_shaft [m^2] the climb leads away from poses that cannot hold the shaft; 0: nowhere"""
    spare_speed: float
    """by how much more than its v_max the box opens where mu_shaft goes to zero, a share of v_max"""
    limits: Array
    """(3, n) q_min, q_max [rad], v_max [rad/s] of the box"""
    K_N2: Array
    """(n,) [N m s/rad]"""
    D_N2: Array
    """(n,) [N m s/rad]"""
    tau_max: Array
    """(n,) [Nm]"""


@njit(cache=True, nogil=True)
def law_views(law: Array, n: int) -> Law:
    """Name the parts of a packed law; for use inside other kernels, and in Python through `.py_func`."""
    rows = law[_NUMBERS:].reshape((_ROWS, n))
    return Law(
        law[0], law[1], law[2], law[3], law[4], law[5], law[6], law[7],
        law[8:12], law[12], law[13], rows[:3], rows[3], rows[4], rows[5],
    )  # fmt: skip


def packed(
    n: int, *, gains: Sequence[float] = (0.0, 0.0, 0.0, 0.0), rcm_lambda: float = 0.0, projector: int = DYNAMIC,
    feedforward: bool = False, k0: float = 0.0, weights: Sequence[float] = (0.0, 0.0, 0.0, 0.0),
    shaft_margin: float = 0.0, spare_speed: float = 0.0, limits: ArrayLike = 0.0, K_N2: ArrayLike = 0.0,
    D_N2: ArrayLike = 0.0, tau_max: ArrayLike = np.inf,
) -> Array:  # fmt: skip
    """Pack the parts of a law for n joints, (14 + 6 n,).

    ``gains`` are K_X, D_X, K_N, D_N, the rest as in ``Law``.
    """
    rows = np.empty((_ROWS, n))
    rows[:3], rows[3], rows[4], rows[5] = limits, K_N2, D_N2, tau_max
    single = [shaft_margin, spare_speed]
    return np.concatenate([gains, [rcm_lambda, projector, feedforward, k0], weights, single, rows.ravel()])


def shaft_margin_m2(settings: ControlSettings, robot: RobotModel) -> float:
    """Return the margin of mu_shaft [m^2], proportional to the squared distance of wrist point and tip."""
    return float(settings.shaft_margin * robot.state(robot.data.q_home).tool_span ** 2)


def law_of(settings: ControlSettings, robot: RobotModel) -> Array:
    """Pack the law that the settings ask for on this arm.

    Raises:
        ControlError, UnknownNameError: a gain is missing, or the box leaves a joint no room.
    """
    gains = settings.resolve_gains(robot.data.gains, robot.n)
    gain, damping = gains.K_N2, gains.D_N2
    if settings.follows:  # x is the desired speed: its error is damped, not the speed itself
        gain, damping = gain + damping, np.zeros(robot.n)
    if settings.law == "dcac":
        damping = per_joint("[control] dcac_damping", settings.dcac_damping, robot.n)
    return packed(
        robot.n,
        gains=gains[:4],
        rcm_lambda=settings.rcm_lambda or 0.0,
        projector=PROJECTORS.index(settings.projector),
        feedforward=settings.feedforward,
        k0=settings.box_k0_per_s,
        weights=(settings.c0, settings.c1, settings.c2, settings.regularization),
        shaft_margin=shaft_margin_m2(settings, robot),
        spare_speed=1.0 / settings.box_speed_fraction - 1.0,
        limits=box_limits(
            robot.q_min, robot.q_max, robot.v_max,
            margin=settings.limit_margins(robot.chain.prismatic), speed_fraction=settings.box_speed_fraction,
        ),
        K_N2=gain,
        D_N2=damping,
        tau_max=robot.tau_max if settings.limit_torque else np.inf,
    )  # fmt: skip

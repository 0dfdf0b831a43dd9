"""The arms of the package: their makers' figures, and poses fit to begin with."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

from moc_opt.planning.self_motion import freedoms, self_motion
from moc_opt.robots import urdf
from moc_opt.robots.model import RobotModel, load_robot
from moc_opt.sim.mjcf import check_engines

Array = NDArray[np.float64]
NEW = ("gen3", "iiwa14", "lwr4_rail", "panda", "xarm7")
RIGHT = np.pi / 2

Rows = list[tuple[float, float, float, float]]


def upright(signs: tuple[float, ...], lengths: tuple[float, ...]) -> Rows:
    """Rows of an arm whose axes all cross: alpha is a right angle of this sign, or 0."""
    return [(0, sign * RIGHT, d, 0) for sign, d in zip(signs, lengths, strict=True)]


# Denavit-Hartenberg rows as the makers print them, (a, alpha, d, offset of q), then the way from the last frame to the
# flange. Craig's convention has a and alpha of the joint before, the classical one those behind the joint.
DH: dict[str, tuple[str, Rows, float]] = {
    "lwr4": ("classical", upright((1, -1, -1, 1, 1, -1, 0), (0.3105, 0, 0.4, 0, 0.39, 0, 0.078)), 0.0),
    "iiwa14": ("classical", upright((-1, 1, 1, -1, -1, 1, 0), (0.36, 0, 0.42, 0, 0.4, 0, 0.126)), 0.0),
    "panda": (
        "craig",
        [
            (0, 0, 0.333, 0), (0, -RIGHT, 0, 0), (0, RIGHT, 0.316, 0), (0.0825, RIGHT, 0, 0),
            (-0.0825, -RIGHT, 0.384, 0), (0, RIGHT, 0, 0), (0.088, RIGHT, 0, 0),
        ],
        0.107,
    ),
    "xarm7": (
        "craig",
        [
            (0, 0, 0.267, 0), (0, -RIGHT, 0, 0), (0, RIGHT, 0.293, 0), (0.0525, RIGHT, 0, 0),
            (0.0775, RIGHT, 0.3425, 0), (0, RIGHT, 0, 0), (0.076, -RIGHT, 0.097, 0),
        ],
        0.0,
    ),
    "gen3": (
        "classical",
        [
            (0, RIGHT, -(0.15643 + 0.12838), 0), (0, RIGHT, -(0.005375 + 0.006375), np.pi),
            (0, RIGHT, -2 * 0.21038, np.pi), (0, RIGHT, -2 * 0.006375, np.pi), (0, RIGHT, -(0.20843 + 0.10593), np.pi),
            (0, RIGHT, 0, np.pi), (0, np.pi, -(0.10593 + 0.061525), np.pi),
        ],
        0.0,
    ),
}  # fmt: skip


def by_dh(name: str, q: Array) -> Array:
    """Tip of a tool of 0.3 m from the printed table; the Gen3's first axis points down, from its base."""
    kind, rows, flange = DH[name]
    T = pin.SE3(np.diag([1.0, -1.0, -1.0] if name == "gen3" else np.ones(3)), np.zeros(3))
    for (a, alpha, d, offset), angle in zip(rows, q, strict=True):
        across = pin.SE3(pin.utils.rotate("x", alpha), np.array([a, 0.0, 0.0]))
        along = pin.SE3(pin.utils.rotate("z", angle + offset), np.array([0.0, 0.0, d]))
        T = T * across * along if kind == "craig" else T * along * across
    return T.act(np.array([0.0, 0.0, flange + 0.3]))


def poses(robot: RobotModel, count: int = 8) -> Array:
    return np.random.default_rng(5).uniform(robot.q_min, robot.q_max, (count, robot.n))


@pytest.mark.parametrize("name", DH)
def test_the_tip_is_where_the_makers_table_puts_it(name: str) -> None:
    robot = load_robot(name)
    miss = 5e-4 if name == "gen3" else 1e-9  # its printed table lets axes 6 and 7 cross: 0.175 mm twice
    for q in poses(robot):
        np.testing.assert_allclose(robot.state(q).tip, by_dh(name, q), rtol=0, atol=miss)


def test_the_iiwa14_weighs_what_its_data_sheet_says() -> None:
    """29.9 kg; the public link masses are rounded."""
    robot = load_robot("iiwa14")
    masses = [link.mass for link in urdf.read(robot.data.urdf).links]
    assert sum(masses) - robot.data.tool_mass == pytest.approx(29.9, rel=0.03)


def test_the_rail_carries_the_lwr4() -> None:
    rail, bare = load_robot("lwr4_rail"), load_robot("lwr4")
    for q in poses(rail):
        ours, theirs = rail.state(q), bare.state(q[1:])
        np.testing.assert_allclose(ours.tip, theirs.tip + np.array([0.0, q[0], 0.0]), rtol=0, atol=1e-9)
        np.testing.assert_allclose(ours.M[1:, 1:], theirs.M, rtol=0, atol=1e-9)
        assert ours.M[0, 0] == pytest.approx(20.0 + 10.0 + 15.85 + 0.3, abs=1e-9)  # drive, carriage, arm, tool


# --- what every arm of the package has ---


@pytest.mark.parametrize("name", NEW)
def test_both_engines_read_the_same_arm_and_its_home_pose_is_fit_to_begin_with(name: str) -> None:
    arm = load_robot(name)
    check_engines(arm)
    q, data = arm.data.q_home, arm.data
    left = freedoms(arm, q)
    assert left.rank == 5
    assert (left.real, left.idle) == ((2, (7,)) if data.name == "lwr4_rail" else (1, (6,)))
    assert left.tip > 0.3
    assert left.both > 0.1
    turning = ~arm.chain.prismatic
    assert np.degrees(np.minimum(q - data.q_min, data.q_max - q)[turning].min()) > 35.0
    state = arm.state(q)
    assert state.tool_direction[2] < -0.8  # the tool points down
    assert state.tip[2] > 0.05
    assert 0.7 < state.mu / self_motion(arm, q).mu_best < 0.9  # there is something to gain

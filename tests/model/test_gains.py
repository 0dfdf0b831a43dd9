"""Gains derived from an arm's inertia: the rates of the LWR4+, in each joint's own unit, and the stability limit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from moc_opt.control.settings import ControlSettings
from moc_opt.model.gains import (
    CARTESIAN_RATE,
    JOINT_RATE,
    derived_gains,
    largest_inverse_masses,
    largest_rate,
)
from moc_opt.model.robot_model import RobotModel, load_robot
from moc_opt.robots import loader

FOLDER = Path(loader.__file__).parent


def without_gains(name: str, folder: Path) -> Path:
    text = (FOLDER / f"{name}.toml").read_text(encoding="utf-8")
    (folder / f"{name}.urdf").write_bytes((FOLDER / f"{name}.urdf").read_bytes())
    path = folder / f"{name}.toml"
    path.write_text(text[: text.index("[gains.")], encoding="utf-8")
    return path


@pytest.mark.parametrize("name", ["lwr4", "lwr4_rail"])
def test_a_robot_file_without_gains_gets_them(name: str, tmp_path: Path) -> None:
    robot = load_robot(without_gains(name, tmp_path))
    for preset in ("paper", "tuned", "robust"):
        for law in ("dcac", "moc"):
            ControlSettings.preset(preset, law=law).resolve_gains(robot.data.gains, robot.n)
    found = ControlSettings().resolve_gains(robot.data.gains, robot.n)
    inertia = np.diag(robot.state(robot.data.q_home).M)
    np.testing.assert_allclose(found.K_N2, JOINT_RATE * inertia, rtol=0.005)


def test_a_table_that_is_given_is_kept(robot: RobotModel, tmp_path: Path) -> None:
    path = without_gains("lwr4", tmp_path)
    path.write_text(path.read_text(encoding="utf-8") + "\n[gains.moc]\nK_X = 1.0\n", encoding="utf-8")
    gains = load_robot(path).data.gains
    assert dict(gains["moc"]) == {"K_X": 1.0}
    assert set(gains) == set(robot.data.gains) == {"dcac", "moc", "default", "tuned", "robust"}


def self_motion_rate(robot: RobotModel, table: str) -> float:
    """K_N2 over the inertia of the self-motion, median over random poses [1/s]; idle joints left out."""
    moving, rates = robot.moves.any(axis=0), []
    gain = np.diag(np.broadcast_to(np.asarray(robot.data.gains[table]["K_N2"]), robot.n)[moving])
    for q in np.random.default_rng(5).uniform(robot.q_min, robot.q_max, (400, robot.n)):
        state = robot.state(q)
        z = np.linalg.svd(state.A[:, moving])[2][-1]
        rates.append(z @ gain @ z / (z @ state.M[np.ix_(moving, moving)] @ z))
    return float(np.median(rates))


def test_the_lwr4_gets_what_it_was_tuned_to(robot: RobotModel) -> None:
    for table in ("default", "tuned", "robust"):
        for gain in ("K_X", "D_X", "K_N", "D_N"):
            assert derived_gains(robot)[table][gain] == robot.data.gains[table][gain]
    derived, tuned = derived_gains(robot)["default"], robot.data.gains["default"]
    ratio = np.divide(derived["K_N2"], tuned["K_N2"])
    assert ratio.min() > 0.5
    assert ratio.max() < 1.3


@pytest.mark.parametrize("table", ["tuned", "robust"])
def test_presets_stand_to_the_default_as_on_the_lwr4(robot: RobotModel, table: str) -> None:
    wanted = self_motion_rate(robot, table) / self_motion_rate(robot, "default")
    for name in ("panda", "gen3", "xarm7"):  # the others meet the largest rate allowed
        other = load_robot(name)
        assert self_motion_rate(other, table) / self_motion_rate(other, "default") == pytest.approx(wanted, rel=0.1)


@pytest.mark.parametrize("name", ["iiwa14", "panda", "gen3", "xarm7", "lwr4_rail"])
def test_the_tables_of_a_file_are_those_of_its_masses(name: str) -> None:
    robot = load_robot(name)
    derived = derived_gains(robot)
    assert set(robot.data.gains) == set(derived)
    for key, table in derived.items():
        for gain, value in table.items():
            if (name, key) == ("gen3", "default") and gain in ("K_X", "D_X", "K_N", "D_N"):
                # Three ticks of delay are borne with softer ones alone (tests/scenario/test_arms_runs.py).
                assert robot.data.gains[key][gain] < value
                continue
            np.testing.assert_array_equal(robot.data.gains[key][gain], value, err_msg=f"{key}, {gain}")


def test_a_light_arm_gets_smaller_gains_at_the_tip(tmp_path: Path) -> None:
    """A tenth of every rotor: what the tip feels shrinks, and D_X with it."""
    path = without_gains("gen3", tmp_path)
    text = path.read_text(encoding="utf-8")
    line = next(line for line in text.splitlines() if line.startswith("rotor_inertia"))
    path.write_text(text.replace(line, "rotor_inertia_kg_m2 = 0.02"), encoding="utf-8")
    light = load_robot(path)
    tip, wrist = largest_inverse_masses(light)
    gains = light.data.gains["default"]
    assert gains["D_X"] < 60.0
    assert gains["D_X"] * tip == pytest.approx(CARTESIAN_RATE, rel=0.01)
    assert gains["K_X"] / gains["D_X"] == pytest.approx(3000.0 / 80.0, rel=0.01)
    assert gains["D_N"] * wrist <= 1.01 * CARTESIAN_RATE


@given(delay=st.integers(0, 6), side=st.sampled_from([0.98, 1.02]))
def test_the_largest_rate_is_where_a_delayed_loop_stops_decaying(delay: int, side: float) -> None:
    """The roots of z^(d+1) - z^d + T rate: inside the circle just below it, outside just above."""
    period = 0.002
    gain = side * largest_rate(period, delay) * period
    roots = np.roots([1.0, -1.0, *[0.0] * (delay - 1), gain] if delay else [1.0, gain - 1.0])
    assert (np.abs(roots).max() < 1.0) == (side < 1.0)

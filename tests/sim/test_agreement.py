"""An arm that pinocchio and MuJoCo read differently is refused."""

import re
from dataclasses import replace
from types import SimpleNamespace

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given, settings

from moc_opt.errors import RobotError
from moc_opt.robots.model import RobotModel, load_robot
from moc_opt.sim.mjcf import TOLERANCE, check_engines
from tests.robots.arms import FOLDER, text_of

URDF, TOML = text_of("lwr4"), (FOLDER / "lwr4.toml").read_text(encoding="utf-8")


def edited(text, link, attribute, value):
    place = text.index(f'<link name="{link}">')
    return text[:place] + re.sub(rf'{attribute}="[^"]*"', f'{attribute}="{value}"', text[place:], count=1)


# With these values, pinocchio drops the link's inertia, and MuJoCo keeps it.
@pytest.mark.parametrize(("attribute", "value"), [("rpy", ""), ("rpy", "0x0 0 0"), ("xyz", ""), ("xyz", "0 0 0x1p-3")])
def test_inertia_that_one_engine_drops_is_refused(robot, attribute, value):
    other = RobotModel(replace(robot.data, urdf=edited(robot.data.urdf, "link_3", attribute, value)))
    with pytest.raises(RobotError, match=r"robot 'lwr4': pinocchio and MuJoCo differ in M by .*1e-06 is allowed"):
        check_engines(other)


@pytest.mark.parametrize("change", ["M", "h", "tip", "wrist"])
def test_engines_must_agree_on_dynamics_and_kinematics(robot, change):

    def shifted(scale):
        def state(q, v):
            true = robot.state(q, v)
            terms = {name: getattr(true, name) for name in ("M", "h", "tip", "wrist")}
            return SimpleNamespace(**{**terms, change: terms[change] * (1.0 + scale * TOLERANCE)})

        return SimpleNamespace(data=robot.data, state=state)

    check_engines(shifted(0.1))
    check_engines(load_robot("lwr4", tool_length=0.42, tool_mass=0.7))
    with pytest.raises(RobotError, match=rf"differ in {change} by") as said:
        check_engines(shifted(30.0))
    home = robot.state(robot.data.q_home)
    heavy, reach = np.abs(home.M - np.diag(robot.data.rotor_inertia)).max(), np.linalg.norm(home.tip)
    size = {"M": heavy, "h": np.abs(home.h).max() + 9.81 * heavy, "tip": reach, "wrist": reach}[change]
    share = float(re.search(r"([\d.e-]+) of its size", str(said.value))[1])
    assert share == pytest.approx(30.0 * TOLERANCE * np.abs(getattr(home, change)).max() / size, rel=0.05)


@given(
    a=st.floats(1e-4, 0.1), b=st.floats(1e-4, 0.1), beyond=st.sampled_from([0.0, 1e-15, 1e-12, 1e-9, 5e-7]),
    seed=st.integers(0, 2**32 - 1),
)  # fmt: skip
@settings(max_examples=40)
def test_both_engines_accept_a_flat_body_in_any_axes(a, b, beyond, seed, tmp_path_factory):
    """A plate's rounded moments may violate MuJoCo's triangle inequality."""
    Q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    I = Q @ np.diag([a, b, (a + b) * (1.0 + beyond)]) @ Q.T  # noqa: E741
    moments = {"ixx": I[0, 0], "iyy": I[1, 1], "izz": I[2, 2], "ixy": I[0, 1], "ixz": I[0, 2], "iyz": I[1, 2]}
    urdf = URDF
    for key, value in moments.items():
        urdf = edited(urdf, "link_4", key, repr(float(value)))
    folder = tmp_path_factory.mktemp("flat")
    (folder / "lwr4.urdf").write_text(urdf, encoding="utf-8")
    (folder / "arm.toml").write_text(TOML, encoding="utf-8")
    arm = load_robot(folder / "arm.toml")
    check_engines(arm)
    written = [float(re.findall(rf'{key}="([^"]*)"', arm.data.urdf)[4]) for key in moments]
    np.testing.assert_allclose(written, list(moments.values()), rtol=0, atol=2e-6 * (a + b))

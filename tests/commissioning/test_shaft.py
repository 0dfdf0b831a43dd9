"""Tool and wrist point: found on every arm of the package as its makers and we chose them."""

from __future__ import annotations

import numpy as np
import pytest

from moc_opt.commissioning.shaft import find_shaft
from moc_opt.errors import RobotError
from tests.commissioning.arms import added, changed, joint, link, text_of

# last link, wrist point, direction: those of the robot files of the package
KNOWN = {
    "lwr4": (7, [0, 0, -0.078], [0, 0, 1]), "iiwa14": (7, [0, 0, -0.081], [0, 0, 1]),
    "panda": (7, [0, 0, 0], [0, 0, 1]), "gen3": (7, [0, 0, 0.10593], [0, 0, -1]),
    "xarm7": (7, [0, 0, -0.097], [0, 0, 1]), "lwr4_rail": (8, [0, 0, -0.078], [0, 0, 1]),
}  # fmt: skip


def direction(rpy: tuple[float, float, float]) -> np.ndarray:
    (sr, sp, sy), (cr, cp, cy) = np.sin(rpy), np.cos(rpy)
    return np.array([cy * sp * cr + sy * sr, sy * sp * cr - cy * sr, cp * cr])


@pytest.mark.parametrize("name", KNOWN)
def test_the_wrist_of_a_known_arm_is_found(name: str) -> None:
    last, wrist, towards = KNOWN[name]
    found = find_shaft(text_of(name), f"link_{last}")
    np.testing.assert_allclose(found.wrist, wrist, rtol=0, atol=1e-12)
    np.testing.assert_allclose(direction(found.rpy), towards, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.mount, 0.0, rtol=0, atol=1e-12)


def test_a_flange_frame_carries_the_same_tool() -> None:
    flange = link("flange") + joint(
        "f", "fixed", "link_7", "flange", '<origin xyz="0 0 0.107" rpy="0.3 1.1 -2"/>'
    )
    found = find_shaft(added(text_of(), flange), "flange")
    assert found.behind_m == pytest.approx(0.107, abs=1e-12)
    np.testing.assert_allclose(found.wrist, -0.107 * direction(found.rpy), rtol=0, atol=1e-12)


def test_a_flange_off_the_axis_wakes_the_last_joint() -> None:
    flange = link("flange") + joint("f", "fixed", "link_7", "flange", '<origin xyz="0.05 0 0.107"/>')
    found = find_shaft(added(text_of(), flange), "flange")
    assert "off the last axis" in found.note
    np.testing.assert_allclose(direction(found.rpy), [0, 0, 1], rtol=0, atol=1e-12)


def test_a_sliding_last_joint_points_along_its_link() -> None:
    text = text_of()
    place = text.index('<joint name="joint_7"')
    text = text[:place] + changed(text[place:], ('type="revolute"', 'type="prismatic"'))
    found = find_shaft(text, "link_7")
    assert "slides" in found.note
    np.testing.assert_allclose(found.wrist, 0.0)


def test_the_wrist_can_be_given() -> None:
    np.testing.assert_allclose(find_shaft(text_of(), "link_7", wrist_m=0.05).wrist, [0, 0, -0.05])
    with pytest.raises(RobotError, match=r"--wrist -1"):
        find_shaft(text_of(), "link_7", wrist_m=-1.0)

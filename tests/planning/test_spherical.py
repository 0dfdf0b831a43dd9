"""The normal form is found from the axes, whatever the arm's name and frames, and not where an arm has none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from moc_opt.model.robot_model import RobotModel, load_robot
from moc_opt.planning.spherical import spherical
from tests.planning.arms import IIWA14, PANDA, H, build


def test_lwr4_is_spherical_with_its_published_lengths(robot: RobotModel) -> None:
    arm = spherical(robot)
    assert arm is not None
    np.testing.assert_allclose(arm.shoulder, [0.0, 0.0, 0.3105], atol=1e-12)
    np.testing.assert_allclose([abs(arm.upper), abs(arm.fore), abs(arm.tool)], [0.40, 0.39, 0.378], atol=1e-12)


def test_iiwa14_is_spherical_in_frames_of_another_convention() -> None:
    arm = spherical(load_robot("iiwa14"))
    assert arm is not None
    np.testing.assert_allclose(arm.shoulder, [0.0, 0.0, 0.360], atol=1e-12)
    np.testing.assert_allclose([abs(arm.upper), abs(arm.fore), abs(arm.tool)], [0.42, 0.40, 0.426], atol=1e-12)


@pytest.mark.parametrize(
    "changes",
    [
        {"mount": (0.0, 0.0, -0.081), "rpy": (0.3, 0.0, 0.0)},  # a tool at an angle to axis 7
        {"wrist": (0.01, 0.0, -0.081), "mount": (0.01, 0.0, 0.045)},  # beside it
        {"wrist": (0.0, 0.0, -0.07)},  # not where axes 5 to 7 meet
        {"q_max": np.radians([170, 120, 170, 120, 200, 120, 175])},  # one angle, two positions
        {"joints": [*IIWA14["joints"][:3], ((0.02, 0.0, 0.2155), (H, 0, 0)), *IIWA14["joints"][4:]]},  # elbow offset
        {"joints": [*IIWA14["joints"][:5], ((0.0, 0.0, 0.2155), (H - 0.1, 0, 0)), IIWA14["joints"][6]]},  # oblique
    ],
)
def test_an_arm_without_normal_form_is_told(tmp_path: Path, changes: dict[str, object]) -> None:
    assert spherical(build(tmp_path, IIWA14, **changes)) is None


def test_the_name_of_an_arm_does_not_count(tmp_path: Path) -> None:
    arm, shipped = spherical(build(tmp_path, IIWA14)), spherical(load_robot("iiwa14"))
    assert arm is not None
    assert shipped is not None
    for mine, theirs in zip(arm, shipped, strict=True):
        np.testing.assert_allclose(mine, theirs, atol=1e-12)


def test_panda_is_not_spherical(tmp_path: Path) -> None:
    assert spherical(build(tmp_path, PANDA)) is None

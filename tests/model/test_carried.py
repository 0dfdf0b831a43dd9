"""A robot in a trace: the same arm to the bit, wherever it is opened; what is no robot is refused by field."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from moc_opt.errors import RobotError
from moc_opt.model.carried import carried, restored
from moc_opt.model.robot_model import RobotModel, load_robot
from moc_opt.report.runs import robot_of
from moc_opt.robots import available_robots, loader
from moc_opt.scenario import Scenario, run
from moc_opt.trace.trace import Trace

FOLDER = Path(loader.__file__).parent


@pytest.mark.parametrize("name", available_robots())
def test_a_carried_robot_is_the_same_arm(name: str) -> None:
    robot = load_robot(name, tool_length=0.25)
    again = restored(json.loads(json.dumps(carried(robot))))
    q, v = robot.data.q_home, np.linspace(-1.0, 1.0, robot.n)
    ours, theirs = robot.state(q, v), again.state(q, v)
    for field in ("M", "h", "tip", "wrist", "mu"):
        np.testing.assert_array_equal(getattr(ours, field), getattr(theirs, field))
    assert again.data.gains["default"]["K_X"] == robot.data.gains["default"]["K_X"]
    assert again.data.tool_length == 0.25


def test_a_trace_replays_when_the_robots_files_are_gone(tmp_path: Path) -> None:
    folder = tmp_path / "arm"
    folder.mkdir()
    for kind in ("toml", "urdf"):
        shutil.copy(FOLDER / f"xarm7.{kind}", folder)
    run(Scenario(robot={"name": str(folder / "xarm7.toml")}, duration_s=0.05), to=tmp_path / "run.parquet")
    shutil.rmtree(folder)
    trace = Trace.load(tmp_path / "run.parquet")
    tips, _ = robot_of(trace).tool_along(trace.q_rad)
    np.testing.assert_allclose(tips, load_robot("xarm7").tool_along(trace.q_rad)[0], rtol=0, atol=1e-15)


def test_an_arm_of_the_package_is_named_alone() -> None:
    assert "robot_data" not in run(Scenario(duration_s=0.02)).meta


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"q_min": [0.0]}, "q_min has shape"),
        ({"q_min": "x"}, "the robot in the trace"),
        ({"joint_names": []}, "joint_names"),
        ({"more": 1}, r"other fields .*'more'"),
        ({"urdf": "<!DOCTYPE x><robot/>"}, "document type"),
        ({"gains": 3}, "the robot in the trace"),
        ({"tip_frame": "gone"}, "no link of the urdf"),
    ],
)
def test_what_is_no_robot_is_refused(robot: RobotModel, change: dict[str, Any], told: str) -> None:
    with pytest.raises(RobotError, match=told):
        restored({**carried(robot), **change})
    with pytest.raises(RobotError, match="list"):
        restored([])  # type: ignore[arg-type]

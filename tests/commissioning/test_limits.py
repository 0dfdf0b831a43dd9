"""Limits: endless, missing and absurd ones are replaced and told; good ones stay to the bit."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from moc_opt.commissioning.limits import CHOSEN, TRAVEL_M, choose_efforts, choose_limits
from moc_opt.commissioning.vendor import VendorArm, chain_joints, read_vendor
from moc_opt.errors import RobotError
from moc_opt.model.robot_model import load_robot
from moc_opt.robots import urdf
from tests.commissioning.arms import changed, text_of

PANDA_1 = '<limit lower="-2.8973" upper="2.8973" velocity="2.175" effort="87"/>'


def chosen(folder: Path, text: str) -> tuple[VendorArm, list[str], dict[str, float]]:
    path = folder / "arm.urdf"
    path.write_text(text, encoding="utf-8")
    arm = read_vendor(path)
    arm.notes.clear()
    weak = choose_limits(arm)
    return arm, weak, urdf.limits(chain_joints(arm)[0])


def test_good_limits_stay(tmp_path: Path) -> None:
    arm, weak, first = chosen(tmp_path, text_of())
    assert first == {"lower": -2.8973, "upper": 2.8973, "velocity": 2.175, "effort": 87.0}
    assert (arm.notes, weak) == ([], [])


@pytest.mark.parametrize(
    ("limit", "expected", "told"),
    [
        ('lower="-2.8973" upper="2.8973" velocity="10"', {"velocity": CHOSEN["turning"]}, "10 rad/s is no speed"),
        ('lower="-2.8973" upper="2.8973"', {"velocity": CHOSEN["turning"]}, "no speed limit"),
        ('lower="-6.2832" upper="6.2832" velocity="2"', {"lower": -np.pi, "upper": np.pi}, "cut to one turn"),
        ('velocity="2"', {"lower": -np.pi, "upper": np.pi}, "has no range"),
    ],
)  # fmt: skip
def test_what_no_arm_has_is_replaced(
    limit: str, expected: dict[str, float], told: str, tmp_path: Path
) -> None:
    arm, _, first = chosen(tmp_path, changed(text_of(), (PANDA_1, f'<limit {limit} effort="87"/>')))
    assert {key: first[key] for key in expected} == pytest.approx(expected)
    assert len(arm.notes) == 1
    assert "joint_1" in arm.notes[0]
    assert told in arm.notes[0]


@pytest.mark.parametrize(("name", "old", "new", "unit"), [
    ("panda", 'lower="-2.8973" upper="2.8973"', 'lower="2.8973" upper="-2.8973"', "rad"),
    ("lwr4_rail", 'lower="-0.5" upper="0.5"', 'lower="0.5" upper="-0.5"', "m"),
])  # fmt: skip
def test_exchanged_limits_are_refused_by_name(name: str, old: str, new: str, unit: str, tmp_path: Path) -> None:
    with pytest.raises(RobotError, match=rf"'joint_1': lower = .* above upper = .* exchanged.* in {unit}, "):
        chosen(tmp_path, changed(text_of(name), (old, new)))
    endless = 'name="joint_1" type="continuous"'  # its limits mean nothing
    text = changed(text_of("panda"), ('lower="-2.8973" upper="2.8973"', 'lower="2" upper="-2"'))
    chosen(tmp_path, changed(text, ('name="joint_1" type="revolute"', endless)))


def test_an_endless_joint_gets_a_turn(tmp_path: Path) -> None:
    text = changed(text_of(), ('name="joint_1" type="revolute"', 'name="joint_1" type="continuous"'))
    arm, _, first = chosen(tmp_path, text)
    assert (first["lower"], first["upper"]) == (-np.pi, np.pi)
    assert "joint_1 turns without end: +-180 deg is taken" in arm.notes
    assert chain_joints(arm)[0].get("type") == "revolute"


@pytest.mark.parametrize("size", ["inf", "Infinity", "1e16", "1e99999"])
def test_endless_numbers_are_none_and_are_told(size: str, tmp_path: Path) -> None:
    limit = f'<limit lower="-{size}" upper="1.5" velocity="{size}" effort="{size}"/>'
    path = tmp_path / "arm.urdf"
    path.write_text(changed(text_of("panda"), (PANDA_1, limit)), encoding="utf-8")
    arm = read_vendor(path)
    assert any(f"joint_1: lower = -{size}, velocity = {size}, effort = {size} is no limit" in n for n in arm.notes)
    _, weak, first = chosen(tmp_path, path.read_text(encoding="utf-8"))
    assert (first["lower"], first["upper"], first["velocity"]) == (-np.pi, np.pi, CHOSEN["turning"])
    assert weak == ["joint_1"]


@pytest.mark.parametrize("bad", ["nan", "0x2", "1_0", "two", "１e9"])
def test_what_is_no_number_is_refused_by_name(bad: str, tmp_path: Path) -> None:
    with pytest.raises(RobotError, match="joint 'joint_1', lower is"):
        chosen(tmp_path, changed(text_of("panda"), ('lower="-2.8973"', f'lower="{bad}"')))


def test_degrees_in_the_place_of_radians_are_asked_about(tmp_path: Path) -> None:
    limit = '<limit lower="-166" upper="166" velocity="120" effort="87"/>'
    arm, _, first = chosen(tmp_path, changed(text_of("panda"), (PANDA_1, limit)))
    assert (first["lower"], first["upper"]) == (-np.pi, np.pi)
    assert any("joint_1: -166 to 166 rad" in note and "degrees?" in note for note in arm.notes)


def test_a_rail_has_metres(tmp_path: Path) -> None:
    text = changed(
        text_of("lwr4_rail"), ('<limit lower="-0.5" upper="0.5" velocity="0.5" effort="500"/>', "")
    )
    arm, weak, first = chosen(tmp_path, text)
    assert (first["lower"], first["upper"], first["velocity"]) == (-TRAVEL_M, TRAVEL_M, CHOSEN["sliding"])
    assert weak == ["joint_1"]
    assert any("m/s" in note for note in arm.notes)


def test_missing_efforts_carry_the_arm(tmp_path: Path) -> None:
    text = re.sub(r'effort="\d+"', 'effort="0"', text_of())
    _, weak, _ = chosen(tmp_path, text)
    assert weak == [f"joint_{j}" for j in range(1, 8)]
    robot = load_robot("panda")
    efforts = choose_efforts(robot, weak)
    for q in np.random.default_rng(3).uniform(robot.q_min, robot.q_max, (50, 7)):
        assert np.all(np.abs(robot.gravity(q)) < 0.5 * np.array(list(efforts.values())))
    assert max(efforts.values()) < 500.0

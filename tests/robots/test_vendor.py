"""Vendors' URDFs: side joints locked, frames merged, one chain found or asked for, numbers that no arm has replaced."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from moc_opt.errors import RobotError, UnknownNameError
from moc_opt.robots.model import load_robot
from moc_opt.robots.urdf import Link, inertia_fault, parse, read
from moc_opt.robots.vendor import (
    CHOSEN,
    TRAVEL_M,
    VendorArm,
    choose_efforts,
    choose_limits,
    mend_bodies,
    read_vendor,
)
from tests.robots.arms import added, changed, joint, link, text_of, with_hand

CHAIN = [f"joint_{j}" for j in range(1, 8)]
TURN = '<axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="1" effort="9"/>'


@pytest.fixture
def vendors(tmp_path: Path):
    def vendors(text: str, **options: object) -> VendorArm:
        path = tmp_path / "arm.urdf"
        path.write_text(text, encoding="utf-8")
        return read_vendor(path, **options)  # type: ignore[arg-type]

    return vendors


def branch(name: str, count: int, at: str) -> str:
    below = [at, *[f"{name}{j}" for j in range(count - 1)]]
    return "".join(
        link(f"{name}{j}", 1.0) + joint(f"t_{name}{j}", "revolute", under, f"{name}{j}", TURN)
        for j, under in enumerate(below)
    )


def last_frame(model: pin.Model, q: np.ndarray, j: int) -> np.ndarray:
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    return data.oMi[j].homogeneous


def chain(arm: VendorArm) -> list[str]:
    return [joint.name for joint in arm.chain]


def model_of(arm: VendorArm) -> pin.Model:
    return pin.buildModelFromXML(arm.urdf.to_text("arm"))


def test_fingers_are_locked_and_the_arm_moves_as_before(vendors) -> None:
    arm = vendors(with_hand(text_of()))
    assert (arm.last_link, chain(arm)) == ("hand", CHAIN)
    model, bare = model_of(arm), pin.buildModelFromXML(text_of())
    assert list(model.names)[1:] == CHAIN
    assert model.inertias[7].mass - bare.inertias[7].mass == pytest.approx(0.7 + 2 * 0.015)  # locked still weighs
    left = model.frames[model.getFrameId("left")].placement.translation
    turn = np.array([0.01 * np.sin(0.785), 0.01 * np.cos(0.785), 0.107])  # at the end of its range next to 0
    np.testing.assert_allclose(left, turn, rtol=0, atol=1e-12)
    told = " ".join(arm.notes)
    assert all(word in told for word in ("link8", "finger_1 at 0.01 m", "finger_2", "2 fingers branch off"))
    for q in np.random.default_rng(0).uniform(-1.0, 1.0, (5, 7)):
        np.testing.assert_allclose(last_frame(model, q, 7), last_frame(bare, q, 7), rtol=0, atol=1e-12)


def test_a_second_arm_needs_a_tip(vendors) -> None:
    text = added(text_of(), branch("b", 4, "link_0"))
    with pytest.raises(RobotError, match=r"2 chains leave link 'link_0', towards .*'b0'.*--tip"):
        vendors(text)
    arm = vendors(text, tip="link_7")
    assert chain(arm) == CHAIN
    assert [one.name for one in arm.urdf.links] == [f"link_{j}" for j in range(8)]
    assert "4 links that hang on the base" in " ".join(arm.notes)
    assert chain(vendors(text, tip="b3")) == [f"t_b{j}" for j in range(4)]
    with pytest.raises(UnknownNameError):
        vendors(text, tip="b9")


def test_of_several_arms_the_links_that_can_carry_the_tool_are_named(vendors) -> None:
    """Two arms on a trunk, one with a hand of long fingers; a head and legs of few joints are no arms."""
    more = branch("other", 6, "link_0") + branch("head", 2, "link_0")
    more += link("palm", 0.3) + joint("wrist_joint", "fixed", "other5", "palm") + branch("thumb", 3, "palm")
    with pytest.raises(RobotError, match=r"such as \['link_7', 'palm'\]$"):
        vendors(added(text_of(), more + branch("index", 4, "palm")))


def test_a_joint_locked_by_name_stands_where_it_was_told(vendors) -> None:
    arm = vendors(text_of(), lock={"joint_3": 0.4})
    assert chain(arm) == [name for name in CHAIN if name != "joint_3"]
    q = np.array([0.1, -0.3, -1.2, 0.5, 1.4, 0.2])
    whole = last_frame(pin.buildModelFromXML(text_of()), np.insert(q, 2, 0.4), 7)
    np.testing.assert_allclose(last_frame(model_of(arm), q, 6), whole, rtol=0, atol=1e-12)
    with pytest.raises(UnknownNameError):
        vendors(text_of(), lock={"joint_9": 0.0})


def test_a_mimic_joint_in_the_chain_has_to_be_locked(vendors) -> None:
    text = changed(text_of(), ('<child link="link_5"/>', '<child link="link_5"/><mimic joint="joint_4"/>'))
    with pytest.raises(RobotError, match=r"'joint_5' .* mimics"):
        vendors(text)
    assert len(vendors(text, lock={"joint_5": 0.0}).chain) == 6


@pytest.mark.parametrize("kind", ["floating", "planar"])
def test_a_joint_that_no_drive_moves_so_is_refused_inside_the_arm_alone(kind: str, vendors) -> None:
    with pytest.raises(RobotError, match=rf"'joint_4' .* is {kind}"):
        vendors(changed(text_of(), ('name="joint_4" type="revolute"', f'name="joint_4" type="{kind}"')))
    arm = vendors(added(text_of(), link("ship") + joint("sea", kind, "ship", "link_0")))
    assert chain(arm) == CHAIN
    assert any(f"sea ({kind})" in note for note in arm.notes)


def test_names_that_the_tool_needs_are_moved_out_of_the_way(vendors) -> None:
    arm = vendors(added(text_of(), link("world") + joint("tip_frame", "fixed", "world", "link_0")))
    names = {part.name for part in (*arm.urdf.links, *arm.urdf.joints)}
    assert {"world_link", "tip_frame_joint"} <= names
    assert chain(arm) == CHAIN


def test_the_flange_is_known_by_its_name_and_a_jaw_at_the_end_is_no_joint_of_the_arm(vendors) -> None:
    more = "".join(link(name) + joint(f"j_{name}", "fixed", "link_7", name) for name in ("camera", "tool0"))
    assert vendors(added(text_of(), more)).last_link == "tool0"
    jaw = added(text_of(), link("mover", 0.2) + joint("jointGripper", "revolute", "link_7", "mover", TURN))
    arm = vendors(jaw)
    assert (chain(arm), arm.last_link) == (CHAIN, "link_7")
    assert any("'jointGripper'" in note for note in arm.notes)
    assert chain(vendors(jaw, tip="mover")) == [*CHAIN, "jointGripper"]


def test_xacro_is_told_from_a_urdf(vendors) -> None:
    macro = '<robot xmlns:xacro="http://x/xacro"><xacro:macro name="a"/></robot>'
    for text in (macro, text_of().replace("0 0 0.333", "0 0 ${d}")):
        with pytest.raises(RobotError, match="xacro"):
            vendors(text)


@pytest.mark.parametrize("declared", [True, False])
def test_names_of_other_tools_need_no_declaration(declared: bool, vendors) -> None:
    """Some vendors' files use a prefix that they never declare, which no XML reader takes."""
    text = changed(text_of(), ('lower="-2.8973"', 'drake:acceleration="2" lower="-2.8973"'))
    text = added(text, '<drake:proximity_properties a="b:c"/>')
    if declared:
        text = changed(text, ("<robot ", '<robot xmlns:drake="http://drake.mit.edu" '))
    arm = vendors(text)
    assert chain(arm) == CHAIN
    assert any("drake:" in note for note in arm.notes) is not declared


# --- bodies ---


def mended(*links: Link) -> list[str]:
    notes: list[str] = []
    mend_bodies(links, notes)
    return notes


def test_without_mass_it_is_a_frame_and_without_inertia_a_ball() -> None:
    ours, again = (read(parse(text_of())).links for _ in range(2))
    assert mended(*ours) == []
    assert ours == again  # possible bodies stay
    frame, ball, weightless = Link("f", 0.0, (0.1,) * 6), Link("b", 1.0), Link("n", None, (0.0,) * 6)
    notes = mended(frame, ball, weightless)
    assert frame.is_frame
    assert weightless.is_frame
    moment = 0.4 * (3.0 / (4.0 * np.pi * 1000.0)) ** (2.0 / 3.0)
    assert ball.moments == pytest.approx([moment] * 3 + [0.0] * 3)
    assert len(notes) == 2
    assert "f, n" in notes[1]


@given(st.tuples(*[st.floats(-0.1, 0.1)] * 6).filter(lambda given: max(map(abs, given)) > 1e-9))
def test_any_inertia_becomes_one_that_a_body_may_have(given: tuple[float, ...]) -> None:
    body = Link("a", 1.0, given)
    assert (mended(body) == []) == (inertia_fault(given) is None)
    assert inertia_fault(body.moments) is None


# --- limits ---

PANDA_1 = '<limit lower="-2.8973" upper="2.8973" velocity="2.175" effort="87"/>'
ONE_TURN = {"lower": -np.pi, "upper": np.pi}


def limited(vendors, text: str) -> tuple[list[str], list[str], dict[str, float]]:
    arm = vendors(text)
    weak = choose_limits(arm.chain, arm.notes)
    return [note for note in arm.notes if "last link" not in note], weak, arm.chain[0].limits


@pytest.mark.parametrize(("limit", "expected", "told"), [
    ('lower="-2.8973" upper="2.8973" velocity="2.175"', {"lower": -2.8973, "upper": 2.8973, "velocity": 2.175}, ""),
    ('lower="-2.8973" upper="2.8973" velocity="10"', {"velocity": CHOSEN["turning"]}, "10 rad/s is no speed"),
    ('lower="-2.8973" upper="2.8973"', {"velocity": CHOSEN["turning"]}, "no speed limit"),
    ('lower="-6.2832" upper="6.2832" velocity="2"', ONE_TURN, "cut to one turn"),
    ('lower="1" upper="9" velocity="2"', {"lower": 5.0 - np.pi, "upper": 5.0 + np.pi}, "cut to one turn"),
    ('velocity="2"', ONE_TURN, "has no range"),
    ('lower="-166" upper="166" velocity="2"', ONE_TURN, "-166 to 166 rad"),  # degrees
])  # fmt: skip
def test_what_no_arm_has_is_replaced_and_told(limit: str, expected: dict[str, float], told: str, vendors) -> None:
    notes, weak, first = limited(vendors, changed(text_of(), (PANDA_1, f'<limit {limit} effort="87"/>')))
    assert {key: first[key] for key in expected} == pytest.approx(expected)
    assert weak == []
    assert len(notes) == (told != "")
    assert not told or ("joint_1" in notes[0] and told in notes[0])


@pytest.mark.parametrize(("name", "reach", "unit"), [("panda", "2.8973", "rad"), ("lwr4_rail", "0.5", "m")])
def test_exchanged_limits_are_refused_by_name(name: str, reach: str, unit: str, vendors) -> None:
    text = changed(text_of(name), (f'lower="-{reach}" upper="{reach}"', f'lower="{reach}" upper="-{reach}"'))
    with pytest.raises(RobotError, match=rf"'joint_1': .* in {unit}, "):
        limited(vendors, text)
    with pytest.raises(RobotError, match="joint 'joint_1', lower is 'two'"):
        limited(vendors, changed(text_of(name), (f'lower="-{reach}"', 'lower="two"')))
    if name == "panda":  # the limits of a joint without end mean nothing
        endless = changed(text, ('name="joint_1" type="revolute"', 'name="joint_1" type="continuous"'))
        assert limited(vendors, endless)[2].items() >= ONE_TURN.items()


@pytest.mark.parametrize("size", ["inf", "1e16"])
def test_endless_numbers_are_none_and_are_told(size: str, vendors) -> None:
    limit = f'<limit lower="-{size}" upper="1.5" velocity="{size}" effort="{size}"/>'
    notes, weak, first = limited(vendors, changed(text_of(), (PANDA_1, limit)))
    assert any("joint_1: lower = -" in note and "is no limit" in note for note in notes)
    assert first.items() >= {**ONE_TURN, "velocity": CHOSEN["turning"]}.items()
    assert weak == ["joint_1"]


def test_a_rail_has_metres(vendors) -> None:
    text = changed(text_of("lwr4_rail"), ('<limit lower="-0.5" upper="0.5" velocity="0.5" effort="500"/>', ""))
    notes, weak, first = limited(vendors, text)
    assert first.items() >= {"lower": -TRAVEL_M, "upper": TRAVEL_M, "velocity": CHOSEN["sliding"]}.items()
    assert weak == ["joint_1"]
    assert any("m/s" in note for note in notes)


def test_missing_efforts_carry_the_arm(vendors) -> None:
    _, weak, _ = limited(vendors, re.sub(r'effort="\d+"', 'effort="0"', text_of()))
    assert weak == CHAIN
    robot = load_robot("panda")
    efforts = choose_efforts(robot, weak)
    for q in np.random.default_rng(3).uniform(robot.q_min, robot.q_max, (50, 7)):
        assert np.all(np.abs(robot.gravity(q)) < 0.5 * np.array(list(efforts.values())))
    assert max(efforts.values()) < 500.0

"""Vendors' URDFs become one serial chain with physically possible numbers."""

import re
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from moc_opt.errors import RobotError, UnknownNameError
from moc_opt.robots.model import load_robot
from moc_opt.robots.urdf import Link, inertia_fault, read
from moc_opt.robots.vendor import CHOSEN, TRAVEL_M, VendorArm, enough_efforts, mend_bodies, read_vendor
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


def last_frame(model: pin.Model, q: np.ndarray) -> np.ndarray:
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    return data.oMi[len(q)].homogeneous


def chain(arm: VendorArm) -> list[str]:
    return [joint.name for joint in arm.chain]


def model_of(arm: VendorArm) -> pin.Model:
    return pin.buildModelFromXML(arm.urdf.to_text("arm"))


def test_fingers_are_locked(vendors) -> None:
    arm = vendors(with_hand(text_of()))
    assert (arm.last_link, chain(arm)) == ("link_7", CHAIN)
    model, bare = model_of(arm), pin.buildModelFromXML(text_of())
    assert list(model.names)[1:] == CHAIN
    assert model.inertias[7].mass - bare.inertias[7].mass == pytest.approx(0.7 + 2 * 0.015)  # fingers keep their mass
    left = model.frames[model.getFrameId("left")].placement.translation
    expected = np.array([0.01 * np.sin(0.785), 0.01 * np.cos(0.785), 0.107])  # locked at the finger's limit nearest 0
    np.testing.assert_allclose(left, expected, rtol=0, atol=1e-12)
    notes = " ".join(arm.notes)
    assert all(word in notes for word in ("finger_1 (at 0.01 m)", "finger_2", "'link_7', the link of the last"))
    for q in np.random.default_rng(0).uniform(-1.0, 1.0, (5, 7)):
        np.testing.assert_allclose(last_frame(model, q), last_frame(bare, q), rtol=0, atol=1e-12)
    assert vendors(with_hand(text_of()), tip="hand").last_link == "hand"


def test_second_arm_requires_a_named_tip(vendors) -> None:
    text = added(text_of(), branch("b", 4, "link_0"))
    with pytest.raises(RobotError, match=r"2 chains leave link 'link_0', towards .*'b0'.*--tip"):
        vendors(text)
    arm = vendors(text, tip="link_7")
    assert chain(arm) == CHAIN
    assert "fixed: t_b0 (at 0 rad), t_b1" in " ".join(arm.notes)
    assert chain(vendors(text, tip="b3")) == [f"t_b{j}" for j in range(4)]
    with pytest.raises(UnknownNameError):
        vendors(text, tip="b9")
    assert chain(vendors(added(text_of(), branch("head", 2, "link_0")))) == CHAIN


def test_joint_locked_by_name_stays_at_the_given_angle(vendors) -> None:
    arm = vendors(text_of(), lock={"joint_3": 0.4})
    assert chain(arm) == [name for name in CHAIN if name != "joint_3"]
    q = np.array([0.1, -0.3, -1.2, 0.5, 1.4, 0.2])
    whole = last_frame(pin.buildModelFromXML(text_of()), np.insert(q, 2, 0.4))
    np.testing.assert_allclose(last_frame(model_of(arm), q), whole, rtol=0, atol=1e-12)
    with pytest.raises(UnknownNameError):
        vendors(text_of(), lock={"joint_9": 0.0})


@pytest.mark.parametrize(("old", "new", "words"), [
    ('name="joint_4" type="revolute"', 'name="joint_4" type="floating"', "has type 'floating'"),
    ('<child link="link_4"/>', '<child link="link_4"/><mimic joint="joint_3"/>', "mimics"),
])  # fmt: skip
def test_floating_or_mimic_joint_is_refused_within_the_arm(old, new, words, vendors) -> None:
    with pytest.raises(RobotError, match=f"'joint_4' {words}"):
        vendors(changed(text_of(), (old, new)))
    arm = vendors(added(text_of(), link("ship") + joint("sea", "floating", "ship", "link_0")))
    assert chain(arm) == CHAIN
    assert any("sea (floating)" in note for note in arm.notes)


def test_parts_with_reserved_names_are_renamed(vendors) -> None:
    arm = vendors(added(text_of(), link("world") + joint("tip_frame", "fixed", "world", "link_0")))
    assert {"world_link", "tip_frame_joint"} <= {part.name for part in (*arm.urdf.links, *arm.urdf.joints)}


def test_file_that_is_no_arm_is_refused(vendors) -> None:
    with pytest.raises(RobotError, match=r"^/.*\.urdf: urdf is a xacro file"):
        vendors('<robot xmlns:xacro="http://x/xacro"><xacro:macro name="a"/></robot>')
    with pytest.raises(RobotError, match="no joint moves"):
        vendors(f'<robot name="a">{link("a", 1.0)}{link("b", 1.0)}{joint("j", "fixed", "a", "b")}</robot>')


def mended(*links: Link) -> list[str]:
    notes: list[str] = []
    mend_bodies(links, notes)
    return notes


def test_body_with_almost_no_mass_becomes_a_frame() -> None:
    ours, again = (read(text_of()).links for _ in range(2))
    assert (mended(*ours), ours) == ([], again)
    frame, weightless, heavy = Link("f", 1e-7, (0.1,) * 6), Link("n", 0.0, (1e-9,) * 6), Link("h", 1.0)
    notes = mended(frame, weightless, heavy)
    assert [one.is_frame for one in (frame, weightless, heavy)] == [True, True, False]
    assert "link 'h' has an inertia that no body has" in notes[0]
    assert notes[1].endswith(": f, n")


@given(st.tuples(*[st.floats(-0.1, 0.1)] * 6).filter(lambda given: max(map(abs, given)) > 1e-9))
def test_any_inertia_is_mended_to_one_that_a_body_can_have(given: tuple[float, ...]) -> None:
    body = Link("a", 1.0, given)
    assert (mended(body) == []) == (inertia_fault(given) is None)
    assert inertia_fault(body.moments) is None


ONE_TURN = {"lower": -np.pi, "upper": np.pi}
FAST = {"velocity": CHOSEN["turning"]}


@pytest.mark.parametrize(("name", "limit", "expected", "noted"), [
    ("panda", 'lower="-2.8973" upper="2.8973" velocity="2.175" effort="87"',
     {"lower": -2.8973, "upper": 2.8973, "velocity": 2.175}, []),
    ("panda", 'lower="-2.8973" upper="2.8973" velocity="10" effort="87"', FAST, ["10 rad/s is not a plausible speed"]),
    ("panda", 'lower="-2.8973" upper="2.8973" effort="87"', FAST, ["no speed limit"]),
    ("panda", 'lower="-6.2832" upper="6.2832" velocity="2" effort="87"', ONE_TURN, ["-6.2832 to 6.2832 rad"]),
    ("panda", 'lower="1" upper="9" velocity="2" effort="87"', {"lower": 5.0 - np.pi, "upper": 5.0 + np.pi},
     ["not a plausible range .*: one turn is used"]),
    ("panda", 'velocity="2" effort="87"', ONE_TURN, ["not a plausible range"]),
    ("panda", 'lower="-166" upper="166" velocity="2" effort="87"', ONE_TURN, ["are these degrees"]),
    *(("panda", f'lower="-{size}" upper="1.5" velocity="{size}" effort="{size}"', {**ONE_TURN, **FAST},
       ["to 1.5 rad, not a plausible range", "is not a plausible speed"]) for size in ("inf", "1e16")),
    ("lwr4_rail", "", {"lower": -TRAVEL_M, "upper": TRAVEL_M, "velocity": CHOSEN["sliding"]},
     ["has no range: .* m is used", "no speed limit: .* m/s is used"]),
])  # fmt: skip
def test_impossible_limits_are_replaced_and_noted(name: str, limit: str, expected: dict, noted: list, vendors) -> None:
    arm = vendors(re.sub("<limit .*?/>", f"<limit {limit}/>", text_of(name), count=1))
    first, notes = arm.chain[0].limits, [note for note in arm.notes if "joint_1" in note]
    assert {key: first[key] for key in expected} == pytest.approx(expected)
    assert arm.weak == ([] if 'effort="87"' in limit else ["joint_1"])
    assert len(notes) == len(noted)
    assert all(re.search(words, note) for words, note in zip(noted, notes, strict=True))


@pytest.mark.parametrize(("name", "reach", "unit"), [("panda", "2.8973", "rad"), ("lwr4_rail", "0.5", "m")])
def test_error_names_the_joint_with_limits_in_wrong_order(name: str, reach: str, unit: str, vendors) -> None:
    text = changed(text_of(name), (f'lower="-{reach}" upper="{reach}"', f'lower="{reach}" upper="-{reach}"'))
    with pytest.raises(RobotError, match=rf"'joint_1': .* in {unit}, "):
        vendors(text)
    if name == "panda":  # continuous joints have no limits
        endless = changed(text, ('name="joint_1" type="revolute"', 'name="joint_1" type="continuous"'))
        assert vendors(endless).chain[0].limits.items() >= ONE_TURN.items()


def test_gravity_needs_less_than_half_of_the_replacement_torque_limits(vendors) -> None:
    assert vendors(re.sub(r'effort="\d+"', 'effort="0"', text_of())).weak == CHAIN
    robot = load_robot("panda")
    efforts = enough_efforts(robot)
    for q in np.random.default_rng(3).uniform(robot.q_min, robot.q_max, (50, 7)):
        assert np.all(np.abs(robot.gravity(q)) < 0.5 * np.array(efforts))
    assert max(efforts) < 500.0

"""Vendors' URDFs: side joints locked, frames merged, one chain found or asked for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from moc_opt.commissioning.vendor import read_vendor, rpy_of
from moc_opt.errors import RobotError, UnknownNameError
from moc_opt.robots import urdf
from tests.commissioning.arms import added, changed, joint, link, text_of, with_hand


def written(folder: Path, text: str) -> Path:
    path = folder / "arm.urdf"
    path.write_text(text, encoding="utf-8")
    return path


def model_of(arm: object) -> pin.Model:
    return pin.buildModelFromXML(urdf.to_text(arm.root))  # type: ignore[attr-defined]


CHAIN = [f"joint_{j}" for j in range(1, 8)]


def test_fingers_are_locked_and_the_chain_ends_before_them(tmp_path: Path) -> None:
    arm = read_vendor(written(tmp_path, with_hand(text_of())))
    assert arm.last_link == "hand"
    assert arm.chain == CHAIN
    model = model_of(arm)
    assert list(model.names)[1:] == CHAIN
    bare = pin.buildModelFromXML(text_of())
    carried = model.inertias[7].mass - bare.inertias[7].mass
    assert carried == pytest.approx(0.7 + 2 * 0.015)  # what is locked still weighs
    left = model.frames[model.getFrameId("left")].placement.translation
    turn = np.array([0.01 * np.sin(0.785), 0.01 * np.cos(0.785), 0.107])  # at the end of its range next to 0
    np.testing.assert_allclose(left, turn, rtol=0, atol=1e-12)
    told = " ".join(arm.notes)
    for word in ("link8", "finger_1 at 0.01 m", "finger_2", "2 fingers branch off"):
        assert word in told


def test_the_arm_moves_as_before(tmp_path: Path) -> None:
    ours, theirs = (
        model_of(read_vendor(written(tmp_path, with_hand(text_of())))),
        pin.buildModelFromXML(text_of()),
    )
    for q in np.random.default_rng(0).uniform(-1.0, 1.0, (5, 7)):
        places = []
        for model in (ours, theirs):
            data = model.createData()
            pin.forwardKinematics(model, data, q)
            places.append(data.oMi[7].homogeneous)
        np.testing.assert_allclose(*places, rtol=0, atol=1e-12)


def test_a_second_arm_needs_a_tip(tmp_path: Path) -> None:
    turn = '<axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="1" effort="9"/>'
    other = "".join(
        link(f"b{j}", 1.0) + joint(f"other_{j}", "revolute", f"b{j - 1}" if j else "link_0", f"b{j}", turn)
        for j in range(4)
    )
    path = written(tmp_path, added(text_of(), other))
    with pytest.raises(RobotError, match=r"2 chains leave link 'link_0', towards .*'b0'.*--tip"):
        read_vendor(path)
    arm = read_vendor(path, tip="link_7")
    assert arm.chain == CHAIN
    assert [element.get("name") for element in arm.root.findall("link")] == [f"link_{j}" for j in range(8)]
    assert "4 links that hang on the base" in " ".join(arm.notes)
    assert read_vendor(path, tip="b3").chain == [f"other_{j}" for j in range(4)]
    with pytest.raises(UnknownNameError, match=r"--tip.* 'b9': did you mean"):
        read_vendor(path, tip="b9")


def test_a_joint_locked_by_name_stands_where_it_was_told(tmp_path: Path) -> None:
    arm = read_vendor(written(tmp_path, text_of()), lock={"joint_3": 0.4})
    assert arm.chain == [name for name in CHAIN if name != "joint_3"]
    model, whole = model_of(arm), pin.buildModelFromXML(text_of())
    q = np.array([0.1, -0.3, -1.2, 0.5, 1.4, 0.2])
    data, other = model.createData(), whole.createData()
    pin.forwardKinematics(model, data, q)
    pin.forwardKinematics(whole, other, np.insert(q, 2, 0.4))
    np.testing.assert_allclose(data.oMi[6].homogeneous, other.oMi[7].homogeneous, rtol=0, atol=1e-12)
    with pytest.raises(UnknownNameError, match="--lock"):
        read_vendor(written(tmp_path, text_of()), lock={"joint_9": 0.0})


def test_a_mimic_joint_in_the_chain_is_refused_by_name(tmp_path: Path) -> None:
    text = text_of()
    place = text.index('<joint name="joint_5"')
    text = text[:place] + changed(text[place:], ("</joint>", '<mimic joint="joint_4"/></joint>'))
    with pytest.raises(RobotError, match="'joint_5' lies between base and last link and mimics"):
        read_vendor(written(tmp_path, text))
    assert len(read_vendor(written(tmp_path, text), lock={"joint_5": 0.0}).chain) == 6


@pytest.mark.parametrize("kind", ["floating", "planar"])
def test_a_joint_that_no_drive_moves_so_is_refused_inside_the_arm_alone(kind: str, tmp_path: Path) -> None:
    text = changed(text_of(), ('name="joint_4" type="revolute"', f'name="joint_4" type="{kind}"'))
    with pytest.raises(RobotError, match=f"'joint_4' lies between two joints of the arm and is {kind}"):
        read_vendor(written(tmp_path, text))
    below = added(text_of(), link("ship") + joint("sea", kind, "ship", "link_0"))
    arm = read_vendor(written(tmp_path, below))
    assert arm.chain == CHAIN
    assert any(f"sea ({kind})" in note for note in arm.notes)


def test_names_that_the_tool_needs_are_moved_out_of_the_way(tmp_path: Path) -> None:
    text = added(text_of(), link("world") + joint("tip_frame", "fixed", "world", "link_0"))
    arm = read_vendor(written(tmp_path, text))
    names = [element.get("name") for element in arm.root]
    assert "world_link" in names
    assert "tip_frame_joint" in names
    assert arm.chain == CHAIN


def test_the_flange_is_known_by_its_name(tmp_path: Path) -> None:
    more = (
        link("camera")
        + joint("c", "fixed", "link_7", "camera")
        + link("tool0")
        + joint("t", "fixed", "link_7", "tool0")
    )
    assert read_vendor(written(tmp_path, added(text_of(), more))).last_link == "tool0"


@pytest.mark.parametrize(
    "text",
    [
        '<robot xmlns:xacro="http://x/xacro"><xacro:macro name="a"/></robot>',
        text_of().replace("0 0 0.333", "0 0 ${d}"),
    ],
)  # fmt: skip
def test_xacro_is_told_from_a_urdf(text: str, tmp_path: Path) -> None:
    with pytest.raises(RobotError, match="is a xacro file: expand it first"):
        read_vendor(written(tmp_path, text))


@pytest.mark.parametrize("seed", range(20))
def test_roll_pitch_yaw_give_the_rotation_back(seed: int) -> None:
    R = pin.Quaternion(np.random.default_rng(seed).normal(size=4)).normalized().toRotationMatrix()
    np.testing.assert_allclose(pin.rpy.rpyToMatrix(*rpy_of(R)), R, rtol=0, atol=1e-12)


@pytest.mark.parametrize("pitch", [np.pi / 2, -np.pi / 2])
def test_roll_pitch_yaw_of_a_straight_pitch(pitch: float) -> None:
    R = pin.rpy.rpyToMatrix(0.3, pitch, -0.4)
    np.testing.assert_allclose(pin.rpy.rpyToMatrix(*rpy_of(R)), R, rtol=0, atol=1e-12)


def test_of_several_arms_the_links_that_can_carry_the_tool_are_named(tmp_path: Path) -> None:
    """Two arms on a trunk, one with a hand of long fingers; a head and legs of few joints are no arms."""
    turn = '<axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="1" effort="9"/>'

    def chain(name: str, count: int, at: str) -> str:
        return "".join(
            link(f"{name}{j}", 1.0) + joint(f"t_{name}{j}", "revolute", below, f"{name}{j}", turn)
            for j, below in enumerate([at, *[f"{name}{j}" for j in range(count - 1)]])
        )

    more = chain("other", 6, "link_0") + chain("head", 2, "link_0")
    more += link("palm", 0.3) + joint("wrist_joint", "fixed", "other5", "palm") + chain("thumb", 3, "palm")
    more += chain("index", 4, "palm")
    with pytest.raises(RobotError, match=r"such as \['link_7', 'palm'\]$"):
        read_vendor(written(tmp_path, added(text_of(), more)))


def test_a_jaw_at_the_end_is_no_joint_of_the_arm(tmp_path: Path) -> None:
    turn = '<axis xyz="0 1 0"/><limit lower="-1" upper="0" velocity="1" effort="9"/>'
    jaw = link("mover", 0.2) + joint("jointGripper", "revolute", "link_7", "mover", turn)
    arm = read_vendor(written(tmp_path, added(text_of(), jaw)))
    assert (arm.chain, arm.last_link) == (CHAIN, "link_7")
    assert any("'jointGripper' is taken for the jaw" in note for note in arm.notes)
    assert read_vendor(written(tmp_path, added(text_of(), jaw)), tip="mover").chain == [*CHAIN, "jointGripper"]


@pytest.mark.parametrize("declared", [True, False])
def test_names_of_other_tools_need_no_declaration(declared: bool, tmp_path: Path) -> None:
    """Some vendors' files use a prefix that they never declare, which no XML reader takes."""
    text = changed(text_of(), ('lower="-2.8973"', 'drake:acceleration="2" lower="-2.8973"'))
    text = added(text, '<drake:proximity_properties a="b:c"/>')
    if declared:
        text = changed(text, ("<robot ", '<robot xmlns:drake="http://drake.mit.edu" '))
    arm = read_vendor(written(tmp_path, text))
    assert arm.chain == CHAIN
    assert any("drake: are not read" in note for note in arm.notes) is not declared

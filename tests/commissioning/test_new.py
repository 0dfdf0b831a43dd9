"""A URDF of a vendor becomes a robot that runs, and says what was assumed; what cannot be an arm is refused."""

from __future__ import annotations

import re
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest

from moc_opt.commissioning.check import check_robot, verdict
from moc_opt.commissioning.home import MARGIN
from moc_opt.commissioning.new import new_robot
from moc_opt.errors import RobotError
from moc_opt.model.robot_model import load_robot
from moc_opt.redundancy.freedoms import freedoms, limit_shares
from moc_opt.scenario import Scenario, run
from moc_opt.trace.metrics import summarize
from tests.commissioning.arms import changed, text_of, with_hand


def made(folder: Path, text: str, **options: object) -> object:
    source = folder / "vendor.urdf"
    source.write_text(text, encoding="utf-8")
    return new_robot(source, folder / "out" / "my.toml", **options)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def panda(tmp_path_factory: pytest.TempPathFactory) -> object:
    text = changed(
        with_hand(text_of()), ('name="joint_1" type="revolute"', 'name="joint_1" type="continuous"'),
        ('velocity="2.61" effort="12"', 'velocity="10" effort="0"'),
    )  # fmt: skip
    return made(tmp_path_factory.mktemp("panda"), text)


def test_what_was_assumed_stands_in_both_files(panda) -> None:
    text = panda.toml.read_text(encoding="utf-8")
    plain = " ".join(line.lstrip("# -") for line in text.splitlines())
    assert len(panda.notes) >= 6
    for note in panda.notes:
        assert note in plain
    for word in (
        "finger_1",
        "joint_1 turns without end",
        "10 rad/s is no speed",
        "no usable torque limit",
        "hand",
    ):
        assert word in text
    assert "finger_2" in panda.urdf.read_text(encoding="utf-8")
    assert "mesh" not in panda.urdf.read_text(encoding="utf-8")


def test_the_new_robot_is_the_vendors(panda) -> None:
    ours, theirs = panda.robot, load_robot("panda")
    assert ours.data.name == "my"
    for q in np.random.default_rng(1).uniform(-1.0, 1.0, (5, 7)):
        np.testing.assert_allclose(
            ours.state(q).tip, theirs.state(q).tip, rtol=0, atol=1e-9
        )  # mounted on the hand's origin


def test_the_home_pose_is_away_from_limits_and_singularities(panda) -> None:
    left = freedoms(panda.robot, panda.robot.data.q_home)
    assert (left.rank, left.real, left.idle) == (5, 1, (6,))
    assert left.tip > 0.15
    assert left.both > 0.08
    assert limit_shares(panda.robot, panda.robot.data.q_home)[:6].min() > MARGIN - 0.02
    assert 0.7 <= panda.home.mu / panda.home.mu_best <= 0.9
    assert panda.home.task == ""


def test_it_runs_and_gains_manipulability(panda) -> None:
    asked = Scenario(robot={"name": str(panda.toml)}, bound_samples=0)
    moc, dcac = run(asked), run(asked.change(control=asked.control.matched_dcac(), judge=False))
    assert (moc.meta["ended"], dcac.meta["ended"]) == ("completed", "completed")
    found = summarize(moc, dcac)
    assert found["mu_gain_percent"] > 10.0
    assert found["tip_error_max_mm"] < 1.5
    assert found["rcm_error_max_mm"] < 2.5
    assert verdict(check_robot(panda.robot)) == "ok"


def test_the_same_seed_finds_the_same_pose(panda, tmp_path: Path) -> None:
    source = tmp_path / "vendor.urdf"
    source.write_text(
        (panda.toml.parent.parent / "vendor.urdf").read_text(encoding="utf-8"), encoding="utf-8"
    )
    again = new_robot(source, tmp_path / "my.toml")
    assert again.toml.read_text(encoding="utf-8") == panda.toml.read_text(encoding="utf-8")


def test_an_arm_without_freedom_is_refused_with_the_count(tmp_path: Path) -> None:
    with pytest.raises(
        RobotError, match=r"of 6 joints the tool's tip and shaft take 5, 1 turn nothing but the tool"
    ):
        made(tmp_path, text_of(), lock={"joint_3": 0.0})
    assert not (tmp_path / "out").exists()
    with pytest.raises(RobotError, match=r"of 4 joints the tool's tip and shaft take 3"):
        made(tmp_path, text_of(), lock={"joint_1": 0.0, "joint_3": 0.0, "joint_5": 0.0})


def test_a_base_on_the_ceiling_hangs(tmp_path: Path) -> None:
    hanging = made(tmp_path, text_of("iiwa14"), base_rpy=(np.pi, 0.0, 0.0)).robot  # type: ignore[attr-defined]
    standing = load_robot("iiwa14")
    for q in np.random.default_rng(1).uniform(-1.0, 1.0, (3, 7)):
        tip = standing.state(q).wrist
        np.testing.assert_allclose(hanging.state(q).wrist, tip * [1, -1, -1], rtol=0, atol=1e-9)
    assert hanging.state(hanging.data.q_home).tip[2] < 0.0


@pytest.mark.parametrize("name", ["my.urdf", "my"])
def test_the_file_to_write_is_a_toml(name: str, tmp_path: Path) -> None:
    with pytest.raises(RobotError, match=r"ends in \.toml"):
        new_robot(tmp_path / "a.urdf", tmp_path / name)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"tool_m": float("nan")}, "--tool nan"), ({"tool_m": 0.0}, "--tool 0.0"),
        ({"wrist_m": float("inf")}, "--wrist"),
        ({"base_rpy": (float("nan"), 0.0, 0.0)}, "--base-rpy"), ({"lock": {"joint_3": float("nan")}}, "--lock joint_3"),
        ({"seed": -1}, "--seed -1"),
    ],
)  # fmt: skip
def test_options_that_are_no_numbers_are_refused(options: dict[str, object], words: str, tmp_path: Path) -> None:
    with pytest.raises(RobotError, match=words):
        made(tmp_path, text_of(), **options)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("stem", ['a "b" c', "a\nb", ".", "-x", "a" * 101])
def test_a_name_that_no_robot_has_is_refused(stem: str, tmp_path: Path) -> None:
    with pytest.raises(RobotError, match="letters, digits"):
        new_robot(tmp_path / "a.urdf", tmp_path / f"{stem}.toml")


def test_links_in_a_loop_are_named(tmp_path: Path) -> None:
    looped = changed(text_of(), ('<parent link="link_3"/>', '<parent link="link_4"/>'))
    with pytest.raises(RobotError, match=r"'link_4'.*in a loop"):
        made(tmp_path, looped)


def test_numbers_of_rounding_do_not_stand_in_the_file(tmp_path: Path) -> None:
    """A joint without an axis turns about x: the mount's angles come out as 1e-31."""
    bare = re.sub(r'(<joint name="joint_7".*?)<axis [^>]*/>', r"\1", text_of("iiwa14"), flags=re.DOTALL)
    assert bare != text_of("iiwa14")
    found = made(tmp_path, bare).toml.read_text(encoding="utf-8")  # type: ignore[attr-defined]
    assert "e-" not in found.split("[joints]")[0]


def test_nothing_is_written_over(panda) -> None:
    with pytest.raises(RobotError, match="exists"):
        new_robot(panda.urdf, panda.toml)


def test_an_arm_without_masses_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(RobotError, match="joint 'joint_1' moves no mass"):
        made(tmp_path, re.sub(r"<inertial>.*?</inertial>", "", text_of(), flags=re.DOTALL))


def test_of_a_flange_without_mass_the_tool_is_what_the_last_joint_moves(tmp_path: Path) -> None:
    text = text_of()
    place = text.index('<link name="link_7">')
    start, end = (text.index(tag, place) for tag in ("<inertial>", "</inertial>"))
    arm = made(tmp_path, text[:start] + text[end + len("</inertial>") :])
    assert any("link_7: what joint_7 carries has no mass, and the tool is all" in note for note in arm.notes)
    whole = load_robot("panda")
    assert 0.0 < arm.robot.state(whole.data.q_home).M[5, 5] < whole.state(whole.data.q_home).M[5, 5]


# --- files of packages, where they are installed ---

ROBOTS = "cmeel.prefix/share/example-robot-data/robots"
FILES = [
    ("panda_description/urdf/panda.urdf", None, 7), ("xarm_description/urdf/xarm7.urdf", None, 7),
    ("baxter_description/urdf/baxter.urdf", "left_hand_link", 7),
    ("pr2_description/urdf/pr2.urdf", "r_wrist_roll_link", 8),
    ("tiago_pro_description/robots/tiago_pro.urdf", "arm_left_7_link", 8),
    ("talos_data/robots/talos_full_v2.urdf", "arm_left_7_link", 9),
]  # fmt: skip


@pytest.mark.parametrize(("path", "tip", "joints"), FILES)
def test_a_vendors_file_works_as_it_comes(path: str, tip: str | None, joints: int, tmp_path: Path) -> None:
    try:
        source = Path(str(metadata.distribution("example-robot-data").locate_file(f"{ROBOTS}/{path}")))
    except metadata.PackageNotFoundError:
        pytest.skip("example-robot-data is not installed: pip install --no-deps example-robot-data")
    found = new_robot(source, tmp_path / "my.toml", tip=tip)
    assert found.robot.n == joints
    refused = [row.what for row in check_robot(found.robot) if row.verdict == "cannot"]
    if "pr2" in path:
        assert refused == ["gravity at home"]  # springs hold its arm, and no URDF has them
        return
    assert refused == []
    trace = run(Scenario(robot={"name": str(found.toml)}, duration_s=1.0, bound_samples=0, judge=False))
    assert trace.meta["ended"] == "completed"

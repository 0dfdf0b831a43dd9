"""`robot new` and `robot check`."""

from __future__ import annotations

import dataclasses
import re
from importlib import metadata
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from moc_opt.__main__ import main
from moc_opt.errors import RobotError
from moc_opt.planning.self_motion import freedoms, self_motion
from moc_opt.robots import available_robots, new
from moc_opt.robots.check import Finding, check_robot, verdict
from moc_opt.robots.model import RobotModel, load_robot
from moc_opt.robots.new import NewRobot, find_shaft, new_robot, search_home
from moc_opt.scenario import Scenario, run
from moc_opt.trace.metrics import summarize
from tests.robots.arms import added, changed, joint, link, text_of, with_hand


def made(folder: Path, text: str, **options: object) -> NewRobot:
    source = folder / "vendor.urdf"
    source.write_text(text, encoding="utf-8")
    return new_robot(source, folder / "out" / "my.toml", **options)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def panda(tmp_path_factory: pytest.TempPathFactory) -> NewRobot:
    text = changed(
        with_hand(text_of()), ('name="joint_1" type="revolute"', 'name="joint_1" type="continuous"'),
        ('velocity="2.61" effort="12"', 'velocity="10" effort="0"'),
    )  # fmt: skip
    return made(tmp_path_factory.mktemp("panda"), text, tip="hand")


def test_robot_file_contains_every_note(panda) -> None:
    text = panda.toml.read_text(encoding="utf-8")
    plain = " ".join(line.lstrip("# -") for line in text.splitlines())
    assert len(panda.notes) >= 6
    assert all(note in plain for note in panda.notes)
    for word in ("finger_1", "joint_1 turns without end", "10 rad/s", "no usable torque limit", "the link of --tip"):
        assert word in text
    assert "mesh" not in panda.urdf.read_text(encoding="utf-8")


def test_panda_made_from_a_urdf_works_like_the_built_in_panda(panda) -> None:
    ours, theirs = panda.robot, load_robot("panda")
    assert ours.data.name == "my"
    for q in np.random.default_rng(1).uniform(-1.0, 1.0, (5, 7)):
        np.testing.assert_allclose(ours.state(q).tip, theirs.state(q).tip, rtol=0, atol=1e-9)
    assert verdict(check_robot(ours)) == "ok"
    trace = run(Scenario(robot={"name": str(panda.toml)}, bound_samples=0, judge=False))
    assert trace.meta["ended"] == "completed"
    assert trace.mu[-1] > 1.1 * trace.mu[0]
    found = summarize(trace)
    assert found["tip_error_max_mm"] < 1.5
    assert found["rcm_error_max_mm"] < 2.5


def test_base_rpy_of_pi_turns_the_arm_upside_down(tmp_path: Path) -> None:
    hanging = made(tmp_path, text_of("iiwa14"), base_rpy=(np.pi, 0.0, 0.0)).robot
    standing = load_robot("iiwa14")
    for q in np.random.default_rng(1).uniform(-1.0, 1.0, (3, 7)):
        wrist = standing.state(q).wrist
        np.testing.assert_allclose(hanging.state(q).wrist, wrist * [1, -1, -1], rtol=0, atol=1e-9)
    assert hanging.state(hanging.data.q_home).tip[2] < 0.0


def test_rotor_inertia_and_friction_follow_torque_limits(tmp_path: Path) -> None:
    data = made(tmp_path, text_of("lwr4_rail")).robot.data
    assert data.rotor_inertia.tolist() == [20.0] + [0.2] * 7
    assert data.coulomb_friction.tolist() == data.viscous_friction.tolist()
    assert data.coulomb_friction.tolist() == [4.0, 1.0, 1.0, 0.8, 0.8, 0.8, 0.3, 0.3]


def test_unusable_urdf_leaves_no_file(tmp_path: Path) -> None:
    massless = re.sub(r"<inertial>.*?</inertial>", "", text_of(), flags=re.DOTALL)
    with pytest.raises(RobotError, match="joint 'joint_1' moves no mass"):
        made(tmp_path, massless)
    with pytest.raises(RobotError, match="of 4 joints, the tool's tip and shaft need 3, and 1 turn only the tool"):
        made(tmp_path, text_of(), lock={"joint_1": 0.0, "joint_3": 0.0, "joint_5": 0.0})
    with pytest.raises(RobotError, match="has 3 joints: 4 to 16 can be controlled"):
        made(tmp_path, text_of(), lock=dict.fromkeys(("joint_1", "joint_3", "joint_5", "joint_6"), 0.0))
    assert not (tmp_path / "out").exists()


ROBOTS = "cmeel.prefix/share/example-robot-data/robots"


@pytest.mark.parametrize(("path", "tip", "joints"), [
    ("panda_description/urdf/panda.urdf", None, 7), ("xarm_description/urdf/xarm7.urdf", None, 7),
    ("baxter_description/urdf/baxter.urdf", "left_hand_link", 7),
    ("tiago_pro_description/robots/tiago_pro.urdf", "arm_left_7_link", 8),
    ("talos_data/robots/talos_full_v2.urdf", "arm_left_7_link", 9),
])  # fmt: skip
def test_vendors_file_works_unchanged(path: str, tip: str | None, joints: int, tmp_path: Path) -> None:
    try:
        source = Path(str(metadata.distribution("example-robot-data").locate_file(f"{ROBOTS}/{path}")))
    except metadata.PackageNotFoundError:
        pytest.skip("example-robot-data is not installed: pip install --no-deps example-robot-data")
    found = new_robot(source, tmp_path / "my.toml", tip=tip)
    assert found.robot.n == joints
    assert verdict(check_robot(found.robot)) != "cannot"
    trace = run(Scenario(robot={"name": str(found.toml)}, duration_s=1.0, bound_samples=0, judge=False))
    assert trace.meta["ended"] == "completed"


def direction(rpy: tuple[float, float, float]) -> np.ndarray:
    return pin.rpy.rpyToMatrix(*rpy)[:, 2]


@pytest.mark.parametrize(("name", "height", "up"), [
    ("lwr4", -0.078, 1), ("iiwa14", -0.081, 1), ("panda", 0, 1), ("gen3", 0.10593, -1), ("xarm7", -0.097, 1),
    ("lwr4_rail", -0.078, 1),
])  # fmt: skip
def test_wrist_of_a_known_arm_is_found(name: str, height: float, up: int) -> None:
    last = f"link_{8 if name == 'lwr4_rail' else 7}"
    found = find_shaft(text_of(name), last)
    for point, expected in (
        (found.wrist, [0, 0, height]), (direction(found.rpy), [0, 0, up]), (found.mount, [0, 0, 0]),
    ):  # fmt: skip
        np.testing.assert_allclose(point, expected, rtol=0, atol=1e-12)


def test_wrist_is_the_point_on_the_last_axis_nearest_to_the_sixth_axis() -> None:
    text = re.sub(r'(name="joint_6".*?<axis xyz=")0 0 1', r"\g<1>0 0.5 1", text_of("xarm7"), flags=re.DOTALL)
    model = pin.buildModelFromXML(text)
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    before, last = data.J[3:, 5:].T
    found = find_shaft(text, "link_7")
    gap = data.oMi[7].act(found.wrist) - data.oMi[6].translation
    assert abs(before @ last) > 0.1
    assert (gap - gap @ before * before) @ last == pytest.approx(0.0, abs=1e-12)
    assert np.abs(found.wrist).max() > 1e-3


def test_shaft_is_found_on_turned_or_offset_flange_and_on_sliding_link() -> None:
    def with_flange(origin: str) -> str:
        return added(text_of(), link("flange") + joint("f", "fixed", "link_7", "flange", f"<origin {origin}/>"))

    found = find_shaft(with_flange('xyz="0 0 0.107" rpy="0.3 1.1 -2"'), "flange")
    np.testing.assert_allclose(found.wrist, -0.107 * direction(found.rpy), rtol=0, atol=1e-12)
    found = find_shaft(with_flange('xyz="0.05 0 0.107"'), "flange")
    assert "off the last axis" in found.note
    np.testing.assert_allclose(direction(found.rpy), [0, 0, 1], rtol=0, atol=1e-12)
    sliding = changed(text_of(), ('name="joint_7" type="revolute"', 'name="joint_7" type="prismatic"'))
    found = find_shaft(sliding, "link_7")
    assert "slides" in found.note
    np.testing.assert_allclose(found.wrist, 0.0)


@pytest.mark.parametrize("name", available_robots())
def test_found_home_pose_meets_its_requirements(name: str) -> None:
    robot = load_robot(name)
    home = search_home(robot, seed=3)
    free, state = freedoms(robot, home.q), robot.state(home.q)
    assert free.tip > new.REGULAR[0]
    assert free.both > new.REGULAR[1]
    assert home.margin > new.MARGIN - 0.01  # rounded to two digits
    assert new.SHARE[0] <= home.mu / home.mu_best <= new.SHARE[1]
    assert state.mu == pytest.approx(home.mu)
    assert min(state.tip[2], state.wrist[2]) > new.CLEARANCE_M - 0.01
    assert home.task == ""
    if name == "xarm7":  # fails if the ranking of poses changes
        np.testing.assert_array_equal(home.q, [-0.72, 0.06, -0.89, 1.37, 0.22, 1.37, 0.0])
        assert np.abs(search_home(robot, seed=2).q - home.q).max() > 0.1


def test_arm_that_is_singular_everywhere_has_no_home(robot: RobotModel) -> None:
    """The limits keep joints 2, 4 and 6 straight."""
    q_min, q_max = robot.data.q_min.copy(), robot.data.q_max.copy()
    q_min[[1, 3, 5]], q_max[[1, 3, 5]] = -1e-3, 1e-3
    stiff = RobotModel(dataclasses.replace(robot.data, q_min=q_min, q_max=q_max, q_home=np.zeros(7)))
    with pytest.raises(RobotError, match="home pose: none of 6000 random poses"):
        search_home(stiff)


def test_commands_accept_a_vendors_file(tmp_path: Path, monkeypatch, capsys) -> None:
    (tmp_path / "vendor.urdf").write_text(with_hand(text_of("iiwa14")), encoding="utf-8")
    (tmp_path / "short.toml").write_text("duration_s = 0.1\nbound_samples = 2\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    new = ["robot", "new", "vendor.urdf", "--tool", "0.25", "--out", "my.toml"]
    assert main(new) == 0
    said = capsys.readouterr().out
    assert "the tool sits on 'link_7'" in said
    assert "tool 250 mm" in said
    text = Path("my.toml").read_text(encoding="utf-8")
    assert main(["robot", "check", "my.toml"]) == 0
    assert "1 real, 1 idle (joint_7)" in capsys.readouterr().out
    assert main(["run", "short.toml", "--robot", "my.toml", "--trace", "run.parquet"]) == 0
    assert main(new) == 2
    line = next(line for line in text.splitlines() if line.startswith("q_rad"))
    Path("my.toml").write_text(text.replace(line, f"q_rad = {[0.0] * 7}"), encoding="utf-8")
    assert main(["robot", "check", "my.toml"]) == 3
    Path("my.toml").unlink()  # the trace contains the arm
    assert main(["replay", "run.parquet", "--out", "run.html"]) == 0


@pytest.mark.parametrize(("arguments", "told"), [
    (["--lock", "joint_3=x"], "--lock"), (["--lock", "joint_3"], "of 6 joints"), (["--tip", "gone"], "unknown link"),
    (["--tool", "-1"], "--tool"), (["--lock", "joint_3=1e308"], "--lock joint_3"), (["--seed", "-1"], "--seed"),
    (["--base-rpy", "nan", "0", "0"], "--base-rpy"), (["--out", "x.txt"], "--out"),
    (["--out", "my robot.toml"], "--out"),
])  # fmt: skip
def test_wrong_argument_gives_one_line_and_no_file(arguments: list[str], told: str, tmp_path: Path, capsys) -> None:
    source = tmp_path / "vendor.urdf"
    source.write_text(text_of("iiwa14"), encoding="utf-8")
    assert main(["robot", "new", str(source), "--out", str(tmp_path / "my.toml"), *arguments]) == 2
    said = capsys.readouterr().err
    assert told in said
    assert len(said.strip().splitlines()) == 1
    assert not (tmp_path / "my.toml").exists()


def rows(robot: RobotModel, scenario: Scenario | None = None) -> dict[str, Finding]:
    return {row.what: row for row in check_robot(robot, scenario)}


def altered(robot: RobotModel, **fields: object) -> RobotModel:
    return RobotModel(dataclasses.replace(robot.data, **fields))  # type: ignore[arg-type]


@pytest.mark.parametrize("name", available_robots())
def test_robot_check_finds_no_fault_in_built_in_arms(name: str) -> None:
    found = check_robot(load_robot(name))
    assert verdict(found) == "ok"
    assert len(found) == 11
    assert not any(row.cure for row in found)


@pytest.mark.parametrize(("what", "fields", "judged", "told"), [
    ("joint speeds", {"v_max": [1.9, 1.9, 10.0, 2, 2, 2, 2]}, "care", "joint_3 10 rad/s"),
    ("gravity at home", {"tau_max": [5.0] * 7}, "cannot", "check masses"),
    ("masses", {"urdf": ('ixx="0.01845" iyy="0.01602"', 'ixx="5.0" iyy="5.0"')}, "care", "link_1"),
])  # fmt: skip
def test_each_fault_is_reported_in_its_row(robot: RobotModel, what: str, fields: dict, judged: str, told: str) -> None:
    if "urdf" in fields:
        fields = {"urdf": changed(robot.data.urdf, fields["urdf"])}
    row = rows(altered(robot, **fields))[what]
    assert row.verdict == judged
    assert told in row.cure


def test_home_at_98_percent_of_the_largest_mu_has_verdict_care(robot: RobotModel) -> None:
    curve = self_motion(robot, robot.data.q_home)
    for share, judged in ((0.98, "care"), (0.91, "ok")):
        q = curve.q[np.argmin(np.abs(curve.mu / curve.mu_best - share))]
        assert rows(altered(robot, q_home=q))["mu at home"].verdict == judged


def test_distance_of_a_sliding_joint_from_its_limit_is_in_mm() -> None:
    rail = load_robot("lwr4_rail")
    row = rows(rail)["nearest limit"]
    room = min(rail.data.q_home[0] - rail.q_min[0], rail.q_max[0] - rail.data.q_home[0])
    assert f"joint_1 is {1e3 * room:.0f} mm away" in row.found
    assert " deg away" in row.found
    near = rail.data.q_home.copy()
    near[0] = rail.q_max[0] - 0.04
    row = rows(altered(rail, q_home=near))["nearest limit"]
    assert row.verdict == "care"
    assert "stops 50 mm before a limit: keep home.q_rad 80 mm away" in row.cure


def test_singular_home_has_verdict_cannot(robot: RobotModel) -> None:
    found = rows(altered(robot, q_home=np.zeros(7), v_max=np.full(7, 10.0), tau_max=np.full(7, 1.0)))
    assert verdict(list(found.values())) == "cannot"
    assert "singular" in found["freedoms left"].cure + found["singular values"].cure
    assert "task from home" not in found
    assert sum(row.verdict != "ok" for row in found.values()) >= 3
    assert all(bool(row.cure) == (row.verdict != "ok") for row in found.values())


def test_task_out_of_reach_has_verdict_care(robot: RobotModel) -> None:
    asked = Scenario(task={"path": "circle", "sizes": {"radius": 0.5}})
    row = rows(robot, asked)["task from home"]
    assert row.verdict == "care"
    assert row.cure.startswith("shrink the path, or move home.q_rad: ")


@pytest.mark.parametrize("factor", [0.9, 8.0])
def test_gains_that_cause_oscillation_have_verdict_cannot(robot: RobotModel, factor: float) -> None:
    """A run without friction completes unless the verdict is "cannot"."""
    gains = [factor * gain for gain in robot.data.gains["default"]["K_N2"]]  # type: ignore[union-attr]
    asked = Scenario(control={"K_N2": gains}, plant={"friction": 0.0}, bound_samples=0, judge=False)
    asked = asked.change(task={"path": "line", "sizes": {"length": 0.005}})
    found = next(row for row in check_robot(robot, asked) if row.what == "gains")
    assert (found.verdict == "cannot") == (run(asked).meta["ended"] != "completed") == (factor > 1.0)

"""Robot files: the lwr4 has its published numbers, and bad files are refused."""

from pathlib import Path

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import assume, given, settings

from moc_opt.errors import MocOptError, RobotError
from moc_opt.robots import load_data
from moc_opt.robots.urdf import FARTHEST, SMALLEST, Joint, Link, Urdf, inertia_fault, normalize, read
from tests.robots.arms import FOLDER, changed, joint, link, text_of

URDF = text_of("lwr4")
TOML = (FOLDER / "lwr4.toml").read_text(encoding="utf-8")
UNLIMITED = TOML[: TOML.index("[limits]")] + TOML[TOML.index("[joints]") :]


def write(folder: Path, toml: str = TOML, urdf: str = URDF) -> Path:
    (folder / "lwr4.urdf").write_text(urdf, encoding="utf-8")
    path = folder / "my_arm.toml"
    path.write_text(toml, encoding="utf-8")
    return path


def test_lwr4_has_the_published_numbers() -> None:
    data = load_data("lwr4")
    np.testing.assert_allclose(np.degrees(data.q_max), [170, 120, 170, 120, 170, 120, 170])
    np.testing.assert_array_equal(data.q_min, -data.q_max)
    np.testing.assert_allclose(np.degrees(data.v_max), [110, 110, 128, 128, 204, 184, 184])
    np.testing.assert_array_equal(data.tau_max, [176, 176, 100, 100, 100, 38, 38])
    np.testing.assert_array_equal(data.rotor_inertia, np.full(7, 0.2))
    assert (data.tool_length, data.tool_mass) == (0.30, 0.3)
    masses = [body.mass for body in read(data.urdf).links if body.mass]
    assert masses == [2.0, 2.7, 2.7, 2.7, 2.7, 1.7, 1.1, 0.25, 0.3]
    with pytest.raises(ValueError, match="read-only"):
        data.q_home[0] = 1.0


def test_limits_of_toml_replace_those_of_urdf(tmp_path: Path) -> None:
    data = load_data(write(tmp_path, changed(TOML, ("q_max_deg = [170, 120", "q_max_deg = [150, 120"))))
    first = read(data.urdf).joints[0]
    assert first.limits["upper"] == data.q_max[0] == pytest.approx(np.radians(150))
    urdf_only, original = load_data(write(tmp_path, UNLIMITED)), load_data()
    for name in ("q_min", "q_max", "v_max", "tau_max"):
        np.testing.assert_allclose(getattr(urdf_only, name), getattr(original, name), rtol=1e-12)
    urdf = URDF.replace(' velocity="1.9198621771937625"', "")
    with pytest.raises(RobotError, match=r"v_max: joints \['joint_1', 'joint_2'\].*limits\.v_max_deg_per_s"):
        load_data(write(tmp_path, UNLIMITED, urdf))


@pytest.mark.parametrize(("length", "mass"), [(0.30, 0.3), (0.45, 0.8)])
def test_tool_is_a_slender_rod_on_the_flange(length: float, mass: float) -> None:
    arm = read(load_data(tool_length=length, tool_mass=mass).urdf)
    rod, joints = arm.links[-3], {each.name: each for each in arm.joints}
    assert (rod.name, rod.mass, rod.xyz) == ("tool", mass, (0.0, 0.0, length / 2))
    assert rod.moments[0] == rod.moments[1] == pytest.approx(mass * length**2 / 12, rel=1e-3)
    assert 0 < rod.moments[2] < 0.01 * rod.moments[0]
    for name, z in (("tool_mount", 0.0), ("tip_frame", length), ("wrist_frame", -0.078)):
        assert (joints[name].parent, joints[name].xyz) == ("link_7", (0.0, 0.0, z))


def test_robot_is_loaded_by_its_path(tmp_path: Path) -> None:
    path = write(tmp_path)
    (tmp_path / "lwr4.toml").write_text(TOML, encoding="utf-8")
    expected = load_data("lwr4").urdf
    for asked in (path, str(path), tmp_path / "lwr4.toml", tmp_path / "lwr4.urdf"):
        assert load_data(asked).urdf == expected


def test_missing_file_or_robot_is_named(tmp_path: Path) -> None:
    gone = write(tmp_path, changed(TOML, ('"lwr4.urdf"', '"gone.urdf"')))
    for asked, told in (
        ("lwr", "unknown robot .*'lwr': did you mean 'lwr4'"), (tmp_path / "none.toml", r"none\.toml.*no such file"),
        (tmp_path / "none.urdf", r"none\.toml.*does not exist"), (tmp_path / "none.xml", "unknown robot .or TOML"),
        (gone, r"urdf .*gone\.urdf.*no such file"),
    ):  # fmt: skip
        with pytest.raises(MocOptError, match=told):
            load_data(asked)


BAD_TOML = {
    "unknown key": ("last_link", "last_lnk = 1\nlast_link", r"\[frames\] key 'last_lnk': did you mean 'last_link'"),
    "no such link": ('"link_7"', '"link_9"', r"\(frames\.last_link\) 'link_9': did you mean.*link_7"),
    "wrist off the shaft": ("[0.0, 0.0, -0.078]", "[0.0, 0.01, -0.078]", r"wrist_xyz_m.*0\.01 m off"),
    "link name with a backslash": ('"link_7"', '"a\\\\"', r"\[frames\] last_link = .*is no name"),
    "short vector": ("tau_max_Nm = [176, ", "tau_max_Nm = [", r"limits\.tau_max_Nm has 6 entries.*give 7"),
    "limits reversed": ("q_min_deg = [-170", "q_min_deg = [171", "joint_1.*is not below"),
    "zero speed": ("v_max_deg_per_s = [110", "v_max_deg_per_s = [0", "v_max of joint 'joint_1' = 0"),
    "home outside its limits": ("q_rad = [0.595", "q_rad = [3.5", r"home\.q_rad.*\[1\]"),
}


START = URDF.index("<inertial>", URDF.index('<link name="link_6">'))
BODY_6 = URDF[START : URDF.index("</inertial>", START) + len("</inertial>")]
BAD_URDF = {
    "no mass to move": (f'<link name="link_6">\n    {BODY_6}', '<link name="link_6">', "joint_6.*moves no mass"),
    "not XML": ("</robot>", "", "not well-formed"),
    "planar joint": ('"joint_3" type="revolute"', '"joint_3" type="planar"', "joint_3.*'planar'"),
    "loop": ('<parent link="link_0"/>', '<parent link="link_7"/>', "loop"),
    "branch": ("</robot>", link("x") + joint("side", "revolute", "link_1", "x") + "</robot>", "'side' moves"),
    "mimic": ('<child link="link_4"/>', '<child link="link_4"/><mimic joint="joint_1"/>', "mimics"),
    "zero mass": ('<mass value="1.7"/>', '<mass value="0"/>', "link_5.*mass is 0 kg"),
    "mass not a number": ('<mass value="1.7"/>', '<mass value="heavy"/>', "mass of link 'link_5' is 'heavy'"),
    "impossible inertia": ('ixx="0.010753"', 'ixx="0.030753"', "link_5.*none may exceed"),
    "two links with one name": ('<link name="link_0">', '<link name="link_5"/><link name="link_0">', "2 links named"),
    "link without a joint": ("</robot>", '<link name="spare"/></robot>', "spare.*hang on no joint"),
    "no such parent": ('<parent link="link_3"/>', '<parent link="link_33"/>', "joint_4.*names link 'link_33'"),
    "no direction": ('<axis xyz="0 0 1"/>', '<axis xyz="0 0 0"/>', "joint_1.*give a direction"),
    "degrees for metres": ('"joint_1" type="revolute"', '"joint_1" type="prismatic"', r"limits\.q_min_deg is in deg"),
    "infinite limit": ('lower="-', 'lower="-inf" x="-', r"<limit> of joint 'joint_1', lower is -inf"),
    "two limits": ('<axis xyz="0 0 1"/>', '<axis xyz="0 0 1"/><limit effort="1"/>', "joint_1.*2 <limit>"),
    "too many links": ("</robot>", "".join(f'<link name="l{k}"/>' for k in range(250)) + "</robot>", "250 at most"),
    "name taken": ('<link name="link_0">', '<link name="tip"/><link name="link_0">', "has links.*tip"),
}


@pytest.mark.parametrize("case", [*BAD_TOML, *BAD_URDF])
def test_mistake_in_a_robot_file_is_named(case: str, tmp_path: Path) -> None:
    *pair, told = (BAD_TOML | BAD_URDF)[case]
    toml, urdf = (changed(TOML, pair), URDF) if case in BAD_TOML else (TOML, changed(URDF, pair))
    with pytest.raises(MocOptError, match=told):
        load_data(write(tmp_path, toml, urdf))


def test_only_the_base_may_be_called_world(tmp_path: Path) -> None:
    assert load_data(write(tmp_path, urdf=URDF.replace('"link_0"', '"world"'))).n == 7
    with pytest.raises(RobotError, match=r"joint_3.*a link 'world'.*rename the link"):
        load_data(write(tmp_path, urdf=URDF.replace('"link_3"', '"world"')))


@pytest.mark.parametrize("bad", [-0.1, 5e-4, float("nan"), float("inf"), "long"])
def test_bad_tool_arguments_are_named(bad: float) -> None:
    with pytest.raises(RobotError, match="length"):
        load_data(tool_length=bad)
    with pytest.raises(RobotError, match="mass_kg"):
        load_data(tool_mass=bad)


@pytest.mark.parametrize("text", [
    "", "0 0", "0 0 0 0", "0,0,0",
    *(f"0 0 {bad}" for bad in ("0x10", "nan", "inf", "1,5", "1e", "-101", "1e999", "1_0", "\u0663.0")),
])  # fmt: skip
def test_bad_xyz_text_of_an_origin_is_refused(text):
    origin = '<joint name="j"><parent link="a"/><child link="b"/><origin xyz="{}"/></joint>'
    assert read(f'<robot name="x">{origin.format(f"{FARTHEST} 0 -1e-31")}</robot>').joints[0].xyz == (100.0, 0.0, 0.0)
    with pytest.raises(RobotError, match=r"<origin> of joint 'j', xyz is '.*give three decimal numbers"):
        read(f'<robot name="x">{origin.format(text)}</robot>')


numbers = st.floats(-100.0, 100.0).filter(lambda x: x == 0.0 or abs(x) >= SMALLEST)
triples = st.tuples(numbers, numbers, numbers)
limits = st.dictionaries(st.sampled_from(["lower", "upper", "velocity", "effort"]), numbers)
moments = st.tuples(*[numbers] * 6)


@given(triples, triples, triples, limits, st.floats(1e-30, 100.0), moments)
@settings(max_examples=60)
def test_a_urdf_that_was_written_is_read_back_to_the_last_bit(xyz, rpy, axis, limit, mass, moments):
    links = [Link("a"), Link("b", mass, moments, xyz, rpy)]
    arm = Urdf(links, [Joint("j", "revolute", "a", "b", rpy, xyz, axis, limit)])
    assert read(arm.to_text("arm")) == arm


@given(st.lists(st.floats(1e-6, 1.0), min_size=3, max_size=3), st.integers(0, 2**32 - 1))
@settings(max_examples=100)
def test_the_verdict_on_an_inertia_does_not_depend_on_its_axes(moments, seed):
    a, b, c = sorted(moments)
    assume(abs(a + b - c) > 1e-4 * c)
    Q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    for sign, wrong in ((1.0, a + b < c), (-1.0, True)):
        tensor = Q @ np.diag([a, b, sign * c]) @ Q.T
        fault = inertia_fault((*np.diag(tensor), *tensor[[0, 0, 1], [1, 2, 2]]))
        assert (fault is not None) == wrong


def test_urdf_parts_that_moc_opt_does_not_read_are_dropped():
    text = load_data().urdf
    more = text.replace("<link", '<gazebo secret="1"/><link', 1).replace(
        "</inertial>", "<density/></inertial><visual><geometry><mesh filename='/etc/passwd'/></geometry></visual>"
    )
    more = more.replace("<axis", '<dynamics damping="9" friction="9"/><safety_controller/><axis')
    assert more.count("dynamics") == 7
    assert read(more).to_text("lwr4") == text


@pytest.mark.parametrize("axis", ["0 0 2", "0.7 0.7 0", "1e-2 0 0"])
def test_axis_is_scaled_to_length_one(axis):
    arm = read(load_data().urdf.replace('<axis xyz="0.0 0.0 1.0"', f'<axis xyz="{axis}"', 1))
    normalize(arm)
    assert np.linalg.norm(arm.joints[0].axis) == pytest.approx(1.0, rel=1e-15)
    np.testing.assert_allclose(np.cross(arm.joints[0].axis, [float(x) for x in axis.split()]), 0.0, atol=1e-15)

"""Numbers of a URDF, the text that is written from them, and the inertias that a body can have."""

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import assume, given, settings

from moc_opt.errors import RobotError
from moc_opt.robots import load_data
from moc_opt.robots.urdf import LARGEST, Joint, Link, Urdf, inertia_fault, normalize, read


@pytest.mark.parametrize("text", [
    "", "0 0", "0 0 0 0", "0,0,0",
    *(f"0 0 {bad}" for bad in ("0x10", "nan", "inf", "1,5", "1e", "-1000001", "1e999", "1_0", "\u0663.0")),
])  # fmt: skip
def test_what_is_no_number_of_an_arm_is_refused(text):
    origin = '<joint name="j"><parent link="a"/><child link="b"/><origin xyz="{}"/></joint>'
    assert read(f'<robot name="x">{origin.format(f"{LARGEST} 0 -1e-31")}</robot>').joints[0].xyz == (1e6, 0.0, -1e-31)
    with pytest.raises(RobotError, match=r"<origin> of joint 'j', xyz is '.*give three decimal numbers"):
        read(f'<robot name="x">{origin.format(text)}</robot>')


numbers = st.floats(-100.0, 100.0)
triples = st.tuples(numbers, numbers, numbers)
limits = st.dictionaries(st.sampled_from(["lower", "upper", "velocity", "effort"]), numbers)
moments = st.tuples(*[numbers] * 6)


@given(triples, triples, triples, limits, st.floats(1e-30, 100.0), moments)
@settings(max_examples=60)
def test_what_is_written_is_read_back_to_the_bit(xyz, rpy, axis, limit, mass, moments):
    links = [Link("a"), Link("b", mass, moments, xyz, rpy)]
    arm = Urdf(links, [Joint("j", "revolute", "a", "b", rpy, xyz, axis, limit)])
    assert read(arm.to_text("arm")) == arm


points = st.lists(st.tuples(*[st.floats(-1.0, 1.0)] * 3, st.floats(0.01, 1.0)), min_size=4, max_size=9)


def in_order(tensor):
    return (*np.diag(tensor), tensor[0, 1], tensor[0, 2], tensor[1, 2])


@given(points)
@settings(max_examples=100)
def test_the_inertia_of_any_heap_of_masses_is_one_of_a_body(heap):
    """Built from its definition, the sum of m (|r|^2 1 - r r^T): no such tensor may be refused."""
    masses = np.array([m for *_, m in heap])
    r = np.array([xyz for *xyz, _ in heap])
    r -= np.average(r, axis=0, weights=masses)
    tensor = sum(m * (p @ p * np.eye(3) - np.outer(p, p)) for m, p in zip(masses, r, strict=True))
    assume(np.linalg.eigvalsh(tensor).min() > 1e-9)  # not all on one line
    assert inertia_fault(in_order(tensor)) is None


@given(st.lists(st.floats(1e-6, 1.0), min_size=3, max_size=3), st.integers(0, 2**32 - 1))
@settings(max_examples=100)
def test_the_verdict_is_that_of_the_principal_moments_in_any_axes(moments, seed):
    a, b, c = sorted(moments)
    assume(abs(a + b - c) > 1e-4 * c)
    Q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    for sign, wrong in ((1.0, a + b < c), (-1.0, True)):
        fault = inertia_fault(in_order(Q @ np.diag([a, b, sign * c]) @ Q.T))
        assert (fault is not None) == wrong


def test_only_what_was_read_is_written():
    """Shapes, extensions and unknown elements or attributes reach no engine."""
    text = load_data().urdf
    more = text.replace("<link", '<gazebo secret="1"/><link', 1).replace(
        "</inertial>", "<density/></inertial><visual><geometry><mesh filename='/etc/passwd'/></geometry></visual>"
    )
    more = more.replace("<axis", '<dynamics damping="9" friction="9"/><safety_controller/><axis')
    assert more.count("dynamics") == 7
    assert read(more).to_text("lwr4") == text


@pytest.mark.parametrize("axis", ["0 0 2", "0.7 0.7 0", "1e-2 0 0"])
def test_an_axis_has_length_one(axis):
    arm = read(load_data().urdf.replace('<axis xyz="0.0 0.0 1.0"', f'<axis xyz="{axis}"', 1))
    normalize(arm)
    assert np.linalg.norm(arm.joints[0].axis) == pytest.approx(1.0, rel=1e-15)
    np.testing.assert_allclose(np.cross(arm.joints[0].axis, [float(x) for x in axis.split()]), 0.0, atol=1e-15)

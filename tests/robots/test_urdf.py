"""Numbers of a URDF, the text that is written from them, and the inertias that a body can have."""

import xml.etree.ElementTree as ET

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import assume, given, settings

from moc_opt.errors import RobotError
from moc_opt.robots import load_data
from moc_opt.robots.urdf import LARGEST, SMALLEST, as_text, inertia_fault, number, rebuild, triple


@pytest.mark.parametrize("text", ["", " ", "0x10", "nan", "inf", "1,5", "1e", "1 2", "101", "-100.1", "1e999"])
def test_what_is_no_number_or_no_length_is_refused(text):
    with pytest.raises(RobotError, match="urdf: x of link 'a' is "):
        number(text, "x of link 'a'", "m")


def test_a_number_of_rounding_is_zero():
    assert number("1e-31", "x", "m") == 0.0 == number("-4.9e-324", "x", "m")


@given(st.floats(-100.0, 100.0).filter(lambda x: x == 0.0 or abs(x) >= SMALLEST))
@settings(max_examples=300, derandomize=True)
def test_what_is_written_is_read_back_to_the_bit(value):
    assert number(as_text(value), "x", "m") == value
    assert triple(ET.Element("origin", xyz=as_text(value, 1.0, -value)), "xyz", "x", "m") == (value, 1.0, -value)


@pytest.mark.parametrize("text", ["", "0 0", "0 0 0 0", "0,0,0"])
def test_three_numbers_are_three(text):
    with pytest.raises(RobotError, match=r"x is .*: write three numbers"):
        triple(ET.Element("origin", rpy=text), "rpy", "x", "rad")
    assert triple(ET.Element("origin"), "rpy", "x", "rad") == (0.0, 0.0, 0.0)


def test_sizes_have_limits():
    for unit, most in LARGEST.items():
        assert number(repr(most), "x", unit) == most
        with pytest.raises(RobotError, match="give a finite decimal number"):
            number(repr(1.01 * most), "x", unit)


points = st.lists(st.tuples(*[st.floats(-1.0, 1.0)] * 3, st.floats(0.01, 1.0)), min_size=4, max_size=9)


@given(points)
@settings(max_examples=300, derandomize=True)
def test_the_inertia_of_any_heap_of_masses_is_one_of_a_body(heap):
    """Built from its definition, the sum of m (|r|^2 1 - r r^T): no such tensor may be refused."""
    masses = np.array([m for *_, m in heap])
    r = np.array([xyz for *xyz, _ in heap])
    r -= np.average(r, axis=0, weights=masses)
    tensor = sum(m * (p @ p * np.eye(3) - np.outer(p, p)) for m, p in zip(masses, r, strict=True))
    assume(np.linalg.eigvalsh(tensor).min() > 1e-9)  # not all on one line
    assert inertia_fault((tensor[0, 0], tensor[1, 1], tensor[2, 2], tensor[0, 1], tensor[0, 2], tensor[1, 2])) is None


@given(st.lists(st.floats(1e-6, 1.0), min_size=3, max_size=3), st.integers(0, 2**32 - 1))
@settings(max_examples=300, derandomize=True)
def test_the_verdict_is_that_of_the_principal_moments_in_any_axes(moments, seed):
    a, b, c = sorted(moments)
    assume(abs(a + b - c) > 1e-4 * c)
    Q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    for sign, wrong in ((1.0, a + b < c), (-1.0, True)):
        I = Q @ np.diag([a, b, sign * c]) @ Q.T  # noqa: E741
        fault = inertia_fault((I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2]))
        assert (fault is not None) == wrong
        if sign < 0.0:
            assert "not positive definite" in fault


def test_only_what_was_read_is_written():
    """Shapes, extensions and unknown elements or attributes reach no engine."""
    data = load_data()
    text = data.urdf.replace("<link", '<gazebo secret="1"/><link', 1).replace(
        "</inertial>", "<density/></inertial><visual><geometry><mesh filename='/etc/passwd'/></geometry></visual>"
    )
    text = text.replace("<axis", '<dynamics damping="9" friction="9"/><safety_controller/><axis')
    root = ET.fromstring(text)
    again = rebuild(root, "lwr4")
    assert {e.tag for e in again.iter()} == {
        "robot", "link", "joint", "inertial", "origin", "mass", "inertia", "parent", "child", "axis", "limit",
    }  # fmt: skip
    assert {key for e in again.iter() for key in e.attrib} == {
        "name", "type", "link", "xyz", "rpy", "value", "ixx", "iyy", "izz", "ixy", "ixz", "iyz", "lower", "upper",
        "velocity", "effort",
    }  # fmt: skip
    ours = rebuild(ET.fromstring(data.urdf), "lwr4")
    assert ET.tostring(again) == ET.tostring(ours)


@pytest.mark.parametrize(("axis", "length"), [("0 0 2", 1.0), ("0.7 0.7 0", 1.0), ("1e-2 0 0", 1.0)])
def test_an_axis_has_length_one(axis, length):
    text = load_data().urdf.replace('<axis xyz="0.0 0.0 1.0"', f'<axis xyz="{axis}"', 1)
    root = rebuild(ET.fromstring(text), "lwr4")
    written = [float(x) for x in root.find("joint/axis").get("xyz").split()]
    assert np.linalg.norm(written) == pytest.approx(length, rel=1e-15)

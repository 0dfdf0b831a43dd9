"""Mass properties: frames are merged, bodies that cannot be become possible, possible ones stay as they are."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import pytest
from hypothesis import given
from hypothesis import strategies as st

from moc_opt.commissioning.bodies import mend
from moc_opt.robots.rebuild import inertia_fault
from tests.commissioning.arms import link, text_of

KEYS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")


def moments(root: ET.Element) -> list[float]:
    inertia = root.find("link/inertial/inertia")
    assert inertia is not None
    return [float(inertia.get(key, "")) for key in KEYS]


def test_possible_bodies_stay_as_they_are() -> None:
    root = ET.fromstring(text_of())
    before = ET.tostring(root)
    notes: list[str] = []
    mend(root, notes)
    assert ET.tostring(root) == before
    assert notes == []


def test_a_link_without_mass_is_a_frame() -> None:
    root, notes = ET.fromstring(f"<robot>{link('f', 0.0, 0.1)}</robot>"), []
    mend(root, notes)
    assert root.find("link/inertial") is None
    assert "frames without mass" in notes[0]
    assert "f" in notes[0]


def test_a_link_without_inertia_gets_that_of_a_ball() -> None:
    root, notes = ET.fromstring(f"<robot>{link('f', 1.0, 0.0)}</robot>"), []
    mend(root, notes)
    ball = 0.4 * (3.0 / (4.0 * 3.141592653589793 * 1000.0)) ** (2.0 / 3.0)
    assert moments(root)[:3] == pytest.approx([ball] * 3)
    assert "'f' (1 kg) has no inertia" in notes[0]


@given(st.tuples(*[st.floats(-0.1, 0.1)] * 6).filter(lambda given: max(map(abs, given)) > 1e-9))
def test_any_inertia_becomes_one_that_a_body_may_have(given: tuple[float, ...]) -> None:
    text = " ".join(
        f'{key}="{value!r}"'
        for key, value in zip(KEYS, given, strict=True)
        if abs(value) > 1e-30 or value == 0
    )
    root = ET.fromstring(
        f'<robot><link name="a"><inertial><mass value="1"/><inertia {text}/></inertial></link></robot>'
    )
    notes: list[str] = []
    mend(root, notes)
    after = [float(root.find("link/inertial/inertia").get(key, "0")) for key in KEYS]  # type: ignore[union-attr]
    assert inertia_fault(after) is None
    assert (notes == []) == (inertia_fault([v if abs(v) > 1e-30 else 0.0 for v in given]) is None)

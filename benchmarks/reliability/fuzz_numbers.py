"""Numbers of a URDF as no reader agrees on them: one arm for both engines, or a refusal."""

from __future__ import annotations

import math
import re
from xml.sax.saxutils import quoteattr

import hypothesis.strategies as st
import numpy as np

from benchmarks.reliability import fuzz_case
from benchmarks.reliability.fuzz_case import ARM_URDF, Kind, Verdict, Wrong, refused
from moc_opt.errors import RobotError
from moc_opt.model.robot_model import load_robot
from moc_opt.scenario.agreement import check_engines
from moc_opt.sim.plant import Plant

NUMBER = re.compile(r'\b(xyz|rpy|value|i[xyz]{2}|lower|upper|velocity|effort)="([^"]*)"')
SPOTS = [found.span(2) for found in NUMBER.finditer(ARM_URDF)]

odd = st.sampled_from([
    "", " ", "0x1p-2", "0x10", "1_0", "nan", "-nan", "nan(0x1)", "inf", "1e999", "-1e999", "1e-310", "4.9e-324",
    "1e-31", "0 0", "1,5", "1d-1", ".5", "5.", "+.1", "1E-2", "-0", "0.1f", "1e", "e5", "infinity", "0b1", "1e+01",
    "--1", "1e1e1", "٣", "1e300", "1" * 70, "0." + "0" * 40 + "1", "\xa00.1", "1\x0b2", "0.1;", "${x}", "pi/2",
    "1/2", "0.1\t", "\n0.2",
])  # fmt: skip
fair = st.one_of(
    st.floats(-1.0, 1.0).map(repr), st.floats(1e-6, 10.0).map(repr), st.floats(-7.0, 7.0).map("{:.3e}".format)
)
texts = st.lists(st.one_of(odd, fair, fair), min_size=0, max_size=4).map(" ".join)
three = st.lists(fair, min_size=3, max_size=3).map(" ".join)

urdf_numbers = st.lists(
    st.tuples(st.sampled_from(SPOTS), st.one_of(fair, odd, texts, three)),
    min_size=1, max_size=3, unique_by=lambda change: change[0],
)  # fmt: skip
"""Places in the arm's URDF, and what is written there."""


def urdf_number(case: list[tuple[tuple[int, int], str]]) -> Verdict:
    """Check an arm with these numbers: refused with the link or joint named, or one and the same in both engines."""
    urdf = ARM_URDF
    for (start, end), text in sorted(case, reverse=True):
        urdf = urdf[: start - 1] + quoteattr(text) + urdf[end + 1 :]
    with fuzz_case.arm(urdf=urdf) as path:
        try:
            arm = load_robot(path)
        except RobotError as error:
            return refused(error, bool(re.search(r"link_\d|joint_\d|frames coincide|not well-formed", str(error))))
    for (start, _), text in case:
        before = ARM_URDF[:start]
        limits = before.rfind("<limit") > before.rfind(">")  # the TOML's stand in their place, unread
        if not limits and not all(_plain(part) for part in text.split(" ")):
            raise Wrong(f"{text!r} was taken for a number")
    check_engines(arm)
    state = arm.state(arm.data.q_home)
    if not (np.isfinite(state.h).all() and np.linalg.eigvalsh(state.M).min() > 0.0):
        raise Wrong("h is not finite or M not positive definite")
    Plant(arm.data).step(arm.gravity(arm.data.q_home))
    return "accepted"


def _plain(text: str) -> bool:
    """Return a decimal number as every reader takes it; the white space around it is XML's."""
    text = text.strip("\t\n\r")
    return text == "" or (set(text) <= set("0123456789+-.eE") and math.isfinite(float(text)))


KINDS = {"urdf_number": Kind(urdf_number, urdf_numbers)}

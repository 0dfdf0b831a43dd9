"""Hostile input, and the outcomes that are allowed for it."""

import contextlib
import signal

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import HealthCheck, event, settings

from moc_opt.errors import MocOptError

LONGEST_S = 600
"""Time limit for one input, long enough to compile C."""


def many(share=1.0):
    """Return Hypothesis settings with `share` times as many examples as in the active profile."""
    slow = (HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.function_scoped_fixture)
    return settings(max_examples=max(10, round(share * settings().max_examples)), suppress_health_check=slow)


@contextlib.contextmanager
def ends_well(*named):
    """Allow success, or a MocOptError. If `named` is not empty, the error's message must contain one of its entries."""

    def ring(number, frame):
        pytest.fail(f"no end after {LONGEST_S} s")

    before = signal.signal(signal.SIGALRM, ring)
    signal.alarm(LONGEST_S)
    try:
        with np.errstate(all="ignore"):  # 1e300 may overflow
            yield
    except MocOptError as refusal:
        said = str(refusal)
    else:
        said = ""
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
    event("refused" if said else "taken")
    if said:
        assert 15 <= len(said) <= 2000
        assert not named or any(repr(name)[1:-1] in said for name in named)


numbers = st.one_of(
    st.sampled_from([
        0, -1, 1, 2, 1e-300, -1e-300, 1e300, -1e300, 5e-324, 1e308, 1e30, 1e-30, 1e-9, 1e9, 0.5, 2**53, 2**63,
        -(2**63), 2**63 - 1, 10**7, 10**40, float("nan"), float("inf"), float("-inf"),
    ]),
    st.floats(-10.0, 10.0), st.integers(-5, 100),
)  # fmt: skip
texts = st.one_of(
    st.sampled_from([
        "", "nan", "../../x", "/etc/passwd", "\x00", "lwr4", "osqp", "exact", "circle", "tuned", "moc", "a" * 5000,
        "💥", "random", "__class__", "{0.__class__}", "%s%n", "qpsolvers:nobody", "../lwr4.toml", ".urdf", "x.toml",
        "casadi:nobody", "true", "-", "con", "qpsolvers:", "casadi:",
    ]),
    st.text(max_size=12),
)  # fmt: skip
junk = st.recursive(
    st.one_of(st.none(), st.booleans(), numbers, texts),
    lambda inner: st.one_of(st.lists(inner, max_size=4), st.dictionaries(texts, inner, max_size=3)),
    max_leaves=6,
)

pieces = st.sampled_from([
    "*/", "/*", "//", "*\\\n/", "*??/\n/", "??/", "\\", "\\\n", "\n", "\r", "\x0b", "\x00", '"', "'", "<", ">", "&",
    "<script>alert(1)</script>", "</script>", "<img src=x onerror=alert(1)>", "&lt;", "&#60;", "`", "$title", "${n}",
    "../", "..", "/", "..\\", "~", "system(0);", "#include </etc/passwd>", '_Pragma("x")', "\u2028", "\u202e", "é",
    "</td>", "%s", "joint", "link_1", "a", " ", ".", ":", "-", "+", "_", "1", "[red]", "\x1b[2J", "a" * 101,
])  # fmt: skip
names = st.one_of(
    st.lists(pieces, min_size=1, max_size=4).map("".join), st.text(max_size=8),
    st.from_regex(r"[A-Za-z0-9_ .:+/-]{1,12}", fullmatch=True),
)  # fmt: skip
"""Valid names, and texts that would break out of a comment, tag or folder."""


LINES = st.sampled_from(["", "<", "]", "[[robot]]", "</link>", '<link name="tip"/>', "\x00"])
ODD = st.one_of(
    numbers.map(repr), texts, texts.map(repr), st.sampled_from(["0 0 nan", "1e999 0 0", "0x1p-2", "[]", "{}"])
)


@st.composite
def edited(draw: st.DrawFn, text: str) -> bytes:
    """Return the text with a few lines, words or values changed, or random bytes instead."""
    kind = draw(st.integers(0, 9))
    if kind == 0:
        return draw(st.binary(max_size=200))
    if kind == 1:
        return draw(st.text(max_size=100)).encode("utf-8", "surrogatepass")
    lines = text.splitlines()
    for _ in range(draw(st.integers(1, 3))):
        place = draw(st.integers(0, len(lines) - 1))
        line, other, more, odd = lines[place], draw(LINES), draw(st.text(max_size=5)), draw(ODD)
        cut, quoted, valued = draw(st.integers(0, len(line))), line.split('"'), f"{line.partition('=')[0]}= {odd}"
        if len(quoted) >= 3 and "<" in line:  # an attribute of XML
            quoted[2 * draw(st.integers(0, (len(quoted) - 3) // 2)) + 1] = odd
            valued = '"'.join(quoted)
        new = [], [line, line], [line[:cut] + more + line[cut:]], [valued], [valued], [other]
        lines[place : place + 1] = draw(st.sampled_from(new))
        lines = lines or [""]
    return "\n".join(lines).encode("utf-8", "surrogatepass")

"""Input as strangers send it: valid files with a few things wrong, and nonsense."""

from __future__ import annotations

from functools import cache
from typing import Any

import hypothesis.strategies as st
import numpy as np
from hypothesis.extra.numpy import array_shapes, arrays
from pydantic import BaseModel

from benchmarks.reliability.fuzz_case import ARM_TOML, ARM_URDF
from moc_opt.scenario import Scenario

numbers = st.one_of(
    st.sampled_from([
        0, -1, 1, 2, 1e-300, -1e-300, 1e300, -1e300, 1e-9, 1e9, 0.5, 2**63, -(2**63), 10**40,
        float("nan"), float("inf"), float("-inf"),
    ]),
    st.floats(-10.0, 10.0),
    st.integers(-5, 100),
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


@cache
def fields(table: type[BaseModel] = Scenario) -> tuple[tuple[str, ...], ...]:
    """Return the dotted path of every field of a scenario, tables before what is in them."""
    found: list[tuple[str, ...]] = []
    for name, field in table.model_fields.items():
        found.append((name,))
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            found += [(name, *rest) for rest in fields(field.annotation)]
    return tuple(found)


# What many a field takes: without it hardly a case would come to its run.
usual = st.sampled_from([0.0, 1e-3, 0.02, 0.1, 0.5, 1.0, 2, True, False])


@st.composite
def scenarios(draw: st.DrawFn) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Draw a scenario as a table with one to three fields changed, and the names of these fields."""
    table: dict[str, Any] = {}
    names: list[str] = []
    for path in draw(st.lists(st.sampled_from(fields()), min_size=1, max_size=3, unique=True)):
        if draw(st.integers(0, 9)) == 0:
            path = (*path[:-1], draw(st.sampled_from(["typo", "", "seeds", "class", "duration", "model_config"])))
        inner = table
        for name in path[:-1]:
            inner = inner.setdefault(name, {})
            if not isinstance(inner, dict):
                break
        if isinstance(inner, dict):
            inner[path[-1]] = draw(st.one_of(usual, numbers, texts, junk))
            names += path
    return table, tuple(names)


TOML = """
name = "a run"
seed = 3
duration_s = 0.1
judge = true
[robot]
name = "lwr4"
tool_length_m = 0.3
[start]
swivel = 0.5
[trocar]
depth_m = 0.15
breathing_amplitude_m = 0.01
breathing_direction = [1.0, 0.0, 0.0]
[task]
path = "circle"
sizes = { radius = 0.03 }
[control]
preset = "tuned"
[control.supervisor]
hold_ticks = 5
[solver]
name = "osqp"
settings = { eps = 1e-8 }
[plant]
preset = "realistic"
delay_ticks = 2
[faults]
bump_N = 5.0
"""


@st.composite
def edited(draw: st.DrawFn, text: str) -> bytes:
    """Draw a text file with a few lines, words or bytes changed, doubled or taken out; or something else entirely."""
    kind = draw(st.integers(0, 9))
    if kind == 0:
        return draw(st.binary(max_size=200))
    if kind == 1:
        return draw(st.text(max_size=100)).encode("utf-8", "surrogatepass")
    if kind == 2:
        deep = draw(st.sampled_from([10, 500, 100_000]))
        pair = draw(st.sampled_from(["[]", "{}", '""', "<>"]))
        return (draw(st.sampled_from(["x = ", ""])) + pair[0] * deep + pair[1] * deep).encode()
    lines = text.splitlines()
    for _ in range(draw(st.integers(1, 3))):
        place = draw(st.integers(0, len(lines) - 1))
        line = lines[place]
        how = draw(st.integers(0, 5))
        if how == 0:
            del lines[place]
            lines = lines or [""]
        elif how == 1:
            lines.insert(place, line)
        elif how == 2:
            cut = draw(st.integers(0, len(line)))
            lines[place] = line[:cut] + draw(st.text(max_size=5)) + line[cut:]
        elif how in (3, 4) and "=" in line:
            # a value: after the first sign for TOML, within quotes for XML
            values = line.split('"')
            if len(values) >= 3 and "<" in line:
                values[2 * draw(st.integers(0, (len(values) - 3) // 2)) + 1] = draw(
                    st.one_of(numbers.map(str), texts, st.just("0 0 nan"), st.just("1e999 0 0"))
                )
                lines[place] = '"'.join(values)
            else:
                value = draw(st.one_of(numbers.map(str), texts.map(repr), st.just("[]"), st.just("{}")))
                lines[place] = f"{line.split('=', 1)[0]}= {value}"
        else:
            lines[place] = draw(st.sampled_from(["", "<", "]", "[[robot]]", "</link>", '<link name="tip"/>', "\x00"]))
    return "\n".join(lines).encode("utf-8", "surrogatepass")


@st.composite
def robot_files(draw: st.DrawFn) -> tuple[bytes, bytes]:
    """Draw TOML and URDF of an arm, one or both of them corrupted."""
    which = draw(st.integers(0, 2))
    return (
        draw(edited(ARM_TOML)) if which != 1 else ARM_TOML.encode(),
        draw(edited(ARM_URDF)) if which != 0 else ARM_URDF.encode(),
    )


SUBPROBLEM = (
    "J_tip", "J_wrist", "v_tip", "v_wrist", "grad_mu", "lower", "upper", "c0", "c1", "c2", "regularization", "q",
)  # fmt: skip


@st.composite
def subproblems(draw: st.DrawFn) -> dict[str, Any]:
    """Draw arguments of NullSpaceQP: random ones that fit, then some of them replaced."""
    n = draw(st.sampled_from([7, 7, 7, 6, 3, 1]))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    u = rng.normal(size=3)
    u /= np.linalg.norm(u)
    turn = rng.normal(size=(3, n))
    J_tip = rng.normal(size=(3, n))
    J_wrist = J_tip + 0.4 * np.cross(turn.T, u).T  # tied, as tip and wrist of a rigid tool are
    x = rng.uniform(-1.0, 1.0, n)
    given: dict[str, Any] = {
        "J_tip": J_tip, "J_wrist": J_wrist, "v_tip": J_tip @ x, "v_wrist": J_wrist @ x, "grad_mu": rng.normal(size=n),
        "lower": np.full(n, -2.0), "upper": np.full(n, 2.0),
    }  # fmt: skip
    hostile = arrays(
        np.float64, array_shapes(max_dims=3, max_side=8), elements=st.floats(allow_nan=True, allow_infinity=True)
    )
    for name in draw(st.lists(st.sampled_from(SUBPROBLEM), max_size=3, unique=True)):
        how = draw(st.integers(0, 4))
        if how == 0 or name not in given:
            given[name] = draw(st.one_of(numbers, junk, hostile))
        elif how == 1:
            given[name] = given[name] * draw(st.sampled_from([0.0, 1e-12, 1e12, 1e200, -1.0]))
        elif how == 2:
            given[name] = np.where(rng.uniform(size=given[name].shape) < 0.2, draw(numbers), given[name]).astype(object)
        elif how == 3:
            given[name] = given[name].tolist()
        else:
            given[name] = np.zeros_like(given[name])
    return given


record_files = st.one_of(edited('{"record": "{}", "crc": 0}'), edited('{"a": 1}'))

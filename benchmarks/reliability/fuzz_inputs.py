"""Input as strangers send it: valid files with a few things wrong, and nonsense."""

from __future__ import annotations

import io
from functools import cache
from pathlib import Path
from typing import Any

import hypothesis.strategies as st
import numpy as np
from hypothesis.extra.numpy import array_shapes, arrays
from pydantic import BaseModel

from benchmarks.reliability import fuzz_c
from moc_opt.scenario import Scenario
from moc_opt.trace.trace import Trace

ROBOTS = Path(__file__).resolve().parents[2] / "moc_opt" / "robots"

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
    """The dotted path of every field of a scenario, tables before what is in them."""
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
    """A scenario as a table with one to three fields changed, and the names of these fields."""
    table: dict[str, Any] = {}
    names: list[str] = []
    for path in draw(st.lists(st.sampled_from(fields()), min_size=1, max_size=3, unique=True)):
        if draw(st.integers(0, 9)) == 0:
            path = (
                *path[:-1],
                draw(st.sampled_from(["typo", "", "seeds", "class", "duration", "model_config"])),
            )
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
    """A text file with a few lines, words or bytes changed, doubled or taken out; or something else entirely."""
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
            lines[place] = draw(
                st.sampled_from(["", "<", "]", "[[robot]]", "</link>", '<link name="tip"/>', "\x00"])
            )
    return "\n".join(lines).encode("utf-8", "surrogatepass")


@st.composite
def robot_files(draw: st.DrawFn) -> tuple[bytes, bytes]:
    """TOML and URDF of an arm, one or both of them spoilt."""
    toml = (ROBOTS / "lwr4.toml").read_text(encoding="utf-8").replace('"lwr4.urdf"', '"arm.urdf"')
    urdf = (ROBOTS / "lwr4.urdf").read_text(encoding="utf-8")
    which = draw(st.integers(0, 2))
    return (
        draw(edited(toml)) if which != 1 else toml.encode(),
        draw(edited(urdf)) if which != 0 else urdf.encode(),
    )


SUBPROBLEM = (
    "J_tip",
    "J_wrist",
    "v_tip",
    "v_wrist",
    "grad_mu",
    "lower",
    "upper",
    "c0",
    "c1",
    "c2",
    "regularization",
    "q",
)


@st.composite
def subproblems(draw: st.DrawFn) -> dict[str, Any]:
    """Arguments of NullSpaceQP: random ones that fit, then some of them replaced."""
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
        np.float64,
        array_shapes(max_dims=3, max_side=8),
        elements=st.floats(allow_nan=True, allow_infinity=True),
    )
    for name in draw(st.lists(st.sampled_from(SUBPROBLEM), max_size=3, unique=True)):
        how = draw(st.integers(0, 4))
        if how == 0 or name not in given:
            given[name] = draw(st.one_of(numbers, junk, hostile))
        elif how == 1:
            given[name] = given[name] * draw(st.sampled_from([0.0, 1e-12, 1e12, 1e200, -1.0]))
        elif how == 2:
            given[name] = np.where(
                rng.uniform(size=given[name].shape) < 0.2, draw(numbers), given[name]
            ).astype(object)
        elif how == 3:
            given[name] = given[name].tolist()
        else:
            given[name] = np.zeros_like(given[name])
    return given


@cache
def good_trace() -> tuple[Trace, bytes]:
    """A small trace and its file."""
    rng = np.random.default_rng(0)
    trace = Trace(
        {
            "t_s": 0.002 * np.arange(20), "q_rad": rng.normal(size=(20, 7)), "mu": rng.uniform(size=20),
            "status": np.array(["solved", "infeasible"] * 10), "verified": rng.uniform(size=20) < 0.5,
            "iterations": np.arange(20, dtype=np.int32),
        },
        {"deadline_us": 2000.0, "scenario": {"name": "x"}, "ended": "completed"},
    )  # fmt: skip
    return trace, saved(trace)


def saved(trace: Trace) -> bytes:
    """The bytes of its file."""
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "trace.parquet")
        trace.save(file)
        return file.read_bytes()


@st.composite
def result_files(draw: st.DrawFn) -> bytes:
    """A trace's file with bytes changed, or a Parquet file of other columns and hostile metadata."""
    if draw(st.booleans()):
        data = bytearray(good_trace()[1])
        for _ in range(draw(st.integers(1, 4))):
            place = draw(st.integers(0, max(len(data) - 1, 0)))
            how = draw(st.integers(0, 3))
            if how == 0 and data:
                data[place] = draw(st.integers(0, 255))
            elif how == 1:
                del data[place : place + draw(st.integers(1, 50))]
            elif how == 2:
                data[place:place] = draw(st.binary(max_size=20))
            else:
                del data[place:]
        return bytes(data)
    return draw(foreign_tables())


@st.composite
def foreign_tables(draw: st.DrawFn) -> bytes:
    """A Parquet file that claims to be a trace."""
    import json

    import pyarrow as pa
    import pyarrow.parquet as pq

    rows = draw(st.integers(0, 4))
    columns = {
        "t_s": pa.array([0.1] * rows), "list": pa.array([[1.0]] * rows, pa.list_(pa.float64())),
        "fixed": pa.array([[1.0, 2.0]] * rows, pa.list_(pa.float64(), 2)), "bytes": pa.array([b"x"] * rows),
        "text": pa.array(["x"] * rows, pa.string()), "when": pa.array([1] * rows, pa.timestamp("ns")),
        "null": pa.array([None] * rows), "struct": pa.array([{"a": 1}] * rows, pa.struct([("a", pa.int64())])),
        "holes": pa.array([None if i else 1.0 for i in range(rows)], pa.float64()),
        "columns": pa.array([1.0] * rows), "__class__": pa.array([1.0] * rows), "q_rad": pa.array([1.0] * rows),
        "decimal": pa.array([1] * rows, pa.decimal128(30, 2)), "status": pa.array(["solved"] * rows),
    }  # fmt: skip
    names = draw(st.lists(st.sampled_from(sorted(columns)), min_size=1, max_size=4, unique=True))
    kinds = [
        "<f8",
        "|O",
        "<U9",
        "<U999999999",
        "|V8",
        "<M8[ns]",
        "|S4",
        "<f2",
        "<c16",
        "|b1",
        ">i4",
        "f8,i4",
        "junk",
        3,
        None,
    ]
    types = {name: draw(st.sampled_from(kinds)) for name in names}
    if draw(st.booleans()):
        types = {name: "<f8" for name in names}
    metadata = {
        b"moc_opt.trace.trace": draw(st.sampled_from([b"1", b"1", b"1", b"2", b"\xff"])),
        b"moc_opt.types": draw(st.sampled_from([json.dumps(types).encode(), b"[]", b"\xff", b"{}", b"[" * 100_000])),
        b"moc_opt.meta": draw(
            st.one_of(
                st.just(b"{}"), st.just(b'{"deadline_us": NaN}'), st.just(b"[" * 100_000), st.just(b'[["a", 1]]'),
                junk.map(lambda value: json.dumps(value).encode("utf-8", "surrogatepass")), st.binary(max_size=30),
            )
        ),
        **draw(st.dictionaries(st.binary(min_size=1, max_size=5), st.binary(max_size=20), max_size=2)),
    }  # fmt: skip
    table = pa.table({name: columns[name] for name in names}).replace_schema_metadata(metadata)
    sink = io.BytesIO()
    pq.write_table(table, sink)
    return sink.getvalue()


record_files = st.one_of(edited('{"record": "{}", "crc": 0}'), edited('{"a": 1}'))

STRATEGIES: dict[str, st.SearchStrategy[Any]] = {
    "scenario": scenarios(), "scenario_file": edited(TOML), "robot_file": robot_files(), "subproblem": subproblems(),
    "result_file": result_files(), "record_file": record_files, "exported": fuzz_c.cases,
}  # fmt: skip
"""Kind of input -> where cases come from."""

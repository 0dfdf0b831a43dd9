"""Files made to stop, fill or break their reader, and numbers at the ends of what a field can hold.

A case is drawn as a description; `fuzz_file_checks` makes the file and hands it to the reader.
"""

from __future__ import annotations

import io
import os
import struct
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import hypothesis.strategies as st
import numpy as np
from pydantic import BaseModel

from benchmarks.reliability.fuzz_inputs import TOML
from benchmarks.reliability.fuzz_traces import good_trace
from benchmarks.sweeps.config import Config as SweepConfig
from moc_opt.scenario import Scenario

READERS = (
    "scenario", "sweep", "study", "faults", "robot", "urdf", "trace", "replay_us", "testset", "plan", "part",
    "waypoints",
)  # fmt: skip
"""Whatever opens a file from outside; see `fuzz_file_checks.READ`."""


class HostileFile(NamedTuple):
    """What is to be made, and how large."""

    reader: str
    shape: str
    size: int
    seed: int


def _nothing(path: Path, case: HostileFile) -> None:
    pass


def _fifo(path: Path, case: HostileFile) -> None:
    os.mkfifo(path)


def _folder(path: Path, case: HostileFile) -> None:
    path.mkdir()


def _link(target: str) -> Callable[[Path, HostileFile], None]:
    return lambda path, case: path.symlink_to(target)


def _sparse(path: Path, case: HostileFile) -> None:
    with path.open("wb") as file:
        file.truncate(case.size * 2**20)


def _bytes(make: Callable[[HostileFile], bytes]) -> Callable[[Path, HostileFile], None]:
    def write(path: Path, case: HostileFile) -> None:
        path.write_bytes(make(case))

    return write


def _noise(case: HostileFile) -> bytes:
    return np.random.default_rng(case.seed).bytes(case.size)


def _nested_xml(case: HostileFile) -> bytes:
    return b"<robot>" + b"<link>" * case.size + b"</link>" * case.size + b"</robot>"


def _integer(base: str) -> Callable[[HostileFile], bytes]:
    return lambda case: f"seed = {base}{'7' * (5 + case.size)}\n".encode()


def _npy(case: HostileFile) -> bytes:
    """Return a header that promises more than there is."""
    rng = np.random.default_rng(case.seed)
    shape = tuple(int(n) for n in rng.integers(1, 10**6, int(rng.integers(1, 4))))
    sink = io.BytesIO()
    kind = str(rng.choice(["<f8", "<U1000", "|V8", "|O", "<U0"]))
    np.lib.format.write_array_header_1_0(sink, {"descr": kind, "fortran_order": False, "shape": shape})  # type: ignore[arg-type]
    return sink.getvalue() + b"\0" * case.size


def _points(case: HostileFile) -> bytes:
    """Return waypoints a step apart, some numbers of which an arm does not reach, or nothing does."""
    rng = np.random.default_rng(case.seed)
    points = rng.normal(0.0, 0.01, (1 + case.size % 100, 3)).astype(object)
    for _ in range(int(rng.integers(0, 4))):
        far = float(rng.choice([value for value in EXTREMES if isinstance(value, float)]))
        points[int(rng.integers(len(points))), int(rng.integers(3))] = far
    return "\n".join(",".join(map(repr, row)) for row in points.tolist()).encode()


def _constant_parquet(case: HostileFile) -> bytes:
    """Return a trace of so many rows of one value: a few hundred bytes."""
    import json

    import pyarrow as pa
    import pyarrow.parquet as pq

    rows = min(50 * case.size, 20_000_000)
    kinds = {"mu": pa.array(np.zeros(1)), "status": pa.array(["x" * min(case.size, 50_000)])}
    chosen = dict(list(kinds.items())[case.seed % 2 :])
    columns = {}
    step = max(1, min(rows, 200_000))  # the maker's own memory is limited, too
    for name, array in chosen.items():
        encoded = pa.DictionaryArray.from_arrays(pa.array(np.zeros(step, dtype=np.int32)), array)
        columns[name] = encoded if name == "status" else pa.array(np.zeros(step))
    types = {"mu": "<f8", "status": f"<U{case.size}"}
    meta = {"moc_opt.trace.trace": "1", "moc_opt.meta": "{}", "moc_opt.types": json.dumps(types, allow_nan=False)}
    sink = io.BytesIO()
    table = pa.table(columns).replace_schema_metadata(meta)
    with pq.ParquetWriter(sink, table.schema, compression="zstd") as writer:
        for _ in range(max(1, rows // step)):
            writer.write_table(table, row_group_size=step)
    return sink.getvalue()


def _trace_with_lies(case: HostileFile) -> bytes:
    """Return a trace whose footer has other numbers: rows, sizes, counts."""
    data, rng = bytearray(good_trace()[1]), np.random.default_rng(case.seed)
    length = struct.unpack("<I", data[-8:-4])[0]
    for _ in range(int(rng.integers(1, 6))):
        place = len(data) - 8 - int(rng.integers(0, length))
        new = rng.bytes(int(rng.integers(1, 6)))
        data[place : place + len(new)] = new
    return bytes(data)


SHAPES: dict[str, Callable[[Path, HostileFile], None]] = {
    "nothing": _nothing, "fifo": _fifo, "folder": _folder, "sparse": _sparse,
    "zeros without end": _link("/dev/zero"), "noise without end": _link("/dev/urandom"),
    "terminal": _link("/dev/tty"), "dangling link": _link("nowhere"), "link to itself": _link("file"),
    "kernel file": _link("/proc/kmsg"), "memory": _link("/proc/self/mem"),
    "noise": _bytes(_noise),
    "dotted key": _bytes(lambda c: b"a" + b".a" * c.size + b" = 1\n"),
    "dotted quotes": _bytes(lambda c: b'""' + b' . "a"' * c.size + b" = 1\n"),
    "dotted table": _bytes(lambda c: b"[a" + b".a" * c.size + b"]\nx = 1\n"),
    "tables": _bytes(lambda c: b"".join(b"[t%d]\n" % i for i in range(c.size))),
    "array of tables": _bytes(lambda c: b"[[robot]]\n" * c.size),
    "open brackets": _bytes(lambda c: b"seed = " + b"[" * c.size),
    "closed brackets": _bytes(lambda c: b"seed = " + b"[" * c.size + b"]" * c.size),
    "nested JSON": _bytes(lambda c: b'{"a":' * c.size + b"1" + b"}" * c.size),
    "no JSON": _bytes(lambda c: b'{"digest": NaN, "plan": ' + b"9" * c.size + b"}"),
    "long integer": _bytes(_integer("")), "long hexadecimal": _bytes(_integer("0x")),
    "long octal": _bytes(_integer("0o")),
    "long text": _bytes(lambda c: b'name = "' + b"x" * c.size + b'"\n'),
    "long key": _bytes(lambda c: b"x" * c.size + b" = 1\n"),
    "nested XML": _bytes(_nested_xml),
    "wide XML": _bytes(lambda c: b"<robot>" + b"<link/>" * c.size + b"</robot>"),
    "attributes": _bytes(lambda c: b"<robot " + b" ".join(b'a%d="1"' % i for i in range(c.size)) + b"></robot>"),
    "UTF-16": _bytes(lambda c: TOML.encode("utf-16")),
    "byte-order mark": _bytes(lambda c: b"\xef\xbb\xbf" + TOML.encode()),
    "points": _bytes(_points),
    "array header": _bytes(_npy), "constant trace": _bytes(_constant_parquet), "lying footer": _bytes(_trace_with_lies),
}  # fmt: skip
"""What the file is -> how it is made."""


@st.composite
def hostile_files(draw: st.DrawFn) -> HostileFile:
    """Draw a reader, and a file for it; half of them of a shape that is meant for this reader."""
    reader = draw(st.sampled_from(READERS))
    meant = {"trace": ("constant trace", "lying footer"), "urdf": ("nested XML", "wide XML", "attributes"),
             "replay_us": ("array header",), "testset": ("array header",), "part": ("array header", "noise"),
             "plan": ("nested JSON", "no JSON"), "waypoints": ("points",)}  # fmt: skip
    shape = draw(st.one_of(st.sampled_from(list(SHAPES)), st.sampled_from(meant.get(reader, tuple(SHAPES)))))
    size = draw(st.one_of(st.integers(0, 100), st.sampled_from([3000, 20_000, 100_000, 400_000])))
    return HostileFile(reader, shape, size, draw(st.integers(0, 2**32 - 1)))


EXTREMES = (
    1e308, -1e308, 1e300, 1e-300, -1e-300, 5e-324, 1e30, 1e-30, 1e18, 1e-18, 1e12, 1e10, 1e9, 1e7, 1e-9, 0.0,
    2**70, 2**64, 2**63, 2**63 - 1, -(2**63), 2**53, 10**9, 10**7, 10**18, 10**5000, -(10**5000), 0, -1, 1,
)  # fmt: skip


@cache
def number_fields(table: type[BaseModel]) -> tuple[tuple[str, ...], ...]:
    """Return the path of every field that takes a number."""
    found: list[tuple[str, ...]] = []
    for name, field in table.model_fields.items():
        inner = field.annotation
        if isinstance(inner, type) and issubclass(inner, BaseModel):
            found += [(name, *rest) for rest in number_fields(inner)]
        elif any(kind in str(inner) for kind in ("int", "float", "dict")):
            found.append((name,))
    return tuple(found)


@st.composite
def extreme_numbers(draw: st.DrawFn) -> tuple[str, tuple[tuple[tuple[str, ...], Any], ...]]:
    """Draw a configuration, and one or two of its numbers at an end of their range."""
    kind = draw(st.sampled_from(["scenario", "scenario", "sweep"]))
    table: type[BaseModel] = Scenario if kind == "scenario" else SweepConfig
    fields = [path for path in number_fields(table) if kind == "scenario" or path[0] != "scenario"]
    paths = draw(st.lists(st.sampled_from(fields), min_size=1, max_size=2, unique=True))
    wanted = []
    for path in paths:
        value: Any = draw(st.sampled_from(EXTREMES))
        if path == ("task", "sizes"):
            value = {"radius": value}
        elif path[-1] == "waypoints_m":
            value = [(0.01, 0.0, 0.0), (0.02, value, 0.0)]
        elif path[-1] == "settings":
            value = {draw(st.sampled_from(["eps", "max_iter", "x"])): value}
        elif path[-1] in ("grid", "fields"):
            ends = {"low": value, "high": draw(st.sampled_from(EXTREMES))}
            ends["scale"] = draw(st.sampled_from(["linear", "log", "integer"]))
            value = {"control.regularization": [value]} if path[-1] == "grid" else {"control.regularization": ends}
        elif draw(st.integers(0, 4)) == 0:
            value = [value] * draw(st.integers(1, 7))
        wanted.append((path, value))
    return kind, tuple(wanted)


class Damage(NamedTuple):
    """A file of a folder corrupted: which (modulo their number), how, where (a share of its length), and with what."""

    file: int
    how: str
    where: float
    bytes_: bytes


damages = st.lists(
    st.builds(
        Damage, st.integers(0, 1000),
        st.sampled_from(["flip", "cut", "delete", "replace", "empty", "insert", "folder"]),
        st.floats(0.0, 1.0), st.binary(min_size=1, max_size=8),
    ),
    min_size=1, max_size=4,
)  # fmt: skip

"""Files from outside: regular, measured before they are read, bounded in what they can ask for; JSON that is JSON."""

import errno
import io
import json
import os
import tomllib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from moc_opt.errors import MocOptError, ReportError, RobotError, ScenarioError, TraceError
from moc_opt.inputs.files import (
    read_arrays,
    read_bytes,
    read_json,
    read_toml,
    to_json,
    to_toml,
    write_whole,
)
from moc_opt.report.document import save_document
from moc_opt.robots.model import load_robot
from moc_opt.scenario import Scenario, Setup
from moc_opt.trace.trace import Trace


@pytest.mark.parametrize(
    ("load", "error"), [(Scenario.load, ScenarioError), (load_robot, RobotError), (Trace.load, TraceError)]
)
def test_every_reader_refuses_what_is_no_regular_file(load, error, tmp_path):
    for name, make in {
        "fifo.toml": os.mkfifo, "zeros.toml": lambda p: os.symlink("/dev/zero", p), "folder.toml": os.mkdir,
        "loop.toml": lambda p: os.symlink("loop.toml", p),
    }.items():  # fmt: skip
        make(tmp_path / name)
        with pytest.raises(error, match=name):
            load(tmp_path / name)


def test_no_writer_puts_a_file_in_the_place_of_a_pipe_or_device(tmp_path):
    """A rename would: `--trace /dev/null` would leave the machine without one."""
    made = Scenario(duration_s=0.02, bound_samples=0)
    trace = Setup(made).trace()
    os.mkfifo(tmp_path / "fifo")
    (tmp_path / "folder").mkdir()
    os.symlink("/dev/null", tmp_path / "null")
    for name in ("fifo", "folder", "null"):
        path = tmp_path / name
        before = os.lstat(path)
        with pytest.raises(TraceError, match=f"{name}.*a folder, pipe or device is there"):
            Setup(made).trace(lambda tick: pytest.fail("it ran first"), path)
        with pytest.raises(TraceError, match="pipe or device is there"):
            trace.save(path)
        with pytest.raises(ReportError, match="pipe or device is there"):
            save_document(path, "text", "page", str)
        after = os.lstat(path)  # its time of access may differ: links are followed
        assert (after.st_ino, after.st_mode, after.st_mtime_ns) == (before.st_ino, before.st_mode, before.st_mtime_ns)
    assert sorted(os.listdir(tmp_path)) == ["fifo", "folder", "null"]


def test_a_file_is_measured_before_it_is_read(tmp_path):
    with (tmp_path / "large").open("wb") as file:
        file.truncate(10 * 2**40)
    with pytest.raises(MocOptError, match=r"large.*10995116277760 bytes: 4194304 at most"):
        read_bytes(tmp_path / "large", "scenario", MocOptError)
    (tmp_path / "whole").write_bytes(b"x" * 100)
    assert read_bytes(tmp_path / "whole", "scenario", MocOptError, 100) == b"x" * 100
    with pytest.raises(MocOptError, match="99 at most"):
        read_bytes(tmp_path / "whole", "scenario", MocOptError, 99)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("a" + ".a" * 100_000 + " = 1", "dotted"), ("[a" + ' . "a"' * 100_000 + "]", "dotted"),
        ("a = " + "[" * 100_000, "deep"), ("a = " + "[" * 80 + "]" * 80, r"a\[0\].*deep"),
        ("seed = " + "9" * 5000, "not TOML"), ("seed = 0x" + "f" * 5000, "seed.*64 bits"),
        (f"[x]\ny = [1, {2**63}]", r"x\.y\[1\] = 9223372036854775808.*64 bits"), ("x = \ud800", "not UTF-8"),
    ],
)  # fmt: skip
def test_toml_that_asks_for_too_much_is_refused_by_name(text, why, tmp_path):
    (tmp_path / "s.toml").write_bytes(text.encode("utf-8", "surrogatepass"))
    with pytest.raises(ScenarioError, match=rf"s\.toml.*{why}"):
        read_toml(tmp_path / "s.toml", "scenario", ScenarioError)


@pytest.mark.parametrize("text", ["NaN", "[Infinity]", '{"a": -Infinity}', "[" * 100_000, "9" * 5000, "[1,", ""])
def test_what_is_no_json_is_refused(text, tmp_path):
    (tmp_path / "s.json").write_text(text)
    with pytest.raises(MocOptError, match=r"s\.json"):
        read_json(tmp_path / "s.json", "record", MocOptError)


leaves = st.integers() | st.floats() | st.text(max_size=3)


@given(st.recursive(leaves, lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner)))
def test_whatever_is_written_as_json_is_json(value):
    text = to_json({"value": value, "numpy": np.array([np.nan, np.inf, 1.0])})

    def never(name):
        raise AssertionError(name)

    assert json.loads(text, parse_constant=never)["numpy"] == [None, None, 1.0]


@pytest.mark.parametrize("shape", [(10**9,), (10**6, 10**6), (3,)])
@pytest.mark.parametrize("kind", ["<f8", "<U100000", "|O"])
def test_an_array_that_its_header_only_promises_is_refused(shape, kind, tmp_path):
    sink = io.BytesIO()
    np.lib.format.write_array_header_1_0(sink, {"descr": kind, "fortran_order": False, "shape": shape})
    (tmp_path / "a.npy").write_bytes(sink.getvalue())
    with pytest.raises(MocOptError, match=r"a\.npy.*damaged or no file of arrays"):
        read_arrays(tmp_path / "a.npy", "times", MocOptError)


def test_arrays_come_back_and_packed_ones_are_measured_first(tmp_path):
    np.savez_compressed(tmp_path / "b.npz", x=np.zeros(10_000), t=np.array(["a"]))
    found = read_arrays(tmp_path / "b.npz", "set", MocOptError, 100_000)
    assert (found["x"].shape, found["t"].tolist()) == ((10_000,), ["a"])
    with pytest.raises(MocOptError, match=r"b\.npz.*more than 50000 bytes"):
        read_arrays(tmp_path / "b.npz", "set", MocOptError, 50_000)


def test_a_file_is_written_whole_or_not_at_all(tmp_path, monkeypatch):
    path, other = tmp_path / "a", tmp_path / "other"
    write_whole(path, b"old")
    other.write_bytes(b"mine")
    (tmp_path / "link").symlink_to(other)
    write_whole(tmp_path / "link", b"new")  # in its place, not through it
    assert (other.read_bytes(), (tmp_path / "link").read_bytes()) == (b"mine", b"new")

    def full(handle):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left"):
        write_whole(path, b"new")
    assert path.read_bytes() == b"old"
    assert sorted(os.listdir(tmp_path)) == ["a", "link", "other"]


# --- TOML that is written ---

TEXT = st.text(st.characters(exclude_categories=["Cs"]), max_size=6)
VALUES = st.recursive(
    st.booleans() | st.integers(-(2**63), 2**63 - 1) | st.floats(allow_nan=False) | TEXT,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(TEXT, inner, max_size=3),
    max_leaves=8,
)


@given(st.dictionaries(TEXT, VALUES, max_size=4))
def test_toml_that_is_written_is_read_again(table):
    assert tomllib.loads(to_toml(table)) == table


def test_toml_has_numpys_values_as_numbers_and_no_none():
    assert tomllib.loads(to_toml({"a": np.float64(0.1), "b": np.arange(3)})) == {"a": 0.1, "b": [0, 1, 2]}
    with pytest.raises(TypeError, match=r"a\.b = None has no form in TOML"):
        to_toml({"a": {"b": None}})

"""Reading and writing of files."""

import errno
import io
import json
import os
import secrets
import tomllib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import moc_opt as mo
from moc_opt.errors import MocOptError, RobotError, ScenarioError, TraceError
from moc_opt.inputs import files
from moc_opt.inputs.files import decimal, read_bytes, read_toml, to_json, to_toml, write_whole
from moc_opt.scenario import Scenario
from moc_opt.scenario.setup import recorded_times
from moc_opt.trace.trace import Trace


@pytest.mark.parametrize(
    ("load", "error"), [(Scenario.load, ScenarioError), (mo.load_robot, RobotError), (Trace.load, TraceError)]
)
def test_every_reader_refuses_anything_but_a_regular_file(load, error, tmp_path):
    for name, make in {
        "fifo.toml": os.mkfifo, "zeros.toml": lambda p: os.symlink("/dev/zero", p), "folder.toml": os.mkdir,
        "loop.toml": lambda p: os.symlink("loop.toml", p), "none.toml": lambda p: None,
    }.items():  # fmt: skip
        make(tmp_path / name)
        with pytest.raises(error, match=name):
            load(tmp_path / name)


def test_file_size_is_checked_before_reading(tmp_path):
    with (tmp_path / "large").open("wb") as file:
        file.truncate(10 * 2**40)
    (tmp_path / "whole").write_bytes(b"x" * 100)
    assert read_bytes(tmp_path / "whole", "scenario", MocOptError, 100) == b"x" * 100
    for name, size, most in (("large", 10 * 2**40, 4 * 2**20), ("whole", 100, 99)):
        with pytest.raises(MocOptError, match=f"{name}.*{size} bytes: give a file of at most {most} bytes"):
            read_bytes(tmp_path / name, "scenario", MocOptError, most)


@pytest.mark.parametrize("text", ["a = " + "[" * 100_000, "seed = " + "9" * 5000, "x = \ud800", "x"])
def test_error_names_the_file_that_is_no_toml(text, tmp_path):
    (tmp_path / "s.toml").write_bytes(text.encode("utf-8", "surrogatepass"))
    with pytest.raises(ScenarioError, match=r"s\.toml.*(TOML|UTF-8)"):
        read_toml(tmp_path / "s.toml", "scenario", ScenarioError)


def header(shape, kind):
    sink = io.BytesIO()
    np.lib.format.write_array_header_1_0(sink, {"descr": kind, "fortran_order": False, "shape": shape})
    return sink.getvalue()


@pytest.mark.parametrize("data", [
    header((10**9,), "<f8"), header((10**6, 10**6), "<f8"), header((3,), "<f8"), header((3,), "|O"),
    header((3,), "<U100000"), b"\x93NUMPY\x01\x00\x10\x00secret:x:0 hello", b"secret:x:0:0:root\n",
    header((1,), "<U6") + "secret".encode("utf-32-le"),
])  # fmt: skip
def test_error_about_recorded_times_does_not_quote_their_file(data, tmp_path):
    """`replay_us` may name a secret file, or an array whose header claims terabytes."""
    (tmp_path / "a.npy").write_bytes(data)
    with pytest.raises(ScenarioError, match="replay_us") as found:
        recorded_times(Scenario(solver={"replay_us": str(tmp_path / "a.npy")}))
    assert "secret" not in str(found.value)


@pytest.mark.parametrize("text", ["0_1", "1_000.0", "\u0661", "\uff11", "inf", "nan", "0x1p2", "", "1.2.3", "- 1",
                                  "1" * 10**5 + "x"])  # fmt: skip
def test_text_that_is_no_decimal_number_gives_nan(text):
    assert np.isnan(decimal(text))


@given(st.floats(allow_nan=False, allow_infinity=False) | st.integers(-(10**20), 10**20))
def test_every_decimal_number_is_read(value):
    assert decimal(repr(value)) == float(value)


def test_file_is_unchanged_if_the_disk_is_full(tmp_path, monkeypatch):
    def full(handle):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    path = tmp_path / "file.parquet"
    path.write_bytes(b"old")
    with pytest.raises(MocOptError, match=r"file\.parquet.*No space left on device.*make room"):
        write_whole(path, "new")
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["file.parquet"]


def test_pipes_devices_and_folders_are_not_overwritten(tmp_path):
    other, link = tmp_path / "other", tmp_path / "link.parquet"
    other.write_bytes(b"mine")
    link.symlink_to(other)
    write_whole(link, b"new")
    assert (other.read_bytes(), link.read_bytes(), link.is_symlink()) == (b"mine", b"new", False)
    os.mkfifo(tmp_path / "fifo")
    (tmp_path / "folder").mkdir()
    os.symlink("/dev/null", tmp_path / "null")
    before = sorted(os.listdir(tmp_path))
    for taken in ("fifo", "folder", "null"):
        mode = os.lstat(tmp_path / taken).st_mode
        with pytest.raises(MocOptError, match=f"{taken}.*a folder, pipe or device is there"):
            write_whole(tmp_path / taken, b"new")
        assert os.lstat(tmp_path / taken).st_mode == mode
    assert sorted(os.listdir(tmp_path)) == before


def test_link_at_the_temporary_name_is_not_followed(tmp_path, monkeypatch):
    monkeypatch.setattr(secrets, "token_hex", lambda count: "0")  # as an attacker may guess
    victim = tmp_path / "victim"
    victim.write_bytes(b"mine")
    (tmp_path / ".a.0.tmp").symlink_to(victim)
    with pytest.raises(MocOptError, match="cannot be written"):
        write_whole(tmp_path / "a", b"new")
    assert victim.read_bytes() == b"mine"


@pytest.mark.parametrize("path", ["/proc/x", "/proc/no/such/x", "/dev/null/x", "a\0b", "x" * 300])
def test_error_names_the_folder_that_cannot_be_written(path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for work in (lambda: write_whole(path, b"new"), lambda: files.check_replaceable(path, "file", MocOptError)):
        with pytest.raises(MocOptError, match=r"cannot be written in the folder '/.*: choose a folder") as found:
            work()
        assert "Errno" not in str(found.value)


TEXT = st.text(st.characters(exclude_categories=["Cs"]), max_size=6)
VALUES = st.recursive(
    st.booleans() | st.integers(1 - 2**63, 2**63 - 1) | st.floats(allow_nan=False) | TEXT,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(TEXT, inner, max_size=3), max_leaves=8,
)


@given(st.dictionaries(TEXT, VALUES, max_size=4))
@settings(max_examples=60)
def test_a_written_table_reads_back_the_same_from_toml_and_is_valid_json(table):
    assert tomllib.loads(to_toml(table)) == table
    text = to_json({"value": table, "numpy": np.array([np.nan, np.inf, 1.0])})
    assert json.loads(text, parse_constant=pytest.fail)["numpy"] == [None, None, 1.0]


def test_toml_is_written_for_numpy_values_but_not_for_none():
    assert tomllib.loads(to_toml({"a": np.float64(0.1), "b": np.arange(3)})) == {"a": 0.1, "b": [0, 1, 2]}
    with pytest.raises(TypeError, match=r"a\.b = None has no form in TOML"):
        to_toml({"a": {"b": None}})

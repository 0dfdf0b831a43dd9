"""Files from outside: regular, measured before they are read, bounded in what they can ask for; JSON that is JSON."""

import ast
import io
import json
import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from moc_opt.errors import MocOptError, ReportError, RobotError, ScenarioError, TraceError, shown
from moc_opt.inputs.files import (
    check_values,
    file_in,
    read_arrays,
    read_bytes,
    read_json,
    read_text,
    read_toml,
    to_json,
)
from moc_opt.model.robot_model import load_robot
from moc_opt.report.document import save_document
from moc_opt.scenario import Scenario, Setup
from moc_opt.trace.trace import Trace

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize(
    ("load", "error"), [(Scenario.load, ScenarioError), (load_robot, RobotError), (Trace.load, TraceError)]
)
def test_every_reader_refuses_what_is_no_regular_file(load, error, tmp_path):
    for name, make in {
        "fifo.toml": os.mkfifo, "zeros.toml": lambda p: os.symlink("/dev/zero", p), "folder.toml": os.mkdir,
        "loop.toml": lambda p: os.symlink("loop.toml", p), "kernel.toml": lambda p: os.symlink("/proc/kmsg", p),
    }.items():  # fmt: skip
        make(tmp_path / name)
        with pytest.raises(error, match=name):
            load(tmp_path / name)


def test_a_name_that_becomes_that_of_a_pipe_after_the_check_is_refused(tmp_path, monkeypatch):
    os.mkfifo(tmp_path / "fifo")
    monkeypatch.setattr("moc_opt.inputs.files.check_regular", lambda *arguments: 0)
    with pytest.raises(MocOptError, match=r"fifo.*no regular file"):
        read_bytes(tmp_path / "fifo", "scenario", MocOptError)


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


def test_a_file_that_says_nothing_of_its_size_is_cut_off():
    """The kernel's files have zero bytes by their own account."""
    if not Path("/proc/self/maps").exists():
        pytest.skip("no such files here")
    assert read_text("/proc/self/maps", "file", MocOptError)
    with pytest.raises(MocOptError, match="more than 100 bytes"):
        read_text("/proc/self/maps", "file", MocOptError, 100)


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


def test_toml_of_ordinary_size_is_read(tmp_path):
    text = 'text = "' + "a.b." * 100 + '"\n"quoted.key" = 1\n[a.b.c.d]\nx = [' + ", ".join(["1.5"] * 5000) + "]\n"
    (tmp_path / "s.toml").write_text(text)
    with pytest.raises(ScenarioError, match="dotted"):  # the price: it cannot be told from a key without parsing
        read_toml(tmp_path / "s.toml", "scenario", ScenarioError)
    (tmp_path / "s.toml").write_text(text.replace("a.b." * 100, "a.b." * 10))
    assert len(read_toml(tmp_path / "s.toml", "scenario", ScenarioError)["a"]["b"]["c"]["d"]["x"]) == 5000


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


def test_json_is_written_without_nan_everywhere():
    """Every call of json.dump(s) in the package and its benchmarks refuses what is not JSON."""
    wrong = []
    for file in [*ROOT.glob("moc_opt/**/*.py"), *ROOT.glob("benchmarks/**/*.py")]:
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if not (isinstance(node, ast.Call) and ast.unparse(node.func) in ("json.dump", "json.dumps")):
                continue
            strict = any(k.arg == "allow_nan" and ast.unparse(k.value) == "False" for k in node.keywords)
            if not strict and file.parent.name != "reliability":  # where bad input is made
                wrong.append(f"{file.relative_to(ROOT)}:{node.lineno}")
    assert wrong == []


def test_files_from_outside_are_opened_in_one_place():
    """A reader that opens a file by itself would wait for a pipe."""
    # Of the package's own files, and of a trace through the readers of trace_file.
    allowed = {
        "moc_opt/inputs/files.py", "moc_opt/inputs/memory.py", "moc_opt/trace/parquet_file.py",
        "moc_opt/trace/writer.py", "moc_opt/scenario/setup.py", "moc_opt/embedded/program.py",
        "moc_opt/numerics/cache.py", "moc_opt/control/worker_main.py",  # the last: its own memory, in /proc
            "moc_opt/report/console.py",  # os.devnull
    }  # fmt: skip
    found = set()
    for file in ROOT.glob("moc_opt/**/*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            called = ast.unparse(node.func) if isinstance(node, ast.Call) else ""
            if called in ("open", "np.load", "np.fromfile", "json.load", "tomllib.load") or called.endswith(
                (".open", ".read_text", ".read_bytes", ".ParquetFile", ".read_table")
            ):
                found.add(file.relative_to(ROOT).as_posix())
    assert found <= allowed, found - allowed


@pytest.mark.parametrize("shape", [(10**9,), (10**6, 10**6), (3,)])
@pytest.mark.parametrize("kind", ["<f8", "<U100000", "|O", "<U0"])
def test_an_array_is_measured_by_its_header(shape, kind, tmp_path):
    sink = io.BytesIO()
    np.lib.format.write_array_header_1_0(sink, {"descr": kind, "fortran_order": False, "shape": shape})
    (tmp_path / "a.npy").write_bytes(sink.getvalue())
    if kind == "<U0" and shape == (3,):
        assert read_arrays(tmp_path / "a.npy", "times", MocOptError)[""].tolist() == ["", "", ""]
        return
    with pytest.raises(MocOptError, match=r"a\.npy.*damaged or no file of arrays"):
        read_arrays(tmp_path / "a.npy", "times", MocOptError)


def test_arrays_come_back(tmp_path):
    np.save(tmp_path / "a.npy", np.arange(3.0))
    np.savez_compressed(tmp_path / "b.npz", x=np.zeros((2, 3)), t=np.array(["a"]))
    assert read_arrays(tmp_path / "a.npy", "times", MocOptError)[""].tolist() == [0.0, 1.0, 2.0]
    found = read_arrays(tmp_path / "b.npz", "set", MocOptError)
    assert (found["x"].shape, found["t"].tolist()) == ((2, 3), ["a"])


def test_depth_is_measured_without_recursion():
    deep = []
    for _ in range(100_000):
        deep = [deep]
    with pytest.raises(MocOptError, match="nested too deep"):
        check_values({"a": deep}, "here", MocOptError)
    assert len(shown(deep)) <= 200
    assert "int" in shown(10**5000)


def test_a_free_name_never_takes_what_is_there(tmp_path):
    first = file_in(tmp_path / "aside", "x.json")
    first.write_text("1")
    second = file_in(tmp_path / "aside", "x.json")
    assert second != first
    assert first.read_text() == "1"

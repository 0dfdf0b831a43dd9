"""Runs that go to the disk as they come: the same rows as in memory, and what there is survives whatever ends them."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from moc_opt.__main__ import main
from moc_opt.errors import PlantError, ScenarioError, TraceError
from moc_opt.scenario import RunAway, Scenario, Setup, rows, run, steps
from moc_opt.sim import Plant
from moc_opt.trace.metrics import summarize
from moc_opt.trace.parquet import Stored
from moc_opt.trace.trace import Trace
from moc_opt.trace.writer import KILLED, TraceWriter, parts_of

ROOT = Path(__file__).resolve().parents[2]
CLOCK = ("tick_us", "solve_us")
SHORT = {"duration_s": 0.4, "bound_samples": 5}


def same_rows(one, other):
    assert list(one.columns) == list(other.columns)
    for name in one.columns:
        a, b = one.columns[name], other.columns[name]
        assert (a.dtype, a.shape) == (b.dtype, b.shape), name
        if name not in CLOCK:
            assert a.tobytes() == b.tobytes(), name


@pytest.mark.parametrize("block", [1000, 200, 64, 1])
def test_a_streamed_run_is_the_run_in_memory(block, tmp_path):
    """Columns that are computed afterwards, texts and meta included; also where the last block is not full."""
    made = Scenario(**SHORT, faults={"solver": "fail", "drop_share": 0.1, "bump_N": 5.0, "bump_at_s": 0.1})
    whole = Setup(made).trace()
    streamed = Setup(made).trace(to=tmp_path / "t.parquet", block=block)
    assert isinstance(streamed.columns, Stored)
    same_rows(whole, streamed)
    same_rows(whole, Trace.load(tmp_path / "t.parquet"))
    assert dict(streamed.meta) == dict(whole.meta)
    assert {"mu", "mu_bound", "verified", "injected", "tip_error_model_m"} <= set(streamed.columns)
    assert os.listdir(tmp_path) == ["t.parquet"]
    of_whole, of_file = summarize(whole), summarize(streamed)
    assert {n: v for n, v in of_whole.items() if not n.endswith("_us") and n != "deadline_misses"} == {
        n: v for n, v in of_file.items() if not n.endswith("_us") and n != "deadline_misses"
    }


@pytest.mark.parametrize("backend", ["python", "c"])
def test_both_backends_stream(backend, tmp_path):
    made = Scenario(**SHORT, control={"backend": backend})
    same_rows(run(made), Setup(made).trace(to=tmp_path / "t.parquet", block=70))


@pytest.mark.parametrize("error", [KeyboardInterrupt(), MemoryError("full"), ValueError("a defect"), SystemExit(3)])
def test_whatever_ends_a_run_leaves_its_rows(error, tmp_path):
    made, ticks = Scenario(**SHORT), 137
    whole = Setup(made).trace()

    def watch(tick):
        if tick == ticks:
            raise error

    with pytest.raises(type(error)) as caught:
        Setup(made).trace(watch, tmp_path / "t.parquet", block=50)
    assert any("first 0.274 s" in note and "t.parquet" in note for note in caught.value.__notes__)
    found = Trace.load(tmp_path / "t.parquet")
    assert len(found) == ticks
    assert type(error).__name__ in found.meta["ended"]
    assert (found.meta["ticks"], found.meta["ticks_planned"]) == (ticks, len(whole))
    assert found.q_rad.tobytes() == whole.q_rad[:ticks].tobytes()
    assert found.verified.tobytes() == whole.verified[:ticks].tobytes()
    assert not parts_of(tmp_path / "t.parquet").exists()
    assert 0.0 < summarize(found)["share_of_run"] < 1.0


def test_a_change_of_the_working_directory_loses_no_row(tmp_path, monkeypatch):
    """As a solver's library may make one."""
    (tmp_path / "away").mkdir()
    monkeypatch.chdir(tmp_path)

    def watch(tick):
        if tick == 70:
            os.chdir("away")

    found = Setup(Scenario(**SHORT)).trace(watch, "t.parquet", block=50)
    assert len(Trace.load(tmp_path / "t.parquet")) == len(found) == 200
    assert sorted(os.listdir(tmp_path)) == ["away", "t.parquet"]
    assert os.listdir(tmp_path / "away") == []


def test_an_arm_that_runs_away_leaves_its_trace(tmp_path, monkeypatch):
    step, calls = Plant.step, iter(range(10**6))

    def breaking(self, *args):
        if next(calls) == 120:
            raise PlantError("the plant broke")
        return step(self, *args)

    monkeypatch.setattr(Plant, "step", breaking)
    monkeypatch.setattr(steps, "compiled_steps", lambda *parts: None)  # which step by themselves
    with pytest.raises(RunAway, match="the plant broke") as caught:
        Setup(Scenario(**SHORT)).trace(to=tmp_path / "t.parquet", block=50)
    assert len(caught.value.trace) == 121
    found = Trace.load(tmp_path / "t.parquet")
    assert found.meta["ended"].startswith("ran away")
    assert len(found) == 121


def test_a_disk_that_is_full_keeps_what_was_written(tmp_path, monkeypatch):
    real = TraceWriter.write

    def full(self, first, columns):
        if first >= 100:
            raise TraceError("no space left")
        real(self, first, columns)

    monkeypatch.setattr(TraceWriter, "write", full)
    with pytest.raises(TraceError, match="no space left"):
        Setup(Scenario(**SHORT)).trace(to=tmp_path / "t.parquet", block=50)
    assert len(Trace.load(tmp_path / "t.parquet")) == 100


LONG = """
import sys
from moc_opt.scenario import Scenario, Setup
def watch(tick):
    if tick == 620:
        print("here", flush=True)
Setup(Scenario(task={"hold_s": 600.0})).trace(watch, sys.argv[1], block=100)
"""


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_a_killed_run_can_be_read_and_is_kept_by_the_next(number, tmp_path):
    target = tmp_path / "t.parquet"
    process = subprocess.Popen([sys.executable, "-c", LONG, str(target)], cwd=ROOT, stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "here\n"
    with pytest.raises(TraceError, match="another run is writing"), TraceWriter(target, {}):
        pass
    process.send_signal(number)
    process.wait()
    for found in (Trace.load(target), Trace.open(target)):
        assert len(found) >= 600
        assert len(found) % 100 == 0
        assert found.meta["ended"] == KILLED
        assert found.meta["scenario"]["task"]["hold_s"] == 600.0
        assert np.array_equal(found.t_s, 0.002 * np.arange(len(found)))
        assert summarize(found)["mu_mean"] > 0.0
    before = len(Trace.open(target))
    again = Setup(Scenario(**SHORT)).trace(to=target)
    assert "t.interrupted.parquet" in again.meta["earlier_run"]
    assert len(Trace.load(target)) == 200
    kept = Trace.load(tmp_path / "t.interrupted.parquet")
    assert (len(kept), kept.meta["ended"]) == (before, KILLED)


def test_ctrl_c_says_one_line(tmp_path):
    file, target = tmp_path / "s.toml", tmp_path / "t.parquet"
    file.write_text("[task]\nhold_s = 600.0\n")
    process = subprocess.Popen(
        [sys.executable, "-m", "moc_opt", "run", str(file), "--trace", str(target)], cwd=ROOT, stderr=subprocess.PIPE,
        stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    until = time.monotonic() + 120.0
    while not list(parts_of(target).glob("[0-9]*.parquet")) and time.monotonic() < until:
        time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    out, said = process.communicate()
    assert process.returncode == 130
    assert said.startswith("interrupted; the first ")
    assert said.count("\n") == 1
    assert out == ""
    assert len(Trace.load(target)) >= 5000


def test_a_defect_says_one_line_and_where_the_rows_are(tmp_path, capsys, monkeypatch):
    ticks = iter(range(10**6))
    real = Plant.measure

    def breaking(self):
        if next(ticks) == 150:
            raise ZeroDivisionError("a defect\nof two lines")
        return real(self)

    monkeypatch.setattr(Plant, "measure", breaking)
    file, target = tmp_path / "s.toml", tmp_path / "t.parquet"
    file.write_text("duration_s = 1.0\n")
    assert main(["run", str(file), "--trace", str(target)]) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert said.startswith(f"ZeroDivisionError: a defect of two lines ({Path(__file__).name}:")
    assert len(Trace.load(target)) == 148  # two measurements come before the loop


def test_a_run_that_does_not_fit_the_memory_is_refused_before_it_begins(tmp_path, monkeypatch):
    monkeypatch.setattr(rows, "available_bytes", lambda: 50 * 2**20)
    made = Scenario(task={"hold_s": 60.0})
    with pytest.raises(ScenarioError, match=r"GiB of memory.*shorter duration_s.*--trace FILE"):
        Setup(made).trace(lambda tick: pytest.fail("it began"))
    trace = Setup(made.change(duration_s=0.2)).trace(to=tmp_path / "t.parquet")
    assert len(trace) == 100


def test_more_ticks_than_a_trace_holds_are_refused():
    with pytest.raises(ScenarioError, match=r"v_max_m_per_s.*more than 20000000 ticks.*give a shorter duration_s"):
        Setup(Scenario(task={"v_max_m_per_s": 1e-9, "sizes": {"radius": 0.03}}, start={"check_path": False})).times()


@pytest.mark.parametrize("target", ["nowhere/t.parquet", "file/t.parquet"])
def test_a_folder_that_is_not_there_is_said_before_the_run(target, tmp_path, capsys):
    (tmp_path / "file").write_text("")
    (tmp_path / "s.toml").write_text("duration_s = 0.1\n")
    assert main(["run", str(tmp_path / "s.toml"), "--trace", str(tmp_path / target)]) == 2
    assert "there is no folder" in capsys.readouterr().err


@pytest.mark.parametrize("folder", ["/", "."])
def test_a_folder_is_no_name_of_a_trace(folder, tmp_path, capsys):
    (tmp_path / "s.toml").write_text("duration_s = 0.1\n")
    assert main(["run", str(tmp_path / "s.toml"), "--trace", folder]) == 2
    assert "folder" in capsys.readouterr().err
    with pytest.raises(TraceError, match="folder"):
        TraceWriter(folder, {})
    with pytest.raises(TraceError):
        Trace.load(folder)


@pytest.mark.parametrize("name", ["t.csv", "t.JSON", "a.b.npz"])
def test_a_name_of_another_format_is_refused_before_the_run(name, tmp_path, capsys):
    (tmp_path / "s.toml").write_text("duration_s = 0.1\n")
    assert main(["run", str(tmp_path / "s.toml"), "--trace", str(tmp_path / name)]) == 2
    assert f"name it '{name.rpartition('.')[0]}.parquet'" in capsys.readouterr().err
    with pytest.raises(TraceError, match="a trace is written as Parquet"):
        Trace({"t_s": np.zeros(1)}, {}).save(tmp_path / name)
    assert [path.name for path in tmp_path.iterdir()] == ["s.toml"]


def test_memory_of_a_streamed_run_does_not_grow_with_it(tmp_path):
    """Three times as many rows: a tenth of their bytes at most."""
    code = (
        "import resource, sys; from moc_opt.scenario import *; from moc_opt.trace.metrics import summarize\n"
        "def go(s): summarize(Setup(Scenario(duration_s=s, task={'hold_s': 60.0})).trace(to=sys.argv[1], block=500))\n"
        "go(4.0); a = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss\n"
        "go(24.0); print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - a)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "t.parquet")], cwd=ROOT, capture_output=True, text=True, check=True
    )
    grown = 1024 * int(done.stdout)
    assert grown < 10_000 * 1000, f"{grown / 10_000:.0f} bytes a tick"


def test_blocks_that_are_no_parts_of_one_trace_are_refused(tmp_path):
    for name, columns in (("a", {"x": [0.1]}), ("b", {"x": [[0.1, 0.2]]}), ("c", {"y": [0.1]})):
        Trace(columns).save(tmp_path / f"{name}.parquet")
    for other in "bc":
        with pytest.raises(TraceError, match="no parts of one trace"):
            Stored([tmp_path / "a.parquet", tmp_path / f"{other}.parquet"])


def test_head_and_meta_of_a_trace_in_a_file(tmp_path):
    trace = Trace({"mu": np.arange(10.0), "status": ["solved"] * 9 + ["infeasible"]}, {"ended": "completed"})
    trace.save(tmp_path / "t.parquet")
    for found in (trace, Trace.open(tmp_path / "t.parquet")):
        assert found.head(3).mu.tolist() == [0.0, 1.0, 2.0]
        assert len(found.head(3)) == 3
        assert len(found.head(30)) == 10
        assert found.with_meta(ended="x").meta["ended"] == "x"
        assert found.with_meta(ended="x").mu.tolist() == trace.mu.tolist()
        with pytest.raises(ValueError, match="read-only"):
            found.mu[0] = 1.0

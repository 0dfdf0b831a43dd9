"""Bad input: refused by name, or taken and right; never a traceback from inside, a hang, or a file where none belongs.

`python -m benchmarks.fuzz --cases 10000` does the same at length.
"""

import contextlib
import io
import json
import os
import pickle
import signal
import time
from collections import Counter

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from benchmarks import fuzz
from benchmarks.reliability import fuzz_c, fuzz_case, fuzz_checks, limits
from benchmarks.reliability.fuzz_case import ARM_TOML, ARM_URDF
from benchmarks.reliability.fuzz_traces import good_trace
from moc_opt.__main__ import main
from moc_opt.errors import MocOptError, PlantError, RobotError, ScenarioError, SubproblemError, TraceError
from moc_opt.model.robot_model import load_robot
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.scenario import Scenario, Setup, run
from moc_opt.sim import Plant
from moc_opt.trace.trace import Trace

SHORT = {"duration_s": 0.004, "bound_samples": 0, "judge": False}


@pytest.mark.parametrize(
    ("kind", "cases"),
    [("scenario", 80), ("scenario_file", 60), ("robot_file", 60), ("subproblem", 100), ("result_file", 100),
     ("record_file", 40), ("exported", 40), ("name", 80), ("option", 80), ("urdf_number", 120), ("hostile_file", 120),
     ("extreme_number", 80), ("sweep_folder", 40), ("study_folder", 40), ("trace_folder", 40),
     ("faulty_run", 25), ("hostile_solver", 30), ("foreign_trace", 80), ("wire_packet", 60),
     ("parquet_footer", 300)],
)  # fmt: skip
def test_bad_input_ends_well(kind, cases):
    if kind == "exported" and not fuzz.has_compiler():
        pytest.skip("no C compiler (cc, gcc, clang) on the path")
    verdicts, failures = fuzz.explore(kind, cases, 7, lambda: None)
    assert failures == []
    assert verdicts.total() >= cases
    assert verdicts["refused"] > 0 or kind == "sweep_folder"  # which always goes on to the whole
    if kind != "record_file":
        assert verdicts["accepted"] > 0  # or nothing behind the first check was looked at


def stubborn(kind, cases, seed, done):
    """What the limited process does with cases of its own; see the test below."""
    if kind == "dies":
        os._exit(9)
    if kind == "hangs":
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGALRM})
        done()
        time.sleep(600.0)
    if kind == "memory":
        with contextlib.suppress(MemoryError):
            return Counter(accepted=len(bytearray(3 * 2**30))), []
        return Counter(refused=cases), []
    done()
    return Counter(accepted=cases), ["one"]


@pytest.mark.parametrize(
    ("kind", "verdicts", "failures"),
    [
        ("ends", {"accepted": 5}, ["one"]), ("memory", {"refused": 5}, []),
        ("dies", {}, ["exit code 9"] * limits.MOST_DEATHS),
        ("hangs", {"accepted": 3}, ["no answer within"] * limits.MOST_DEATHS),
    ],
)  # fmt: skip
def test_a_case_that_kills_or_stops_the_process_is_a_failure(kind, verdicts, failures, monkeypatch):
    monkeypatch.setattr(limits, "GRACE_S", 1.0)
    found, said = limits.limited(stubborn, kind, 5, 0, lambda: None, 1.0)
    assert +found == Counter(verdicts)
    assert len(said) == len(failures)
    assert all(wanted in text for wanted, text in zip(failures, said, strict=True))


@pytest.mark.parametrize(
    ("change", "what"),
    [
        (lambda case: 1 / 0, "ZeroDivisionError"),
        (lambda case: (_ for _ in ()).throw(fuzz_case.Wrong("not true")), "Wrong"),
    ],
)
def test_a_failure_is_found(change, what, monkeypatch):
    monkeypatch.setitem(fuzz_checks.KINDS, "subproblem", fuzz_checks.KINDS["subproblem"]._replace(check=change))
    _, failures = fuzz.explore("subproblem", 5, 0, lambda: None)
    assert failures
    assert all(failure.startswith(what) for failure in failures)


def test_a_wrong_torque_in_c_is_found(monkeypatch):
    """One that is off by a nanonewton metre more than is allowed."""
    if not fuzz.has_compiler():
        pytest.skip("no C compiler (cc, gcc, clang) on the path")
    right = fuzz_c.GuardedController.tick
    monkeypatch.setattr(fuzz_c.GuardedController, "tick", lambda *given: right(*given) + 1.1e-9)
    with pytest.raises(AssertionError, match="tick 0: C has"):
        fuzz_c.exported({"law": 0, "seed": 1, "speed": 0.5, "events": []})


@pytest.mark.parametrize(("busy_s", "wall_s"), [(0.5, 600.0), (600.0, 0.5)])
def test_a_hang_is_found(busy_s, wall_s):
    def stubborn():
        with fuzz_case.time_limit(busy_s, wall_s):
            while True:
                with contextlib.suppress(Exception):  # nothing that catches exceptions may swallow it
                    while True:
                        pass

    with pytest.raises(fuzz_case.Hang):
        stubborn()
    assert signal.getitimer(signal.ITIMER_PROF) == signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)


def test_waiting_is_no_hang_until_the_clock_says_so():
    """A busy machine lengthens the time by the clock alone."""
    with fuzz_case.time_limit(0.2, 600.0):
        time.sleep(0.5)
    with pytest.raises(fuzz_case.Hang), fuzz_case.time_limit(600.0, 0.2):
        time.sleep(600.0)


def test_the_command(tmp_path, capsys, monkeypatch):
    assert (
        fuzz.main(["--cases", "12", "--out", str(tmp_path), "--only", "record_file", "subproblem", "--json"])
        == 0
    )
    assert set(json.loads(capsys.readouterr().out)) == {"record_file", "subproblem"}
    assert all(callable(fuzz.lookup(kind).check) for kind in fuzz.KINDS)
    monkeypatch.setattr(fuzz, "limited", lambda explore, *of: explore(*of[:-1]))  # here, where it can be changed
    spoilt = fuzz_checks.KINDS["record_file"]._replace(check=lambda case: 1 / 0)
    monkeypatch.setitem(fuzz_checks.KINDS, "record_file", spoilt)
    assert fuzz.main(["--cases", "3", "--out", str(tmp_path), "--only", "record_file"]) == 1
    assert "ZeroDivisionError" in capsys.readouterr().out


def test_a_run_that_was_cut_short_goes_on_behind_what_it_was_through_with(tmp_path, capsys, monkeypatch):
    """With the same cases, seed and commit; with others all is done anew."""
    done = []

    def limited(explore, kind, cases, *rest):
        if kind == "subproblem" and len(done) == 1:
            raise KeyboardInterrupt
        done.append(kind)
        return Counter(accepted=cases), []

    monkeypatch.setattr(fuzz, "limited", limited)
    command = ["--cases", "12", "--out", str(tmp_path), "--only", "record_file", "subproblem", "--resume", "--json"]
    assert fuzz.main(command) == 130
    assert done == ["record_file"]
    done.append("a break")
    assert fuzz.main(command) == 0
    assert done[2:] == ["subproblem"]
    whole = json.loads(capsys.readouterr().out)
    assert [kind["cases"] for kind in whole.values()] == [3, 9]
    assert fuzz.main([*command, "--seed", "5"]) == 0
    assert done[3:] == ["record_file", "subproblem"]


@pytest.mark.parametrize(
    ("table", "names"),
    [
        ({"plant": {"period_s": 1e-9, "substeps": 1}}, "period_s"),
        ({"task": {"v_max_m_per_s": 1e-300}}, "v_max_m_per_s"),
        ({"task": {"a_max_m_per_s2": 1e-300}}, "a_max_m_per_s2"),
        ({"duration_s": 1e300}, "duration_s"),
        ({"bound_samples": 10**9}, "bound_samples"),
        ({"task": {"wait_s": 1e300}}, "wait_s"),
    ],
)
def test_runs_that_would_never_end_are_refused(table, names):
    with pytest.raises(ScenarioError, match=names):
        Setup(Scenario(**table))


@pytest.mark.parametrize(
    "table",
    [{"robot": {"tool_mass_kg": 1e300}}, {"robot": {"tool_length_m": 1e300}},
     {"trocar": {"breathing_amplitude_m": 1e300}}],
)  # fmt: skip
def test_absurd_sizes_are_refused_by_name(table):
    with pytest.raises(ScenarioError, match=next(iter(next(iter(table.values()))))):
        Scenario(**table)


def test_absurd_gains_end_in_a_stop():
    trace = run(Scenario(control={"K_X": 1e30}, **{**SHORT, "duration_s": 0.2}))
    assert trace.meta["ended"].startswith("stopped")


def test_an_arm_that_runs_away_leaves_no_log(robot, tmp_path, monkeypatch):
    """MuJoCo would write one into the current folder."""
    monkeypatch.chdir(tmp_path)
    plant = Plant(robot.data)
    plant.push(robot.data.tip_frame, [1e300, 0.0, 0.0])
    with pytest.raises(PlantError, match="ran away"):
        plant.step(np.zeros(7))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "code"), [("../../x", 2), ("/tmp/x", 2), ("..", 2), ("\x00", 2), ("con", 0), ("a/b/c", 0)]
)
def test_a_name_is_no_place_to_write(name, code, tmp_path, monkeypatch, capsys):
    """A run writes the file that was asked for, and no other, whatever its scenario is called; no name, no run."""
    inside = tmp_path / "a" / "b"
    inside.mkdir(parents=True)
    monkeypatch.chdir(inside)
    file = tmp_path / "scenario.toml"
    file.write_text(f"name = {json.dumps(name)}\nduration_s = 0.004\nbound_samples = 0\njudge = false\n")
    assert main(["run", str(file), "--trace", "out.parquet"]) == code, capsys.readouterr().err
    written = {inside / "out.parquet"} if code == 0 else set()
    assert {path for path in tmp_path.rglob("*") if path.is_file()} == {file} | written


@pytest.mark.parametrize(
    "name", ["../../../etc/passwd", "/dev/null", "/dev/zero", "..", "/etc/passwd.toml", "x\x00.toml"]
)
def test_a_robot_s_path_is_only_read(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(MocOptError):
        run(Scenario(robot={"name": name}, **SHORT))
    assert list(tmp_path.iterdir()) == []


class Evil:
    """Leaves a file behind where it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return (open, (self.path, "w"))


def test_a_parquet_file_runs_no_code(tmp_path):
    """Pickles where other libraries look for them: extension types, pandas metadata, our own keys."""
    mark = tmp_path / "was-here"
    bomb = pickle.dumps(Evil(str(mark)))
    field = pa.field(
        "t_s", pa.float64(),
        metadata={"ARROW:extension:name": "arrow.py_extension_type", "ARROW:extension:metadata": bomb},
    )  # fmt: skip
    for types in (bomb, json.dumps({"t_s": "|O"}).encode(), json.dumps({"t_s": "<f8"}).encode()):
        schema = pa.schema(
            [field],
            metadata={
                "moc_opt.trace.trace": "1",
                "moc_opt.types": types,
                "moc_opt.meta": "{}",
                "pandas": bomb,
                "PANDAS": bomb,
            },
        )
        pq.write_table(pa.table([pa.array([0.0, 1.0])], schema=schema), tmp_path / "evil.parquet")
        with contextlib.suppress(TraceError):
            trace = Trace.load(tmp_path / "evil.parquet")
            assert trace.t_s.dtype == np.float64
        assert not mark.exists()
    pickle.loads(bomb).close()
    assert mark.exists()  # the charge was live


def test_a_parquet_file_of_many_rows_is_not_unpacked(tmp_path):
    """A few kilobytes can stand for terabytes."""
    file = tmp_path / "many.parquet"
    with pq.ParquetWriter(file, pa.schema([("t_s", pa.float64())])) as writer:
        chunk = pa.table({"t_s": np.zeros(5_000_000)})
        for _ in range(5):
            writer.write_table(chunk)
    assert file.stat().st_size < 1e6
    with pytest.raises(TraceError, match="25000000 rows"):
        Trace.load(file)


@pytest.mark.parametrize(
    "types", [{"t_s": "|O"}, {"t_s": "<U999999999"}, {"t_s": "f8,i4"}, {"t_s": None}, {}, [], 3]
)
def test_hostile_types_are_refused(types, tmp_path):
    table = pa.table({"t_s": pa.array(["x", "y"])})
    keys = {"moc_opt.trace.trace": "1", "moc_opt.types": json.dumps(types), "moc_opt.meta": "{}"}
    pq.write_table(table.replace_schema_metadata(keys), tmp_path / "t.parquet")
    with pytest.raises(TraceError, match=r"t\.parquet|t_s"):
        Trace.load(tmp_path / "t.parquet")


@pytest.mark.parametrize("key", ["moc_opt.meta", "moc_opt.types"])
def test_metadata_nested_too_deep_is_refused(key, tmp_path):
    data = good_trace()[1]
    table = pq.read_table(io.BytesIO(data))
    metadata = {**table.schema.metadata, key.encode(): b"[" * 100_000}
    pq.write_table(table.replace_schema_metadata(metadata), tmp_path / "t.parquet")
    with pytest.raises(TraceError, match=r"t\.parquet"):
        Trace.load(tmp_path / "t.parquet")


def test_toml_nested_too_deep_is_refused(tmp_path):
    for name, load, error in (
        ("scenario.toml", Scenario.load, ScenarioError), ("arm.toml", load_robot, RobotError),
    ):  # fmt: skip
        (tmp_path / name).write_text("x = " + "[" * 100_000)
        with pytest.raises(error, match=name):
            load(tmp_path / name)


def test_toml_is_data(tmp_path):
    """No references, tags or templates: a text stays one, in an error too."""
    file = tmp_path / "s.toml"
    file.write_text('name = "${HOME} {0.__class__} !!python/object"\n')
    with pytest.raises(ScenarioError, match=r"name = '\$\{HOME\} \{0\.__class__\} !!python/object'.* is no name"):
        Scenario.load(file)
    file.write_text('[control]\npreset = "{0.__class__} %s"\n')
    with pytest.raises(MocOptError, match=r"s\.toml.*__class__} %s"):
        Scenario.load(file)


@pytest.mark.parametrize(
    "entity", ['<!DOCTYPE r [<!ENTITY a SYSTEM "file:///etc/passwd">]>', "<!ENTITY a 'b'>"]
)
def test_a_urdf_reads_no_other_file(entity, tmp_path):
    (tmp_path / "arm.toml").write_text(ARM_TOML)
    (tmp_path / "arm.urdf").write_text(entity + ARM_URDF)
    with pytest.raises(RobotError, match="entities"):
        load_robot(tmp_path / "arm.toml")


@pytest.mark.parametrize("name", ["c0", "c1", "c2", "regularization"])
def test_weights_that_overflow_are_refused_by_name(name):
    """At 1e300 even the exact solver would claim success for a wrong answer."""
    J, ones = np.eye(3, 7), np.ones(7)
    with pytest.raises(SubproblemError, match=name):
        NullSpaceQP(J, J, np.zeros(3), np.zeros(3), ones, -ones, ones, **{name: 1e300})

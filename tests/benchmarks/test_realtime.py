"""The real-time benchmark."""

import json
import os
import sys

import numpy as np
import pytest

from benchmarks import realtime
from benchmarks.goals import judge
from benchmarks.realtime import Case, Run
from moc_opt.errors import StudyError
from moc_opt.scenario import Scenario
from moc_opt.trace.trace import Trace


def made(cycles: int, missed: int = 0, ended: str = "completed", clean: bool = True, rcm: float = 0.5) -> Run:
    ramp = np.arange(1.0, cycles + 1.0)
    control = np.where(np.arange(cycles) < missed, np.nan, 10.0)
    return Run(ramp / 10.0, ramp, control, missed, 0, ended, clean, rcm, {}, "2020-01-01T00:00:00+00:00")


def test_case_counts_cycles_of_all_runs():
    found = realtime.summarise([made(1000), made(500, missed=3, ended="stopped: no command", rcm=0.7)])
    assert (found["runs"], found["cycles"], found["missed"], found["stopped"], found["unclean"]) == (2, 1500, 3, 1, 0)
    assert found["missed_share"] == pytest.approx(3 / 1500)
    assert (found["round_worst_us"], found["wake_worst_us"], found["control_worst_us"]) == (1000.0, 100.0, 10.0)
    assert found["round_p50_us"] == pytest.approx(np.median([*range(1, 1001), *range(1, 501)]))
    assert found["rcm_max_mm"] == 0.7


@pytest.mark.parametrize(
    ("missed", "cycles", "reached"),
    [(3, 1_000_000, "yes"), (4, 1_000_000, "open"), (18, 1_000_000, "no"), (0, 99_999, "not measured")],
)
def test_goal_of_the_c_controller_is_judged_by_its_missed_cycles(missed, cycles, reached):
    case, other = {"cycles": cycles, "missed": missed}, {"cycles": 9, "missed": 9}
    found = judge({"cases": {"C, 500 Hz, quiet": case, "C, 1000 Hz, quiet": other}}, realtime.GOALS)
    assert found["c"]["reached"] == reached
    assert found["python"]["reached"] == found["rcm"]["reached"] == "not measured"


def test_load_processes_run_only_during_a_loaded_case(monkeypatch):
    started, real = [], realtime.subprocess.Popen
    monkeypatch.setattr(realtime.subprocess, "Popen", lambda command: started.append(real(command)) or started[-1])
    with realtime.loaded("quiet"):
        assert started == []
    with realtime.loaded("loaded"):
        assert len(started) == os.cpu_count()
        assert all(process.poll() is None for process in started)
    assert all(process.poll() is not None for process in started)


def test_study_runs_both_controllers(tiny):
    text = "run_cycles = 100\nrates_Hz = [250]\nloads = ['quiet']\n"
    left = tiny(realtime, text, "--cycles", "100")
    assert {row["case"] for row in left.rows} == {"Python, 250 Hz, quiet", "C, 250 Hz, quiet"}
    for row in left.rows:
        assert row["clean"]
        assert row["missed"] <= row["cycles"]
        assert row["cycles"] == 100 or row["ended"] != "completed"
        assert row["round_worst_us"] > 0.0
    granted = json.loads((left.out / "environment.json").read_text())["system"]["C, 250 Hz, quiet"]
    assert {"scheduling", "memory"} <= set(granted["plant"])


def test_cycles_after_a_stop_do_not_count():
    columns = {
        "t_s": 0.002 * np.arange(100), "wake_us": np.arange(100.0), "tick_us": np.full(100, 9.0),
        "control_us": np.full(100, 2.0), "missed": np.arange(100) >= 50, "rcm_error_registered_m": np.full(100, 1e-3),
        "v_rad_per_s": np.zeros((100, 7)),
    }  # fmt: skip
    meta = {"wire": {"missed": 50, "overruns": 4, "system": {}}, "ended": "stopped: x", "stopped_at_s": 0.002 * 60}
    found = realtime.read(Trace(columns, meta), {"system": {}}, "now")
    assert (len(found.round_us), found.missed, found.overruns, found.clean) == (61, 11, 4, True)
    moving = columns | {"v_rad_per_s": np.full((100, 7), 0.1)}
    far = columns | {"rcm_error_registered_m": np.full(100, 3e-3)}
    for of, told in ((moving, meta), (far, meta), (columns, meta | {"ended": "ran away"})):
        assert not realtime.read(Trace(of, told), {"system": {}}, "now").clean


def test_failing_process_raises_a_study_error():
    with pytest.raises(StudyError, match="did not start"):
        realtime.run_once(Case("python", 500, "quiet"), Scenario(robot={"name": "none"}), None, 0, ())
    short = Scenario(duration_s=0.1, bound_samples=0, wire={"wait_s": 1.0})
    with pytest.raises(StudyError, match="no controller contacted"):  # the "C controller" is Python, and exits at once
        realtime.run_once(Case("c", 500, "quiet"), short, sys.executable, 0, ())

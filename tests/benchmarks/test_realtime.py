"""The benchmark against the clock: what it counts, and that a run of it is a run over the wire."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks import realtime
from benchmarks.common.goals import verdicts
from benchmarks.common.output import default_config
from benchmarks.latency import clock, wire
from benchmarks.latency.wire import Case, Found, RealtimeError
from moc_opt.errors import MocOptError
from moc_opt.scenario import Scenario
from moc_opt.study.kept import Kept
from moc_opt.trace.trace import Trace
from tests import first_screens

CASE = Case("python", 500, "quiet")


def run_of(cycles: int, missed: int = 0, ended: str = "completed", clean: bool = True, rcm: float = 0.5) -> Found:
    ramp = np.arange(1.0, cycles + 1.0)
    control = np.where(np.arange(cycles) < missed, np.nan, 10.0)
    return Found(ramp / 10.0, ramp, control, missed, 0, ended, clean, rcm, {}, "2020-01-01T00:00:00+00:00")


def test_a_case_is_all_cycles_of_its_runs():
    found = realtime.summarise([run_of(1000), run_of(500, missed=3, ended="stopped: no command", rcm=0.7)])
    assert (found["runs"], found["cycles"], found["missed"], found["stopped"], found["unclean"]) == (2, 1500, 3, 1, 0)
    assert found["missed_share"] == pytest.approx(3 / 1500)
    assert (found["round_worst_us"], found["wake_worst_us"], found["control_worst_us"]) == (1000.0, 100.0, 10.0)
    assert found["round_p50_us"] == pytest.approx(np.median([*range(1, 1001), *range(1, 501)]))
    assert found["rcm_max_mm"] == 0.7


@pytest.mark.parametrize(
    ("missed", "cycles", "reached"),
    [(3, 1_000_000, "yes"), (4, 1_000_000, "open"), (1, 100_000, "open"), (0, 100_000, "open"), (0, 400_000, "yes"),
     (0, 99_999, "not measured"), (16, 1_000_000, "open"), (18, 1_000_000, "no"), (9, 100_000, "no")],
)  # fmt: skip
def test_the_goal_of_c_needs_enough_cycles_and_few_misses(missed, cycles, reached):
    case = {"cycles": cycles, "missed": missed}
    summary = {"cases": {"c, 500 Hz, quiet": case, "c, 1000 Hz, quiet": {"cycles": 10**6, "missed": 10**5}}}
    found = verdicts(summary, realtime.GOALS)
    assert found["c"]["reached"] == reached
    assert found["python"]["reached"] == found["rcm"]["reached"] == "not measured"


def test_the_goals_under_load_look_at_every_loaded_case_and_at_no_other():
    good, bad = ({"cycles": 9, "unclean": k, "rcm_max_mm": 1.0 + 2.0 * k} for k in (0, 1))
    for name, reached in (("c, 1000 Hz, loaded", "no"), ("c, 1000 Hz, quiet", "yes")):
        found = verdicts({"cases": {"python, 500 Hz, loaded": good, name: bad}}, realtime.GOALS)
        assert found["rcm"]["reached"] == found["stops"]["reached"] == reached


def test_a_controller_that_stops_in_every_run_misses_a_goal():
    case = realtime.summarise([run_of(20_000, ended="stopped: asked for")] * 50)
    assert verdicts({"cases": {"c, 500 Hz, quiet": case}}, realtime.GOALS)["quiet stops"]["reached"] == "no"


def test_first_screen_and_page_show_the_cases_with_their_goals():
    cases = {"c, 500 Hz, quiet": realtime.summarise([run_of(100_000, missed=1)]),
             "c, 500 Hz, loaded": realtime.summarise([run_of(1000, missed=3, rcm=2.5)]),
             "python, 1000 Hz, loaded": realtime.summarise([run_of(1000, rcm=1.0)])}  # fmt: skip
    summary = {"cases": cases, "goals": verdicts({"cases": cases}, realtime.GOALS)}
    runs = {Case("c", 500, "quiet"): [run_of(1000, missed=1)], Case("c", 500, "loaded"): [run_of(1000)]}
    first = clock.answer(summary, runs)
    assert "C, 500 Hz 1 of 100,000; 0 times" in first.sentences[0]
    assert "3 of 2,000 were missed, the largest RCM error was 2.50 mm" in first.sentences[1]
    assert "2 of 5 goals are reached, 1 open, 1 not measured; missed: largest RCM" in first.sentences[2]
    assert [row["goal"].word for row in first.table.rows] == ["open", "missed", "met"]
    html = clock.report(summary, realtime.GOALS, runs, first, {}).html()
    assert "1e-05 [" in html
    first_screens.check(html, pictures=1)


def test_the_page_has_a_row_a_case():
    tail = run_of(30_000, missed=7, ended="stopped: no command")._replace(overruns=3)
    cases = {"c, 500 Hz, quiet": realtime.summarise([tail]),
             "python, 500 Hz, loaded": realtime.summarise([run_of(1000, rcm=1.25)])}  # fmt: skip
    summary = {"cases": cases, "goals": verdicts({"cases": cases}, realtime.GOALS)}
    environment = {"machine": {"cores": 2, "processor": "a processor"}, "config": {"cycles": 1000}, "seed": 0}
    text = clock.page_text(summary, environment)
    assert "`python -m benchmarks.realtime --cycles 1000 --page` (2 cores, a processor, seed 0)" in text
    assert "| case | cycles | missed | in 100,000 | plant stalled | wake-up latency [us] | round trip [us] |" in text
    times = "1,500 / 2,970 / 3,000 / 3,000 | 15,000 / 29,700 / 29,997 / 30,000 | 10 / 10 / 10 / 10"
    assert re.search(rf"\| C, 500 Hz, quiet \| 30.?000 \| 7 \| 23 \[9.4, 48\] \| 3 \| {re.escape(times)} \| 1 \|", text)
    assert text.endswith(clock.sentences(summary)[-1])
    assert f"<!-- {clock.SECTION} -->" in clock.PAGE.read_text()


def test_the_page_shows_the_configuration_that_ships_alone(tmp_path, capsys):
    shipped = realtime.Config.load(default_config("realtime"))
    realtime.check_page(shipped.model_copy(update={"cycles": 7}))
    with pytest.raises(MocOptError, match="--page: the page shows"):
        realtime.check_page(shipped.model_copy(update={"rates_Hz": [500]}))
    before = clock.PAGE.read_bytes()
    assert realtime.main(["--quick", "--page", "--out", str(tmp_path)]) == 2
    assert "--page: the page shows" in capsys.readouterr().err
    assert clock.PAGE.read_bytes() == before


@pytest.mark.parametrize("rate", [250, 500, 1000])
def test_the_file_of_a_run_is_the_scenario_at_that_rate(tmp_path, rate):
    config = realtime.Config.load(Path(realtime.__file__).parent / "configs" / "realtime.toml")
    file = tmp_path / "run.toml"
    wire.run_of(config.scenario.change(guard={"patience_ticks": 7}), rate, 1234, 7).save(file)
    found = Scenario.load(file)
    assert found.plant.period_s == 1.0 / rate
    assert found.plant.substep_s <= 0.001
    assert (found.duration_s, found.seed) == (pytest.approx(1234 / rate), 7)
    assert found.task == config.scenario.task
    assert found.guard.patience_ticks == 7, "nothing of the configuration's scenario is lost"
    assert not found.judge


def test_the_load_is_there_and_then_is_not(monkeypatch):
    started = []

    class Process:
        def __init__(self, command):
            started.append(self)
            self.killed = False

        def kill(self):
            self.killed = True

        def wait(self):
            assert self.killed

    monkeypatch.setattr(wire.subprocess, "Popen", Process)
    with wire.load("quiet"):
        assert started == []
    with wire.load("loaded"):
        assert len(started) == os.cpu_count()
    assert all(process.killed for process in started)


def test_a_command_that_was_stopped_goes_on(tmp_path, monkeypatch):
    made = []

    def run_once(*of):
        if len(made) == 2:
            raise KeyboardInterrupt
        made.append(of)
        return run_of(100)

    monkeypatch.setattr(wire, "run_once", run_once)
    file = tmp_path / "few.toml"
    file.write_text("cycles = 300\nrun_cycles = 100\nrates_Hz = [500]\ncontrollers = ['python']\nloads = ['quiet']\n")
    command = [str(file), "--out", str(tmp_path / "out"), "--json"]
    assert realtime.main(command) == 130
    made.clear()
    assert realtime.main(command) == 0
    assert len(made) == 1, "of three runs two were done"


def test_runs_that_stop_early_are_repeated_but_not_for_ever(tmp_path, monkeypatch):
    monkeypatch.setattr(wire, "run_once", lambda *of: run_of(40, ended="stopped: x"))
    config = realtime.Config(cycles=100, run_cycles=100, controllers=["python"])
    assert len(config.cases()) == 4
    found = realtime.runs_of(config, tmp_path, Kept(tmp_path / "jobs"), {})
    assert [len(runs) for runs in found.values()] == [3] * 4


def test_a_run_by_both_commands(tmp_path):
    """How many cycles are missed is the machine's affair; that they are counted is not."""
    file = tmp_path / "run.toml"
    config = realtime.Config.load(Path(realtime.__file__).parent / "configs" / "realtime.toml")
    wire.run_of(config.scenario, 250, 100, 0).save(file)
    found = wire.run_once(Case("python", 250, "quiet"), file, None, 600.0)
    assert found.clean
    assert len(found.round_us) == len(found.wake_us) == len(found.control_us)
    assert np.isnan(found.control_us).sum() == found.missed < len(found.round_us)
    assert (np.isfinite(found.control_us) <= (found.round_us > 0.0)).all()
    assert set(found.system) == {"plant", "controller"}
    assert {"scheduling", "memory"} <= set(found.system["plant"])
    if found.ended == "completed":
        assert len(found.round_us) == 100


def test_of_a_run_that_was_stopped_the_cycles_before_count():
    columns = {
        "t_s": 0.002 * np.arange(100), "wake_us": np.arange(100.0), "tick_us": np.full(100, 9.0),
        "control_us": np.full(100, 2.0), "missed": np.arange(100) >= 50, "rcm_error_registered_m": np.full(100, 1e-3),
        "v_rad_per_s": np.zeros((100, 7)),
    }  # fmt: skip
    meta = {"wire": {"missed": 50, "overruns": 4, "system": {}}, "ended": "stopped: x", "stopped_at_s": 0.002 * 60}
    found = wire._read(Trace(columns, meta), {"system": {}}, "now")
    assert (len(found.round_us), found.missed, found.overruns, found.clean) == (61, 11, 4, True)
    moving = columns | {"v_rad_per_s": np.full((100, 7), 0.1)}
    far = columns | {"rcm_error_registered_m": np.full(100, 3e-3)}
    for unclean in (moving, far):
        assert not wire._read(Trace(unclean, meta), {"system": {}}, "now").clean
    assert not wire._read(Trace(columns, meta | {"ended": "ran away"}), {"system": {}}, "now").clean


def test_a_process_that_fails_is_an_error_and_not_a_figure(tmp_path, monkeypatch):
    file = tmp_path / "run.toml"
    file.write_text("no = 1\n")
    with pytest.raises(RealtimeError, match="did not start"):
        wire.run_once(CASE, file, None, 60.0)
    file.write_text("duration_s = 0.1\nbound_samples = 0\n[wire]\nwait_s = 1.0\n")
    with pytest.raises(RealtimeError, match="no controller came"):
        wire.run_once(CASE, file, Path(sys.executable), 60.0)  # exits at once: 127.0.0.1 is no script

"""The benchmark against the clock: what it counts, and that a run of it is a run over the wire."""

from __future__ import annotations

import io
import os
import sys
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from benchmarks import realtime
from benchmarks.common.kept import Kept
from benchmarks.common.output import default_config
from benchmarks.latency import clock, clock_page, wire
from benchmarks.latency.goals import goal_verdicts
from benchmarks.latency.wire import Case, Found, RealtimeError
from moc_opt.errors import MocOptError
from moc_opt.scenario import Scenario
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
    found = goal_verdicts(summary, realtime.GOALS)
    assert found["c"]["reached"] == reached
    assert found["python"]["reached"] == found["rcm"]["reached"] == "not measured"


def test_a_controller_that_stops_in_every_run_misses_a_goal():
    case = realtime.summarise([run_of(20_000, ended="stopped: asked for")] * 50)
    found = goal_verdicts({"cases": {"c, 500 Hz, quiet": case}}, realtime.GOALS)
    assert found["quiet stops"]["reached"] == "no"


def test_an_open_goal_is_counted_and_shown_with_its_interval():
    summary = {"cases": {"c, 500 Hz, quiet": realtime.summarise([run_of(100_000, missed=1)])}}
    summary["goals"] = goal_verdicts(summary, realtime.GOALS)
    assert "1 of 5 goals are reached, 1 open, 3 not measured" in clock.sentences(summary)[-1]
    assert clock.tables(summary)[0].rows[0]["value"].startswith("1e-05 [")


def test_the_goals_under_load_look_at_every_loaded_case_and_at_no_other():
    good, bad = ({"cycles": 9, "unclean": k, "rcm_max_mm": 1.0 + 2.0 * k} for k in (0, 1))
    for name, reached in (("c, 1000 Hz, loaded", "no"), ("c, 1000 Hz, quiet", "yes")):
        found = goal_verdicts({"cases": {"python, 500 Hz, loaded": good, name: bad}}, realtime.GOALS)
        assert found["rcm"]["reached"] == found["stops"]["reached"] == reached


def test_tables_and_headline_say_what_was_found():
    summary = {"cases": {"c, 500 Hz, quiet": realtime.summarise([run_of(1000, missed=7)])}}
    summary["goals"] = goal_verdicts(summary, realtime.GOALS)
    goals, cycles, latencies = clock.tables(summary)
    words = {row["what"]: row["reached"] for row in goals.rows}
    assert words.pop("runs that were stopped, on a quiet machine") == "yes"
    assert list(words.values()) == ["not measured"] * 4
    assert cycles.rows[0]["missed"] == 7
    assert [(row["what"], row["worst"]) for row in latencies.rows] == [
        ("wake-up latency", 100.0), ("round trip", 1000.0), ("controller", 10.0)
    ]  # fmt: skip
    runs = {Case("c", 500, "quiet"): [run_of(1000, missed=7)]}
    first = clock.answer(summary, runs)
    assert first.sentences[0] == (
        "Cycles missed on a quiet machine: C, 500 Hz 7 of 1,000; 0 times the plant's own process was not run for a "
        "period."
    )
    assert "(7 cycles)" in first.pictures[0].says
    (line,) = first.table.rows
    assert (line["name"], line["missed"], line["goal"].word) == ("C, 500 Hz, quiet", 7, "not measured")
    page = clock.report(summary, runs, first, {})
    assert list(page.figures) == ["round-500", "wake-500", "control-500"]
    html = page.html()
    places = [html.index(f'id="{name}"') for name in ("wake-500", "cycles-and-stops", "control-500")]
    assert places == sorted(places), "pictures before what is folded"
    first_screens.check(html, pictures=2)


def test_what_harms_under_load_is_said_and_marked():
    cases = {"c, 500 Hz, loaded": realtime.summarise([run_of(1000, missed=3, rcm=2.5)]),
             "python, 1000 Hz, loaded": realtime.summarise([run_of(1000, rcm=1.0)])}  # fmt: skip
    summary = {"cases": cases, "goals": goal_verdicts({"cases": cases}, realtime.GOALS)}
    first = clock.answer(summary, {Case("c", 500, "loaded"): [run_of(1000, missed=3)]})
    assert "3 of 2,000 were missed" in first.sentences[0]
    assert "largest RCM error was 2.50 mm, and no run ended in a stop" in first.sentences[0]
    assert [row["goal"].word for row in first.table.rows] == ["missed", "met"]
    screen = Console(file=io.StringIO(), width=80, color_system=None)
    for part in first.screens(80):
        screen.print(part, markup=False)
    assert max(map(len, screen.file.getvalue().splitlines())) <= 80
    assert all(word in screen.file.getvalue() for word in ("p99.99", "RCM", "Python, 1000 Hz, loaded"))


def test_the_page_has_a_row_a_case():
    tail = run_of(30_000, missed=7, ended="stopped: no command")._replace(overruns=3)
    cases = {"c, 500 Hz, quiet": realtime.summarise([tail]),
             "python, 500 Hz, loaded": realtime.summarise([run_of(1000, rcm=1.25)])}  # fmt: skip
    summary = {"cases": cases, "goals": goal_verdicts({"cases": cases}, realtime.GOALS)}
    config = {"cycles": 1000}
    environment = {"machine": {"cores": 2, "processor": "a processor"}, "config": config, "seed": 0}
    text = clock_page.page_text(summary, environment)
    assert "`python -m benchmarks.realtime --cycles 1000 --page` (2 cores, a processor, seed 0)" in text
    heads = "case | cycles | missed | in 100,000 | plant stalled | wake-up latency | round trip | controller | stops |"
    assert f"| {heads} RCM error, worst [mm] |" in text
    wake, round_trip = "1,500 / 2,970 / 3,000 / 3,000", "15,000 / 29,700 / 29,997 / 30,000"
    line = f"| C, 500 Hz, quiet | 30,000 | 7 | 23 [9.4, 48] | 3 | {wake} | {round_trip} | 10 / 10 / 10 / 10 |"
    assert f"{line} 1 | 0.50 |" in text
    assert "| 0 | 1.25 |" in text


def test_the_page_shows_the_configuration_that_ships_alone(tmp_path, capsys):
    shipped = realtime.Config.load(default_config("realtime"))
    realtime.check_page(shipped.model_copy(update={"cycles": 7}))
    with pytest.raises(MocOptError, match="--page: the page shows"):
        realtime.check_page(shipped.model_copy(update={"rates_Hz": [500]}))
    before = clock_page.PAGE.read_bytes()
    assert realtime.main(["--quick", "--page", "--out", str(tmp_path)]) == 2
    assert "--page: the page shows" in capsys.readouterr().err
    assert clock_page.PAGE.read_bytes() == before


def test_the_page_ends_with_the_sentences_of_the_first_screen():
    cases = {"c, 500 Hz, quiet": realtime.summarise([run_of(1000, missed=7)])}
    summary = {"cases": cases, "goals": goal_verdicts({"cases": cases}, realtime.GOALS)}
    environment = {"machine": {"cores": 2, "processor": "a processor"}, "config": {"cycles": 1000}, "seed": 0}
    text = clock_page.page_text(summary, environment)
    assert text.endswith(clock.sentences(summary)[-1])
    assert f"<!-- {clock_page.SECTION} -->" in clock_page.PAGE.read_text()


def test_the_histogram_holds_every_cycle():
    times = {"a": np.r_[np.full(999, 100.0), 5000.0], "b": np.full(10, 0.0)}
    drawn = clock.histogram(times, 2000.0)
    assert [np.nansum(line.y) for line in drawn.data] == [1000, 10]
    a = drawn.data[0]
    assert a.x[np.flatnonzero(np.nan_to_num(a.y) == 1)[-1]] == pytest.approx(5000.0, rel=0.1)


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


def test_cases_and_runs_are_as_many_as_asked_for(monkeypatch):
    assert len(realtime.Config().cases()) == len(set(map(str, realtime.Config().cases()))) == 8
    asked = []

    def run(number):
        asked.append(number)
        return run_of(400, ended="stopped: x")

    assert len(wire.measure(run, 1000, 99)) == 3
    assert asked == [0, 1, 2]
    assert len(wire.measure(run, 1000, 2)) == 2


def test_a_run_that_is_done_is_kept_as_it_was(tmp_path):
    made = run_of(10, missed=1)
    Kept(tmp_path, {}).of("first", lambda: made)
    again = Kept(tmp_path, {}).of("first", lambda: pytest.fail("it is there"))
    for name, value in made._asdict().items():
        np.testing.assert_array_equal(getattr(again, name), value)


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

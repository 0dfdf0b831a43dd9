"""A run over the wire (UDP) equals the simulated run and survives faulty packets."""

import json
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from moc_opt.realtime.wire import COUNTERS, RUNNING, Kind, WireError, written
from moc_opt.scenario import Scenario, run
from moc_opt.scenario.wired import PlantServer, answer, fingerprint
from moc_opt.trace.trace import Trace
from tests.realtime.relay import FAULTS, TO_CONTROLLER, TO_PLANT, Relay

SHORT = {"duration_s": 0.6, "bound_samples": 0, "judge": False}


def wired(scenario, relayed=None):
    """Run in lock-step, with plant and controller in two threads."""
    plant = PlantServer(scenario, "127.0.0.1:0", lock_step=True)
    with ThreadPoolExecutor(1) as pool:
        if relayed is None:
            controller = pool.submit(answer, scenario, written(plant.address))
            return plant.trace(), controller.result(), None
        with Relay(plant.address, **relayed) as relay:
            controller = pool.submit(answer, scenario, relay.address)
            return plant.trace(), controller.result(), relay


def assert_same(found, expected):
    assert set(found.columns) == set(expected.columns) | {"wake_us", "control_us", "missed"}
    assert found.meta["ended"] == expected.meta["ended"]
    for name in expected.columns.keys() - {"tick_us", "solve_us"}:
        column = expected.columns[name]
        if column.dtype.kind == "f":
            np.testing.assert_allclose(found.columns[name], column, rtol=1e-12, atol=1e-12, err_msg=name)
        else:
            np.testing.assert_array_equal(found.columns[name], column, err_msg=name)


RUNS = {
    "default": {}, "dcac": {"control": {"law": "dcac"}}, "eight joints": {"robot": {"name": "lwr4_rail"}},
    "bad sensors": {"faults": {"drop_share": 0.1, "late_ticks": 1, "bump_N": 20.0, "bump_at_s": 0.2}},
    "spoilt answers": {"faults": {"solver": "nan", "solver_share": 0.3}},
    "stopped": {"faults": {"nan_at_s": 0.3, "nan_ticks": 100}},
    "warned": {"guard": {"trocar_force_warning_N": 0.1, "rcm_warning_m": 1e-4}},
}  # fmt: skip


@pytest.mark.parametrize("name", RUNS)
def test_run_over_the_wire_equals_the_simulated_run(name):
    scenario = Scenario(**SHORT, seed=3, **RUNS[name])
    found, ending, _ = wired(scenario)
    expected = run(scenario)
    assert_same(found, expected)
    assert not found.columns["missed"].any()
    assert expected.meta["ended"].startswith(ending["ended"])
    assert ending["ticks"] == len(expected) == ending["quality"]["received"]
    for entry, without in (("faults", {}), ("warnings", [])):
        assert ending[entry] == expected.meta.get(entry, without)
    assert found.meta.get("stopped_at_s") == expected.meta.get("stopped_at_s")
    assert expected.meta.get({"warned": "warnings", "spoilt answers": "faults"}.get(name, "ended"))
    assert sum(ending["quality"].values()) == ending["ticks"]
    assert found.meta["wire"] == dict.fromkeys(COUNTERS, 0) | {"received": len(expected)}


def test_faults_of_the_wire_do_not_change_a_run_in_lock_step():
    scenario = Scenario(**SHORT, wire={"resend_s": 0.02, "resends": 1000})
    found, ending, relay = wired(scenario, {"share": 0.04, "seed": 1})
    expected = run(scenario)
    assert_same(found, expected)
    counts = found.meta["wire"]
    for end, direction in ((counts, TO_PLANT), (ending["quality"], TO_CONTROLLER)):
        done, whole = relay.done[direction], relay.whole[direction]
        assert all(done[fault] for fault in FAULTS)
        assert end["forged"] == done["forge"]
        assert 0 <= end["foreign"] - done["cut"] <= 10  # repeated handshake packets count as foreign
        of_ticks = sum(count for (kind, flags), count in whole.items() if kind is Kind.COMMAND or flags == RUNNING)
        assert end["received"] + end["late"] == of_ticks
        assert end["late"] > 5
    assert ending["quality"]["received"] == ending["ticks"] == len(expected)
    assert counts["missed"] == ending["quality"]["missed"] == 0
    assert ending["ended"] == found.meta["ended"] == "completed"


# The plant waits 0.33 s for each command, which is enough on a busy machine.
BLIND = {"resend_s": 0.33, "resends": 0, "hold_ticks": 3, "damp_ticks": 5}


def test_brakes_close_after_several_missing_commands():
    gaps = [range(50, 52), range(100, 106), range(220, 10_000)]
    scenario = Scenario(**SHORT, wire=BLIND)
    found, ending, _ = wired(scenario, {"lost": lambda kind, k: kind is Kind.COMMAND and any(k in gap for gap in gaps)})
    assert ending["ended"] == "the plant ended the run at tick 229 of 300"
    assert np.flatnonzero(found.columns["missed"]).tolist() == [*gaps[0], *gaps[1], *range(220, 229)]
    assert found.meta["ended"].startswith("stopped: no command from the controller for 9 ticks")
    assert found.meta["stopped_at_s"] == pytest.approx(0.002 * (220 + 8))
    assert found.rcm_error_registered_m.max() < 2e-3
    assert np.abs(found.v_rad_per_s[-1]).max() < 1e-3


def test_controller_stops_the_arm_if_several_measurements_are_missing():
    few, many = {60, 61}, range(150, 156)
    lost = {"lost": lambda kind, k: kind is Kind.MEASUREMENT and (k in few or k in many)}
    found, ending, _ = wired(Scenario(**SHORT, wire=BLIND), lost)
    assert found.columns["missed"][sorted(few)].all()
    reason, _, _ = found.meta["ended"].partition(" (t =")
    assert reason.startswith("stopped: ")
    assert "ticks late" in reason
    assert ending["ended"] == reason
    assert 0.002 * 156 <= found.meta["stopped_at_s"] <= 0.002 * 166
    assert ending["quality"]["missed"] >= len(few) + len(many)
    assert found.rcm_error_registered_m.max() < 2e-3
    assert np.abs(found.v_rad_per_s[-1]).max() < 1e-3


def test_run_in_real_time_completes_or_stops_cleanly(tmp_path):
    """How many ticks are missed depends on the machine, so both endings are allowed."""
    file, trace = tmp_path / "run.toml", tmp_path / "run.parquet"
    file.write_text("duration_s = 0.4\nbound_samples = 0\n[plant]\nperiod_s = 0.004\nsubsteps = 4\n")
    key = tmp_path / "key"
    key.write_text("0123456789abcdef0123456789abcdef\n")

    def started(command, *options):
        line = [sys.executable, "-m", "moc_opt", command, str(file), "--key-file", str(key), "--json", *options]
        return subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    plant = started("plant", "--listen", "127.0.0.1:0", "--trace", str(trace))
    control = started("control", "--connect", plant.stderr.readline().split()[-1])
    (answers, wrong), (said, errors) = control.communicate(timeout=120), plant.communicate(timeout=120)
    assert plant.returncode in (0, 3), errors
    saved = Trace.load(trace)
    assert json.loads(said)["ended"] == saved.meta["ended"]
    assert control.returncode in (0, 3), wrong
    assert json.loads(answers)["ticks"] <= len(saved)
    assert saved.columns["missed"].sum() == saved.meta["wire"]["missed"]
    assert np.nanmin(saved.columns["wake_us"]) > -1.0
    assert saved.rcm_error_registered_m.max() < 2e-3


def test_both_ends_need_the_same_scenario_except_for_control_and_guard():
    base = Scenario(**SHORT)

    def sent(scenario):
        return fingerprint(scenario, scenario.robot.arm())

    assert sent(base) == sent(base.change(control={"law": "dcac"}, guard={"patience_ticks": 5}))
    others = (
        {"seed": 1}, {"task": {"path": "line"}}, {"trocar": {"depth_m": 0.14}}, {"plant": {"period_s": 0.001}},
        {"robot": {"name": "lwr4", "tool_mass_kg": 0.31}},
    )  # fmt: skip
    assert len({sent(base), *(sent(base.change(**other)) for other in others)}) == 6
    plant = PlantServer(base.change(wire={"wait_s": 20.0}), "127.0.0.1:0", lock_step=True)
    with ThreadPoolExecutor(1) as pool:
        run_there = pool.submit(plant.trace)
        with pytest.raises(WireError, match="another scenario"):
            answer(base.change(seed=1), written(plant.address))
        answer(base, written(plant.address))  # the plant still waits for its controller
        assert run_there.result().meta["ended"] == "completed"


def test_controller_printed_in_the_documentation_answers_every_tick():
    page = (Path(__file__).parents[2] / "docs" / "realtime.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    (shown,) = (text for text in blocks if "HEADER" in text)
    plant = PlantServer(Scenario(duration_s=0.1, bound_samples=0), "127.0.0.1:0", lock_step=True)
    shown = shown.replace("30200", str(plant.address[1]))
    with ThreadPoolExecutor(1) as pool:
        controller = pool.submit(exec, shown, {})
        found = plant.trace()
        controller.result()
    assert found.meta["ended"] == "completed"
    assert not found.columns["missed"].any()
    wire = found.meta["wire"]
    assert wire["received"] == len(found) == 50
    assert sum(wire[name] for name in ("late", "forged", "foreign")) == 0

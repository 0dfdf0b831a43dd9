"""The exported program as a controller over UDP."""

import json
import shutil
import subprocess
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from moc_opt.realtime.wire import Kind
from moc_opt.scenario import Scenario, run
from moc_opt.scenario.wired import PlantServer, answer
from moc_opt.trace.trace import Trace
from tests.export.conftest import FLAGS, Export, make
from tests.realtime.relay import FAULTS, TO_CONTROLLER, Relay

BASE: dict[str, Any] = {
    "duration_s": 0.6, "bound_samples": 0, "plant": {"preset": "realistic"},
    "wire": {"resend_s": 0.02, "resends": 1000},
}  # fmt: skip
RUNS: dict[str, dict[str, Any]] = {
    "default": {}, "dcac": {"control": {"law": "dcac"}},
    "bad sensors": {"faults": {"drop_share": 0.1, "late_ticks": 1}},
    "stopped": {"faults": {"nan_at_s": 0.3, "nan_ticks": 100}},
}  # fmt: skip


Built = Callable[[str], tuple[Scenario, Path]]


@pytest.fixture(scope="module")
def built(exported: Export) -> Built:
    """Map the name of a run to (scenario, folder of the program)."""

    @cache
    def build(name: str) -> tuple[Scenario, Path]:
        scenario = Scenario(**BASE, **RUNS[name])
        folder = exported(scenario, udp=True)
        done = make(folder, "moc_udp", FLAGS)
        if "openssl/core_names.h" in done.stderr:
            pytest.skip("no headers of OpenSSL")
        assert done.returncode == 0, done.stdout + done.stderr
        return scenario, folder

    return build


def served(scenario: Scenario, controller: Callable[[str], Any], **relayed: Any) -> tuple[Trace, Any, Relay]:
    """Return (trace, controller's result, relay) of a run in lock-step."""
    plant = PlantServer(scenario, "127.0.0.1:0", lock_step=True)
    with ThreadPoolExecutor(1) as pool, Relay(plant.address, seed=2, **relayed) as relay:
        said = pool.submit(controller, relay.address)
        return plant.trace(), said.result(), relay


def ran(folder: Path, *arguments: str, **options: Any) -> subprocess.CompletedProcess[str]:
    command = [str(folder / "moc_udp"), *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False, **options)


def program(folder: Path, address: str) -> tuple[dict[str, Any], int]:
    done = ran(folder, *address.split(":"), str(folder / "reference.bin"))
    assert done.returncode in (0, 3), done.stderr
    return json.loads(done.stdout), done.returncode


@pytest.mark.parametrize("name", RUNS)
def test_program_controls_exactly_as_python_does(built: Built, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    scenario, folder = built(name)
    monkeypatch.setenv("MOC_OPT_WIRE_KEY", {"dcac": "k" * 16, "stopped": "k" * 32}.get(name, ""))
    found, (said, status), _ = served(scenario, partial(program, folder))
    expected = run(scenario)
    assert len(found) == len(expected)
    of_moc = {"fault", "limited", "x_rad_per_s", "applied_x_rad_per_s", "subproblem", "verified"}
    for name in ("tau_Nm", "q_rad", "tip_error_m", "rcm_error_m", "mu", *of_moc & {*expected.columns}):
        np.testing.assert_array_equal(found.columns[name], expected.columns[name], err_msg=name)
    assert said["ticks"] == len(expected)
    assert not found.columns["missed"].any()
    assert status == (0 if expected.meta["ended"] == "completed" else 3)
    assert said["ended"].split(" ")[0].rstrip(":") == expected.meta["ended"].split(":")[0]
    assert found.meta.get("stopped_at_s") == expected.meta.get("stopped_at_s")
    if status:
        assert "measurements not believed" in said["ended"]
        assert found.meta["ended"] == expected.meta["ended"]


@pytest.mark.parametrize("name", ["default", "stopped"])
def test_network_faults_do_not_change_the_run(built: Built, name: str) -> None:
    scenario, folder = built(name)
    found, (said, _), relay = served(scenario, partial(program, folder), share=0.04)
    expected = run(scenario)
    np.testing.assert_array_equal(found.q_rad, expected.q_rad)
    done = relay.done[TO_CONTROLLER]
    assert all(done[fault] for fault in FAULTS)
    assert said["ignored"] >= done["forge"] + done["cut"]
    assert said["ticks"] == len(expected)


def test_c_and_python_give_the_same_run_if_commands_are_lost(built: Built) -> None:
    """Commands 50 and 51 are lost. From 100 on, all commands are lost, and the plant brakes."""
    scenario, folder = built("default")
    blind = scenario.change(wire={"resend_s": 0.33, "resends": 0, "hold_ticks": 2, "damp_ticks": 0})

    def lost(kind: Kind, number: int) -> bool:
        return kind is Kind.COMMAND and (number in (50, 51) or number >= 100)

    found, (said, status), _ = served(blind, partial(program, folder), lost=lost)
    expected, *_ = served(blind, partial(answer, blind), lost=lost)
    np.testing.assert_array_equal(found.q_rad, expected.q_rad)
    assert found.meta["ended"].startswith("stopped: no command from the controller")
    assert (said["ended"], status, said["ticks"]) == ("the plant ended the run early", 3, 103)


def test_program_allocates_no_heap_memory(built: Built) -> None:
    if shutil.which("nm") is None:
        pytest.skip("no nm")
    command = ["nm", "-u", built("default")[1] / "moc_udp"]
    names = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert "sendto" in names
    assert not {"malloc", "calloc", "realloc", "free"} & {name.split("@")[0].split()[-1] for name in names.splitlines()}


def test_wrong_arguments_are_refused(built: Built, tmp_path: Path) -> None:
    folder, short = built("default")[1], tmp_path / "short"
    reference = str(folder / "reference.bin")
    short.write_bytes((folder / "reference.bin").read_bytes()[:-8])
    for words, arguments, key in (
        ("usage", (), ""), ("not the file", ("127.0.0.1", "1", str(short)), ""),
        ("numbers", ("localhost", "1", reference), ""), ("numbers", ("127.0.0.1", "1x", reference), ""),
        ("numbers", ("192.0.2.1", "70000", reference), "0123456789abcdef"),
        ("other machines", ("192.0.2.1", "1", reference), ""), ("16 to 32", ("192.0.2.1", "1", reference), "x" * 33),
    ):  # fmt: skip
        done = ran(folder, *arguments, env={"MOC_OPT_WIRE_KEY": key})
        assert done.returncode == 2
        assert words in done.stderr

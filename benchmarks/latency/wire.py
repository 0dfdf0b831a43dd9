"""Runs against the clock: plant and controller as processes of their own, the machine quiet or loaded."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from moc_opt.arrays import Array
from moc_opt.errors import MocOptError
from moc_opt.export import export_scenario
from moc_opt.scenario import Scenario
from moc_opt.trace.trace import Trace

SPARE_S = 300.0
"""Beyond the run itself: starting both processes, judging and saving the trace."""
SAFE_RCM_M, AT_REST_RAD_PER_S = 2e-3, 1e-2
"""A stop is clean where the RCM error stayed below the one and the arm stands at its end."""
MOC_OPT = (sys.executable, "-m", "moc_opt")
_BURN = "while True:\n    sum(i * i for i in range(100000))"


class RealtimeError(MocOptError, RuntimeError):
    """A process of a run ended otherwise than it should."""


@dataclass(frozen=True)
class Case:
    """What is measured: which controller, at which rate, on which machine."""

    controller: str
    rate_Hz: int
    load: str

    def __str__(self) -> str:
        return f"{self.controller}, {self.rate_Hz} Hz, {self.load}"


class Found(NamedTuple):
    """One run: times of every cycle [us] up to a stop, and how it went."""

    wake_us: Array
    round_us: Array
    control_us: Array
    missed: int
    overruns: int
    ended: str
    clean: bool
    rcm_max_mm: float
    system: dict[str, Any]
    begun: str


@contextmanager
def load(kind: str) -> Iterator[None]:
    """Keep every core busy meanwhile, or none."""
    count = 0 if kind == "quiet" else os.cpu_count() or 1
    busy = [subprocess.Popen([sys.executable, "-c", _BURN]) for _ in range(count)]
    try:
        yield
    finally:
        for process in busy:
            process.kill()
            process.wait()


def run_of(scenario: Scenario, rate_Hz: int, cycles: int, seed: int) -> Scenario:
    """Return the scenario as a run of so many cycles at a rate."""
    plant = {"period_s": 1.0 / rate_Hz, "substeps": max(1, round(1000 / rate_Hz))}
    return scenario.change(
        name="realtime", seed=seed, duration_s=cycles / rate_Hz, plant=plant, judge=False, bound_samples=0
    )


def build(file: Path, folder: Path) -> Path:
    """Export and compile the controller of a scenario's file as a program.

    Raises:
        RealtimeError: make or the compiler failed.
    """
    export_scenario(Scenario.load(file), folder, udp=True)
    done = subprocess.run(["make", "-C", str(folder), "moc_udp"], capture_output=True, text=True, check=False)
    if done.returncode:
        raise RealtimeError(f"make moc_udp failed:\n{done.stderr[-2000:]}")
    return folder / "moc_udp"


def run_once(case: Case, file: Path, program: Path | None, limit_s: float) -> Found:
    """Run a scenario's file; ``program`` is the C controller, None: Python's.

    Raises:
        RealtimeError: one of the two processes failed, or took longer than ``limit_s``.
    """
    begun = datetime.now(UTC).isoformat(timespec="seconds")
    with tempfile.TemporaryDirectory(prefix="moc-opt-") as folder, load(case.load):
        trace = Path(folder, "run.parquet")
        plant = _start(*MOC_OPT, "plant", str(file), "--listen", "127.0.0.1:0", "--trace", str(trace), "--json")
        control: subprocess.Popen[str] | None = None
        try:
            assert plant.stderr is not None
            first = plant.stderr.readline()
            if not first.startswith("listening on "):
                raise RealtimeError(f"the plant did not start: {first}{plant.stderr.read()}"[:1000])
            host, port = first.split()[-1].split(":")
            if program is None:
                control = _start(*MOC_OPT, "control", str(file), "--connect", f"{host}:{port}", "--json")
            else:
                control = _start(str(program), host, port, str(program.parent / "reference.bin"))
            said, errors = control.communicate(timeout=limit_s)
            _, wrong = plant.communicate(timeout=limit_s)
        except subprocess.TimeoutExpired as error:
            raise RealtimeError(f"{case}: not done after {limit_s:.0f} s") from error
        finally:
            for process in (plant, control):
                if process is not None and process.poll() is None:
                    process.kill()
        if plant.returncode not in (0, 3) or control.returncode not in (0, 3):
            raise RealtimeError(f"{case}: plant: {wrong[-500:]} controller: {errors[-500:]}")
        return _read(Trace.load(trace), json.loads(said), begun)


def _start(*command: str) -> subprocess.Popen[str]:
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def _read(trace: Trace, said: dict[str, Any], begun: str) -> Found:
    """Return what a trace and the controller's last words say of a run."""
    columns, wire, ended = trace.columns, trace.meta["wire"], str(trace.meta["ended"])
    rcm = float(np.max(trace.rcm_error_registered_m))
    rest = bool(np.abs(trace.v_rad_per_s[-1]).max() < AT_REST_RAD_PER_S)
    clean = ended == "completed" or (ended.startswith("stopped:") and rest and rcm < SAFE_RCM_M)
    system = {"plant": wire["system"], "controller": said["system"]}
    whole = "stopped_at_s" not in trace.meta
    cycles = len(trace) if whole else int(np.searchsorted(trace.t_s, float(trace.meta["stopped_at_s"]))) + 1
    wake, round_trip, control = (columns[name][:cycles] for name in ("wake_us", "tick_us", "control_us"))
    return Found(
        wake, round_trip, control, missed=int(columns["missed"][:cycles].sum()), overruns=int(wire["overruns"]),
        ended=ended, clean=clean, rcm_max_mm=1e3 * rcm, system=system, begun=begun,
    )  # fmt: skip

"""The control tick as generated C: called from Python, timed by its own main, and in the loop."""

from __future__ import annotations

import re
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.baselines.check import Inputs
from moc_opt.control import ControlSettings
from moc_opt.embedded import NativeController, TickSpec, export, record
from moc_opt.model.robot_model import RobotModel
from moc_opt.scenario import make_solver
from moc_opt.scenario.adapter import ControllerAdapter

SOLVER = "exact"
_SAID = re.compile(r"mean ([\d.]+) us; with the clock: median ([\d.]+) us, p99\.9 ([\d.]+) us, max ([\d.]+) us")
_COMPARED = re.compile(r"largest difference from the recorded torque ([\d.e+-]+) Nm")


def native(robot: RobotModel, settings: ControlSettings, period_s: float) -> NativeController:
    """Return the compiled tick behind the interface of the loop.

    Raises:
        MocOptError: no C compiler here, or a setting that C cannot do.
    """
    return NativeController(robot, settings, make_solver(SOLVER, robot), period_s)


def disagreement_Nm(native: NativeController, python: ControllerAdapter, inputs: list[Inputs]) -> float:
    """Return the largest difference between the torques of the compiled and the Python tick on the same inputs [Nm]."""
    native.start(*inputs[0])
    state = python.controller.robot.state(*inputs[0][:2])
    python.controller.start(state, inputs[0][2], inputs[0][3])
    return max(float(np.abs(native.tick(*given) - python.tick(*given)).max()) for given in inputs)


def own_main(robot: RobotModel, settings: ControlSettings, period_s: float, inputs: list[Inputs]) -> dict[str, float]:
    """Return what the exported program says of itself: ``make`` in a folder of its own, then run it.

    Raises:
        MocOptError: a setting that C cannot do.
        OSError, subprocess.SubprocessError: no make or compiler, or the program fails its own test.
    """
    columns = [np.ascontiguousarray(column) for column in zip(*inputs, strict=True)]
    spec = TickSpec(robot, settings, make_solver(SOLVER, robot), period_s)
    recording = record(spec, *columns)
    with tempfile.TemporaryDirectory() as folder:
        export(spec, recording, folder)
        done = subprocess.run(
            ["make", "--silent", "test"], cwd=Path(folder), capture_output=True, text=True, check=True, timeout=120
        )
    said, compared = _SAID.search(done.stdout), _COMPARED.search(done.stdout)
    if said is None or compared is None:
        raise subprocess.SubprocessError(f"the exported program said {done.stdout!r:.200}: its times are not in it")
    mean, median, late, longest = map(float, said.groups())
    return {
        "own_mean_us": mean, "own_p50_us": median, "own_p99_9_us": late, "own_max_us": longest,
        "own_difference_Nm": float(compared[1]),
    }  # fmt: skip

"""From a control law to a folder of C that compiles, tests and times itself with `make test`."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from moc_opt.control import Controller, ControlSettings
from moc_opt.control.gains import GAINS
from moc_opt.control.safety_settings import SafetyFilterSettings
from moc_opt.embedded import program, source
from moc_opt.embedded.compiler import FLAGS
from moc_opt.embedded.constants import DEFAULT_SAFETY_FILTER, constants
from moc_opt.embedded.source import Recording, SafeRecording
from moc_opt.embedded.support import TickSpec, check_safety_filter
from moc_opt.embedded.symbolic import Tick, build_tick
from moc_opt.errors import ControlError
from moc_opt.model.robot_model import RobotModel
from moc_opt.numerics.arrays import Array
from moc_opt.solvers.base import Solver

LICENCE = "/* SPDX-License-Identifier: Apache-2.0 */\n"
"""Above every file in C: the folder leaves this package, and its LICENSE, behind."""


def record(spec: TickSpec, q: Array, v: Array, tip_ref: Array, trocar: Array) -> Recording:
    """Record the Python controller's answers to k consecutive ticks.

    Args:
        q, v: (k,n) measured [rad], [rad/s].
        tip_ref: (k,3,3) rows X_d, dX_d, ddX_d; trocar: (k,2,3) rows P_t, dP_t.
    """
    robot, controller = spec.robot, Controller(*spec)
    controller.start(robot.state(q[0], v[0]), tip_ref[0], trocar[0])
    ticks = zip(q, v, tip_ref, trocar, strict=True)
    tau = [controller.tick(robot.state(*seen), reference, port) for *seen, reference, port in ticks]
    return Recording(q, v, tip_ref, trocar, np.array(tau))


def c_files(spec: TickSpec, guard: SafetyFilterSettings = DEFAULT_SAFETY_FILTER) -> tuple[Tick, dict[str, str]]:
    """Generate the tick, and the C files of the bare tick, text by file name.

    Raises:
        ControlError: the generated code cannot do what a setting asks for.
    """
    tick = build_tick(spec)
    title = f"Control tick ({spec.settings.law.upper()}) of the arm {spec.robot.data.name!r}"
    texts = {"moc_tick.h": source.header(tick, title, _constants(*spec)), "moc_tick.c": source.implementation(tick)}
    texts |= constants(tick, spec, guard)
    return tick, texts | program.bare(tick)


def safe_files(spec: TickSpec, guard: SafetyFilterSettings = DEFAULT_SAFETY_FILTER) -> tuple[Tick, dict[str, str]]:
    """Generate the tick, and the C files of the whole controller: bare tick, supervisor and safety filter.

    Raises:
        ControlError: the C code cannot do what a setting asks for.
    """
    check_safety_filter(guard)
    tick, texts = c_files(spec, guard)
    return tick, texts | {"moc_arm.c": source.arm(tick)} | program.guarded(tick)


def export(
    spec: TickSpec, recording: Recording, out: str | os.PathLike[str],
    guard: SafetyFilterSettings = DEFAULT_SAFETY_FILTER, safe_recording: SafeRecording | None = None,
    extra: Mapping[str, str] = MappingProxyType({}),
) -> list[Path]:  # fmt: skip
    """Write the C files of the whole controller, their tests and a Makefile into the folder `out`.

    Args:
        recording: ticks that main.c compares the bare tick with.
        out: made if need be.
        guard: the limits that are compiled in.
        safe_recording: ticks that safe_test.c compares the whole controller with; None: that test is left out.
        extra: further files, text by name; with udp.c among them the Makefile builds moc_udp.

    Raises:
        ControlError: the generated code cannot do what a setting asks for, or `out` cannot be written.
    """
    _, texts = safe_files(spec, guard)
    texts |= program.read("main.c", "extremes.c") | {"recording.h": source.recording(recording)}
    if safe_recording is not None:
        texts |= program.read("safe_test.c") | {"safe_recording.h": source.safe_recording(safe_recording)}
    texts |= extra
    texts["Makefile"] = source.makefile(texts, " ".join(FLAGS), safe_recording is not None)
    folder, written = Path(out), []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in texts.items():
            written.append(folder / name)
            headed = f"{LICENCE}{text}" if written[-1].suffix in (".c", ".h") else text
            written[-1].write_text(headed, encoding="utf-8")
    except OSError as error:
        raise ControlError(f"out = {str(folder)!r} cannot be written: {error}") from error
    return written


def _constants(robot: RobotModel, settings: ControlSettings, solver: Solver | None, period: float) -> dict[str, Any]:
    """Return what is baked in, for the comment at the top of the header."""
    data = robot.data
    limits = {"q_min [rad]": data.q_min, "q_max [rad]": data.q_max, "v_max [rad/s]": data.v_max,
              "tau_max [Nm]": data.tau_max, "rotor inertia [kg m^2]": data.rotor_inertia}  # fmt: skip
    control = settings.model_dump(exclude={"gains", "backend"}) | settings.resolve_gains(data.gains, data.n)._asdict()
    order = [*GAINS, *(name for name in control if name not in GAINS)]
    return {
        "joints": ", ".join(data.joint_names),
        "tool length [m], mass [kg]": (data.tool_length, data.tool_mass),
        **{name: values.tolist() for name, values in limits.items()},
        "period [s]": period,
        "solver": solver,
        **{name: control[name] for name in order},
    }

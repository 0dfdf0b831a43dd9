"""From a control law to a folder of C that compiles, tests and times itself with `make test`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moc_opt.control import Controller, ControlSettings
from moc_opt.control.settings import GAINS
from moc_opt.embedded import source
from moc_opt.embedded.compiler import FLAGS
from moc_opt.embedded.source import Recording
from moc_opt.embedded.symbolic import Tick, build_tick
from moc_opt.errors import ControlError
from moc_opt.model import RobotModel
from moc_opt.solvers.base import Solver

Array = NDArray[np.float64]


def record(
    robot: RobotModel,
    settings: ControlSettings,
    solver: Solver | None,
    period: float,
    q: Array,
    v: Array,
    tip_ref: Array,
    trocar: Array,
) -> Recording:
    """Let the Python controller answer k consecutive ticks.

    Args:
        robot, settings, solver, period: as for `Controller`.
        q, v: (k,n) measured [rad], [rad/s].
        tip_ref: (k,3,3) rows X_d, dX_d, ddX_d; trocar: (k,2,3) rows P_t, dP_t.
    """
    controller = Controller(robot, settings, solver, period)
    controller.start(robot.state(q[0], v[0]), tip_ref[0], trocar[0])
    ticks = zip(q, v, tip_ref, trocar, strict=True)
    tau = [controller.tick(robot.state(*seen), reference, port) for *seen, reference, port in ticks]
    return Recording(q, v, tip_ref, trocar, np.array(tau))


def c_files(
    robot: RobotModel, settings: ControlSettings, solver: Solver | None, period: float
) -> tuple[Tick, dict[str, str]]:
    """The tick, and moc_tick.h and moc_tick.c as text by file name.

    Raises:
        ControlError: the generated code cannot do what a setting asks for.
    """
    tick = build_tick(robot, settings, solver, period)
    title = f"Control tick ({settings.law.upper()}) of the arm {robot.data.name!r}"
    texts = {
        "moc_tick.h": source.header(tick, title, _constants(robot, settings, solver, period)),
        "moc_tick.c": source.implementation(tick),
    }
    return tick, texts


def export(
    robot: RobotModel,
    settings: ControlSettings,
    solver: Solver | None,
    period: float,
    recording: Recording,
    out: str | os.PathLike[str],
) -> list[Path]:
    """Write moc_tick.c, moc_tick.h, main.c, recording.h and a Makefile into the folder `out`.

    Raises:
        ControlError: the generated code cannot do what a setting asks for, or `out` cannot be written.
    """
    tick, texts = c_files(robot, settings, solver, period)
    texts |= {
        "main.c": source.self_test(tick),
        "recording.h": source.recording(recording),
        "Makefile": source.makefile(" ".join(FLAGS)),
    }
    folder, written = Path(out), []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in texts.items():
            written.append(folder / name)
            written[-1].write_text(text, encoding="utf-8")
    except OSError as error:
        raise ControlError(f"out = {str(folder)!r} cannot be written: {error}") from error
    return written


def _constants(
    robot: RobotModel, settings: ControlSettings, solver: Solver | None, period: float
) -> dict[str, Any]:
    """What is baked in, for the comment at the top of the header."""
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

"""A scenario's controller as a folder of C, with recorded ticks that its self-tests run again."""

from __future__ import annotations

import os
from pathlib import Path
from typing import NamedTuple

import numpy as np

from moc_opt.control import Controller
from moc_opt.embedded import TickSpec, check_supported, export, program, record
from moc_opt.embedded.export import safe_files
from moc_opt.embedded.operations import worst_path
from moc_opt.embedded.source import SafeRecording
from moc_opt.embedded.support import check_safety_filter
from moc_opt.errors import ScenarioError
from moc_opt.numerics.arrays import Array
from moc_opt.realtime.c_header import c_header
from moc_opt.scenario import Scenario, Setup, make_safety_filter
from moc_opt.scenario.adapter import ControllerAdapter
from moc_opt.scenario.wired import fingerprint
from moc_opt.sim.filtered import FilteredController
from moc_opt.sim.sensors import Measurement

TICKS = 50
"""so many from the middle of the run for each self-test"""


class Exported(NamedTuple):
    """The files that were written."""

    files: list[Path]
    operations: dict[str, int]
    """floating-point operations of the longest step, by part and in all"""


def export_scenario(scenario: Scenario, out: str | os.PathLike[str], *, udp: bool = False) -> Exported:
    """Write the whole controller of a scenario as C: tick, supervisor, fallback and safety filter.

    With ``udp`` also a program that is this controller at the end of a wire, and the references of its ticks.

    Raises:
        MocOptError: a setting that C cannot do, named; the scenario cannot be run; or ``out`` cannot be written.
    """
    if scenario.solver.replay_us is not None:
        raise ScenarioError(
            f"[solver] replay_us = {scenario.solver.replay_us!r:.60}: an exported controller has the clock of its own "
            "machine; leave it out"
        )
    if scenario.solver.isolation != "none":
        raise ScenarioError(
            f"[solver] isolation = {scenario.solver.isolation!r}: an exported controller holds its solver; leave it out"
        )
    setup = Setup(
        scenario.change(judge=False, bound_samples=0, control={"backend": "python"}, faults={"solver": "none"})
    )
    law = TickSpec(setup.robot, scenario.control, setup.solver(), scenario.plant.period_s)
    check_supported(law)
    check_safety_filter(scenario.guard)
    trace, t = setup.trace(), setup.times()
    begin = min(len(trace), len(t)) // 2
    part = slice(begin, begin + TICKS)
    tip_ref, trocar = (np.stack(source.at(t[part]), axis=1) for source in (setup.reference, setup.registered))
    q, v = trace.q_rad[part], trace.v_rad_per_s[part]
    tip_ref, trocar = tip_ref[: len(q)], trocar[: len(q)]
    wrench = np.hstack([trace.columns["force_N"], trace.columns["torque_Nm"]])[part]
    recording = record(law, q, v, tip_ref, trocar)
    safe = record_with_faults(setup, q, v, tip_ref, trocar, wrench)
    extra = {}
    if udp:
        header = c_header(setup.robot.n, setup.ticks, fingerprint(scenario, setup.robot), scenario.wire)
        extra = program.read(*program.UDP) | {"wire_packets.h": header}
    files = export(law, recording, out, scenario.told_guard, safe, extra)
    if udp:
        files.append(Path(out) / "reference.bin")
        files[-1].write_bytes(reference_bytes(setup))
    return Exported(files, worst_path(safe_files(law, scenario.told_guard)[0]))


def reference_bytes(setup: Setup) -> bytes:
    """Return tip_ref (3, 3) and registered trocar (2, 3) of every tick, row by row, as little-endian doubles."""
    rows = [np.stack(of.at(setup.times()), axis=1) for of in (setup.reference, setup.registered)]
    return np.hstack([part.reshape(setup.ticks, -1) for part in rows]).astype("<f8").tobytes()


def record_with_faults(
    setup: Setup, q: Array, v: Array, tip_ref: Array, trocar: Array, wrench: Array
) -> SafeRecording:
    """Record the Python controller behind its safety filter on k consecutive measurements, some of them bad.

    As many ticks as the safety filter bridges are NaN, a joint jumps for one, references are infeasible for some, a
    joint is too fast for one; at the end the measurements are lost for good.

    Args:
        setup: of the scenario.
        q, v: (k,n) sound measurements [rad], [rad/s]; tip_ref (k,3,3), trocar (k,2,3), wrench (k,6).
    """
    scenario, k = setup.scenario, len(q)
    q, v, tip_ref = q.copy(), v.copy(), tip_ref.copy()
    borne = min(scenario.guard.patience_ticks, k // 10)
    q[k // 5 : k // 5 + borne] = np.nan
    if borne > 0:
        q[2 * k // 5, 0] += 4.0 * scenario.guard.jump_rad
    tip_ref[3 * k // 5 : 7 * k // 10, 1] += 10.0  # [m/s]
    v[4 * k // 5, -1] = 2.0 * setup.robot.v_max[-1]
    q[9 * k // 10 :] = np.nan
    controller = Controller(setup.robot, scenario.control, setup.solver(), scenario.plant.period_s)
    applied = np.clip(setup.robot.gravity(q[0]), -setup.robot.tau_max, setup.robot.tau_max)
    loop = FilteredController(ControllerAdapter(controller), make_safety_filter(setup.robot, scenario), applied)
    tau, solve_us, stopped_at = np.empty_like(q), np.zeros(k), -1
    stamp = np.arange(float(k))
    stamp[3 * k // 10] -= min(borne, 1)  # a packet comes again
    loop.start(Measurement(q[0], v[0], wrench[0], 0), tip_ref[0], trocar[0])
    for i in range(k):
        tau[i] = loop.tick(Measurement(q[i], v[i], wrench[i], int(stamp[i])), tip_ref[i], trocar[i])
        solve_us[i] = 0.0 if np.isnan(controller.solve_us) else controller.solve_us
        stopped_at = i if loop.stop_reason and stopped_at < 0 else stopped_at
    return SafeRecording(
        q=q, v=v, stamp=stamp, tip_ref=tip_ref, trocar=trocar, wrench=wrench, solve_us=solve_us, tau=tau,
        applied=applied, stopped_at=stopped_at,
    )  # fmt: skip

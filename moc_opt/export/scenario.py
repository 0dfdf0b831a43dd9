"""Export a scenario as a folder of C files."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from moc_opt.arrays import Array
from moc_opt.control import law_numbers, safety_filter
from moc_opt.errors import ScenarioError
from moc_opt.export.folder import OWN, UDP, Recording, shipped, write
from moc_opt.realtime.wire import c_packets
from moc_opt.scenario import Scenario, Setup, make_safety_filter
from moc_opt.scenario.wired import fingerprint
from moc_opt.sim.loop import FilteredController
from moc_opt.sim.sensors import Measurement
from moc_opt.solvers.exact import Exact

TICKS = 150
"""Recorded ticks, from the middle of the run."""
INFEASIBLE, VIOLENT = 0.5, 10.0  # added to the reference velocity in two faults [m/s]


def export_scenario(
    scenario: Scenario, out: str | os.PathLike[str], *, udp: bool = False, force: bool = False
) -> list[Path]:
    """Write a scenario's controller and safety filter as C files, and return the files.

    Args:
        scenario: its run is simulated to record ticks.
        out: folder, created if it does not exist.
        udp: also write a program that runs this controller over UDP.
        force: also overwrite files that were edited, or that export-c did not write.

    Raises:
        MocOptError: a setting is not supported, the scenario cannot run, or ``out`` cannot be written.
    """
    check(scenario)
    setup = Setup(scenario.change(judge=False, bound_samples=0, faults={"solver": "none"}))
    robot, period, solver = setup.robot, scenario.plant.period_s, setup.solver()
    numbers = law_numbers.numbers_of(scenario.control, robot, period)
    limits = safety_filter.numbers_of(scenario.safety_settings, robot, period)
    extra: dict[str, str | bytes] = {}
    if udp:
        packets = c_packets(robot.n, setup.ticks, fingerprint(scenario, robot), scenario.wire)
        extra |= {**shipped(OWN, UDP), "wire_packets.h": packets, "reference.bin": references(setup)}
    stop = scenario.guard.stop_damping_Nm_s_per_rad, scenario.guard.stop_s
    return write(
        robot, numbers, limits, record(setup), out, tolerance=solver.tolerance if isinstance(solver, Exact) else 1e-9,
        stop=stop, extra=extra, force=force,
    )  # fmt: skip


def check(scenario: Scenario) -> None:
    """Raise a ScenarioError if the C code does not support a setting."""
    solver, control = scenario.solver, scenario.control
    for wrong, words in (
        (control.law == "moc" and solver.name != "exact",
         f"[solver] name = {solver.name!r}: the C code contains only one solver; use 'exact'"),
        (solver.replay_us is not None,
         f"[solver] replay_us = {solver.replay_us!r:.60}: the C code replays no recorded times; remove this key"),
        (solver.isolation != "none",
         f"[solver] isolation = {solver.isolation!r}: the C code starts no other process; remove this key"),
        (control.follows,
         f"[control] third_level = {control.third_level!r}: the C code follows no planned joint motion; use 'local'"),
        (control.supervisor.budget_us is not None,
         f"[control.supervisor] budget_us = {control.supervisor.budget_us}: C code reads no clock; remove this key"),
    ):  # fmt: skip
        if wrong:
            raise ScenarioError(words)


def references(setup: Setup) -> bytes:
    """Return tip_ref (3, 3) and the registered trocar (2, 3) of every tick, as little-endian doubles."""
    return np.hstack([part.reshape(setup.ticks, -1) for part in setup.inputs()]).astype("<f8").tobytes()


def record(setup: Setup) -> Recording:
    """Feed measurements of the run to controller and safety filter. Faults are added to the last third of the ticks."""
    scenario, trace, t = setup.scenario, setup.trace(), setup.times()
    whole = min(len(trace), len(t))
    k = min(TICKS, whole)
    sound = k - k // 3
    part = slice(min(whole // 2, whole - k), min(whole // 2, whole - k) + k)
    q, v = trace.q_rad[part].copy(), trace.v_rad_per_s[part].copy()
    tip_ref, trocar = (np.stack(source.at(t[part]), axis=1) for source in (setup.reference, setup.registered))
    wrench = np.hstack([trace.columns["force_N"], trace.columns["torque_Nm"]])[part]
    stamp = np.arange(float(k))
    if sound < k:
        _spoil(setup, q[sound:], v[sound:], tip_ref[sound:], stamp[sound:])

    sent = np.clip(setup.robot.gravity(q[0]), -setup.robot.tau_max, setup.robot.tau_max)
    loop = FilteredController(setup.controller(), make_safety_filter(setup.robot, scenario), sent)
    loop.start(Measurement(q[0], v[0], wrench[0], 0), tip_ref[0], trocar[0])
    tau, stopped_at = np.empty_like(q), -1
    for i in range(k):
        tau[i] = loop.tick(Measurement(q[i], v[i], wrench[i], int(stamp[i])), tip_ref[i], trocar[i])
        stopped_at = i if loop.stop_reason and stopped_at < 0 else stopped_at
    return Recording(q, v, stamp, tip_ref, trocar, wrench, tau, sent, sound, stopped_at)


def _spoil(setup: Setup, q: Array, v: Array, tip_ref: Array, stamp: Array) -> None:
    guard, k = setup.scenario.guard, len(q)
    bridged = min(guard.patience_ticks, k // 10)
    q[k // 5 : k // 5 + bridged] = np.nan
    stamp[3 * k // 10] -= min(bridged, 1)  # as if the previous packet came again
    if bridged > 0:
        q[2 * k // 5, 0] += 4.0 * guard.jump_rad
    v[3 * k // 5, -1] = 2.0 * setup.robot.v_max[-1]
    tip_ref[7 * k // 10 : 8 * k // 10, 1] += INFEASIBLE
    tip_ref[9 * k // 10 - 1, 1] += VIOLENT
    q[9 * k // 10 :] = np.nan

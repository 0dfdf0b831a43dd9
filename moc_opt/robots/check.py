"""The check of an arm: freedoms, home pose, reach, limits, gains and masses, each with a verdict and a cure."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Literal, NamedTuple

import numpy as np

from moc_opt.control import ControlSettings
from moc_opt.errors import RobotError
from moc_opt.planning.self_motion import best_freedoms, freedoms, self_motion
from moc_opt.robots import urdf
from moc_opt.robots.gains import largest_inverse_masses, largest_null_rate, largest_rate
from moc_opt.robots.home import task_fault
from moc_opt.robots.model import RobotModel
from moc_opt.robots.vendor import FASTEST
from moc_opt.scenario.config import Scenario
from moc_opt.scenario.derived import largest_mu
from moc_opt.sim.settings import PlantSettings

Verdict = Literal["ok", "care", "cannot"]
REGULAR, SINGULAR = (0.1, 0.05), 1e-4
"""Singular values over the largest, of the tip's Jacobian and of A, below which to take care, and to refuse."""
LITTLE_TO_GAIN = 0.05
RADII_MM = (30, 20, 15, 10, 5)
MARGIN_DEG, MARGIN_MM = 15.0, 80.0
CARE = 0.8  #: Share of the stability limit from which on to take care.
GYRATION_M = 0.6
"""A link whose inertia says that its mass lies further from its middle than this is no link of an arm."""


class Finding(NamedTuple):
    """One row of the table."""

    what: str
    found: str
    verdict: Verdict
    cure: str = ""


def check_robot(robot: RobotModel, scenario: Scenario | None = None) -> list[Finding]:
    """Check an arm for a scenario's task, period and control (None: the default scenario).

    Returns:
        One finding a row, in the order of the table; the arm's own verdict is the worst of them.
    """
    asked = scenario or Scenario(robot={"name": robot.data.name})
    sliding = int(robot.chain.prismatic.sum())
    kinds = f"{robot.n} joints" + (f", {sliding} of them sliding" if sliding else "")
    found = [Finding("arm", f"{kinds}, tool {1e3 * robot.data.tool_length:.0f} mm", "ok"), *_freedom(robot)]
    if all(row.verdict != "cannot" for row in found):
        found += [*_climb(robot), _task(robot, asked)]
    return [*found, _limits(robot), _speeds(robot), _weight(robot), _bodies(robot), *_gains(robot, asked)]


def verdict(findings: list[Finding]) -> Verdict:
    """Return the worst of the rows."""
    order: tuple[Verdict, ...] = ("ok", "care", "cannot")
    return max((row.verdict for row in findings), key=order.index)


def _freedom(robot: RobotModel) -> Iterator[Finding]:
    built, here = best_freedoms(robot), freedoms(robot, robot.data.q_home)
    cure = ""
    if built.real < 1:
        cure = built.refusal(robot)
    elif here.rank < built.rank:
        cure = f"tip and shaft have rank {here.rank} at home, {built.rank} elsewhere: choose another home.q_rad"
    elif built.rank < 5:
        cure = f"tip and shaft have rank {built.rank}, and 5 is needed to place and turn a shaft: the arm lacks a joint"
    idle = ", ".join(robot.data.joint_names[j] for j in built.idle) or "none"
    text = f"{built.real} real, {len(built.idle)} idle ({idle})"
    yield Finding("freedoms left", text, "cannot" if cure else "ok", cure)
    text = f"tip {here.tip:.2f}, tip and shaft {here.both:.2f}"
    cure = "bend the arm at home (home.q_rad), or let `robot new` search a pose"
    if here.tip < SINGULAR or here.both < SINGULAR:
        yield Finding("singular values", text, "cannot", f"the home pose is singular: {cure}")
    elif here.tip < REGULAR[0] or here.both < REGULAR[1]:
        yield Finding("singular values", text, "care", f"the home pose is nearly singular: {cure}")
    else:
        yield Finding("singular values", text, "ok")


def _climb(robot: RobotModel) -> Iterator[Finding]:
    mu = robot.state(robot.data.q_home).mu
    (largest,), how = largest_mu(robot.data.q_home[None], robot, 1)
    try:
        curve = self_motion(robot, robot.data.q_home)
    except RobotError as error:
        yield Finding("mu at home", f"{mu:.3g} m^3", "care", f"its self-motion cannot be scanned: {error}")
    else:
        several = freedoms(robot, robot.data.q_home).real > 1
        text = f"{mu:.3g} m^3, {curve.mu.min():.3g} to {curve.mu_best:.3g} on {'one' if several else 'its'} self-motion"
        little = max(curve.mu_best, largest if several else 0.0) < (1.0 + LITTLE_TO_GAIN) * mu
        cure = "little to gain from there: choose another home.q_rad" if little else ""
        yield Finding("mu at home", text, "care" if little else "ok", cure)
    # With one freedom a local law stays on its curve, and may not get there.
    yield Finding("largest mu there", f"{largest:.3g} m^3, {how['mu_bound_method']}", "ok")


def _task(robot: RobotModel, asked: Scenario) -> Finding:
    fault = task_fault(robot, robot.data.q_home, asked)
    if not fault:
        return Finding("task from home", f"{asked.task.path} can be done", "ok")
    for radius in RADII_MM:
        smaller = asked.change(task={"path": "circle", "sizes": {"radius": 1e-3 * radius}})
        if not task_fault(robot, robot.data.q_home, smaller):
            cure = f"take [task] sizes = {{ radius = {1e-3 * radius:g} }}, or another home.q_rad: {fault}"
            return Finding("task from home", f"a circle of {radius} mm radius, not the {asked.task.path}", "care", cure)
    return Finding("task from home", f"not even a circle of {RADII_MM[-1]} mm", "cannot", fault)


def _limits(robot: RobotModel) -> Finding:
    q, moving, slides = robot.data.q_home, robot.moves.any(axis=0), robot.chain.prismatic
    room = np.minimum(q - robot.q_min, robot.q_max - q)
    texts, cures = [], []
    for kind, unit, scale, margin, kept in (
        (moving & ~slides, "deg", np.degrees(1.0), MARGIN_DEG, "9 deg"),
        (moving & slides, "mm", 1e3, MARGIN_MM, "50 mm"),
    ):  # fmt: skip
        if kind.any():
            j = int(np.argmin(np.where(kind, room, np.inf)))
            texts.append(f"{robot.data.joint_names[j]} is {scale * room[j]:.0f} {unit} away")
            if scale * room[j] < margin:
                cures.append(f"the third level keeps {kept} free: move home.q_rad {margin:.0f} {unit} or more inside")
    return Finding("nearest limit", ", ".join(texts), "care" if cures else "ok", "; ".join(cures))


def _speeds(robot: RobotModel) -> Finding:
    most = np.where(robot.chain.prismatic, FASTEST["sliding"], FASTEST["turning"])
    wrong = np.flatnonzero(robot.v_max > most + 1e-9)
    units = ["m/s" if slides else "rad/s" for slides in robot.chain.prismatic]
    text = f"{robot.v_max.min():.2g} to {robot.v_max.max():.2g} {' or '.join(sorted(set(units), reverse=True))}"
    if not wrong.size:
        return Finding("joint speeds", text, "ok")
    told = ", ".join(f"{robot.data.joint_names[j]} {robot.v_max[j]:.3g} {units[j]}" for j in wrong)
    cure = f"no arm is that fast ({told}), and the speed limit is none: see the data sheet, limits.v_max_deg_per_s"
    return Finding("joint speeds", text, "care", cure)


def _weight(robot: RobotModel) -> Finding:
    share = np.abs(robot.gravity(robot.data.q_home)) / robot.tau_max
    j = int(np.argmax(share))
    text = f"{robot.data.joint_names[j]} holds {100 * share[j]:.0f} % of its limit"
    if share[j] >= 1.0:
        return Finding("gravity at home", text, "cannot", "the arm cannot hold itself: check masses and torque limits")
    if share[j] > 0.7:
        return Finding("gravity at home", text, "care", "little torque is left to move")
    return Finding("gravity at home", text, "ok")


def _bodies(robot: RobotModel) -> Finding:
    # The loader refuses inertias that no body has; here are those that no arm has.
    wrong, total = [], 0.0
    for link in urdf.read(urdf.parse(robot.data.urdf)).links:
        if link.mass and link.moments:
            total += link.mass
            gyration = math.sqrt(max(link.moments[:3]) / link.mass)
            if gyration > GYRATION_M:
                wrong.append(f"{link.name} ({gyration:.2g} m from its middle)")
    text = f"{total:.3g} kg, base and tool included"
    if not 0.5 < total < 2000.0:
        return Finding("masses", text, "care", "an arm weighs more, or less: are the masses in kg?")
    cure = f"mass far out: {', '.join(wrong)}; is the inertia about the centre of mass, in kg m^2?"
    return Finding("masses", text, "care" if wrong else "ok", cure if wrong else "")


def _gains(robot: RobotModel, asked: Scenario) -> Iterator[Finding]:
    limit, period = allowed_rate(asked.plant), asked.plant.period_s
    swings = f"beyond {limit:.0f}/s a loop of {1e3 * period:g} ms with its delay swings"
    cases: tuple[tuple[str, ControlSettings, Verdict, str], ...] = (
        ("gains", asked.control, "cannot", f"{swings}: multiply {{}} by {{:.2g}} in the robot file's [gains]"),
        ("preset tuned", type(asked.control).preset("tuned"), "care",
         "leave the preset out, or multiply {} in the robot file's [gains.tuned] by {:.2g}"),
    )  # fmt: skip
    for what, control, worst, cure in cases:
        gains = control.resolve_gains(robot.data.gains, robot.n)
        tip, wrist = largest_inverse_masses(robot)
        # Each gain on a velocity over the lightest inertia behind it, over home and seeded poses [1/s].
        null_space = largest_null_rate(robot, gains.K_N2 + gains.D_N2)
        rates = {"D_X": gains.D_X * tip, "D_N": gains.D_N * wrist, "K_N2": null_space}
        name, rate = max(rates.items(), key=lambda item: item[1])
        text = f"{name} at {100 * rate / limit:.0f} % of the stability limit"
        near = rate >= CARE * limit
        judged = worst if rate >= limit else "care" if near else "ok"
        yield Finding(what, text, judged, cure.format(name, 0.5 * limit / rate) if near else "")


def allowed_rate(plant: PlantSettings) -> float:
    """Return the largest stable rate [1/s] with the plant's period and delay; its velocity filter counts as delay."""
    lag = 0.0
    if plant.velocity_cutoff_Hz > 0.0:
        lag = 1.0 / (2.0 * math.pi * plant.velocity_cutoff_Hz * plant.period_s)
    return largest_rate(plant.period_s, plant.delay_ticks + math.ceil(lag))

"""The check of an arm, with verdicts and cures."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Literal, NamedTuple

import numpy as np

from moc_opt.errors import RobotError
from moc_opt.planning.self_motion import best_freedoms, freedoms, self_motion
from moc_opt.robots import urdf
from moc_opt.robots.gains import largest_inverse_masses, largest_null_rate
from moc_opt.robots.model import RobotModel
from moc_opt.robots.new import task_fault
from moc_opt.robots.vendor import FASTEST
from moc_opt.scenario.config import Scenario
from moc_opt.scenario.derived import largest_mu
from moc_opt.sim.settings import PlantSettings

Verdict = Literal["ok", "care", "cannot"]
REGULAR, SINGULAR = (0.1, 0.05), 1e-4
"""`Freedoms.tip` and `Freedoms.both` are ratios of singular values, here at home. If one is below its value in
`REGULAR`, the verdict is "care". If one is below `SINGULAR`, the verdict is "cannot"."""
LITTLE_TO_GAIN = 0.05  #: If mu at home can rise by less than this share, the verdict is "care".
LEAST_M = 0.005  #: If the arm cannot even follow a circle of this radius, the verdict is "cannot".
MARGIN_DEG, MARGIN_MM = 15.0, 80.0  #: If home is nearer than this to a limit, the verdict is "care".
CARE = 0.8  #: If gains reach this share of the stability limit, the verdict is "care".
GYRATION_M = 0.6  #: Largest plausible radius of gyration of a link [m].


class Finding(NamedTuple):
    """One row of the table of a check."""

    what: str
    found: str
    verdict: Verdict
    cure: str = ""  #: What to change; empty if the verdict is "ok".


def check_robot(robot: RobotModel, scenario: Scenario | None = None) -> list[Finding]:
    """Check an arm for a scenario, and return one row per check."""
    asked, sliding = scenario or Scenario(robot={"name": robot.data.name}), int(robot.chain.prismatic.sum())
    kinds = f"{robot.n} joints" + (f", {sliding} of them prismatic" if sliding else "")
    found = [Finding("arm", f"{kinds}, tool {1e3 * robot.data.tool_length:.0f} mm", "ok"), *_freedom(robot)]
    if verdict(found) != "cannot":
        found += [*_climb(robot), _task(robot, asked)]
    return [*found, _limits(robot), _speeds(robot), _weight(robot), _bodies(robot), _gains(robot, asked)]


def verdict(findings: list[Finding]) -> Verdict:
    """Return the worst verdict of the rows."""
    order: tuple[Verdict, ...] = ("ok", "care", "cannot")
    return max((row.verdict for row in findings), key=order.index)


def _judge(what: str, found: str, *faults: tuple[object, Verdict, str]) -> Finding:
    """Make a row from the first of the ``faults`` (condition, verdict, cure) whose condition is true; if none, "ok"."""
    rows = (Finding(what, found, judged, cure) for fault, judged, cure in faults if fault)
    return next(rows, Finding(what, found, "ok"))


def _freedom(robot: RobotModel) -> Iterator[Finding]:
    built, here = best_freedoms(robot), freedoms(robot, robot.data.q_home)
    idle = ", ".join(robot.data.joint_names[j] for j in built.idle) or "none"
    rank = f"the Jacobian of tip and shaft has rank {here.rank} at home, {built.rank} elsewhere: change home.q_rad"
    lacking = f"the Jacobian of tip and shaft has rank {built.rank}, but a shaft needs rank 5: the arm lacks a joint"
    yield _judge(
        "freedoms left", f"{built.real} real, {len(built.idle)} idle ({idle})",
        (built.real < 1, "cannot", built.refusal(robot)),
        (here.rank < built.rank, "cannot", rank), (built.rank < 5, "cannot", lacking),
    )  # fmt: skip
    cure = "singular: bend the arm at home (home.q_rad), or let `robot new` search for a pose"
    yield _judge(
        "singular values", f"tip {here.tip:.2f}, tip and shaft {here.both:.2f}",
        (here.tip < SINGULAR or here.both < SINGULAR, "cannot", f"the home pose is {cure}"),
        (here.tip < REGULAR[0] or here.both < REGULAR[1], "care", f"nearly {cure}"),
    )  # fmt: skip


def _climb(robot: RobotModel) -> Iterator[Finding]:
    mu, what = robot.state(robot.data.q_home).mu, "mu at home"
    (largest,), how = largest_mu(robot.data.q_home[None], robot, 1)
    try:
        curve = self_motion(robot, robot.data.q_home)
    except RobotError as error:
        yield Finding(what, f"{mu:.3g} m³", "care", f"the self-motion at home cannot be scanned: {error}")
    else:
        several = freedoms(robot, robot.data.q_home).real > 1
        text = f"{mu:.3g} m³, {curve.mu.min():.3g} to {curve.mu_best:.3g} on {'one' if several else 'its'} self-motion"
        little = max(curve.mu_best, largest if several else 0.0) < (1.0 + LITTLE_TO_GAIN) * mu
        yield _judge(what, text, (little, "care", "mu can hardly rise from home: choose another home.q_rad"))
    # The best pose with home's tip and shaft may lie on another self-motion curve.
    yield Finding("largest mu there", f"{largest:.3g} m³, {how['mu_bound_method']}", "ok")


def _task(robot: RobotModel, asked: Scenario) -> Finding:
    fault, what = task_fault(robot, robot.data.q_home, asked), "task from home"
    if not fault:
        return Finding(what, f"{asked.task.path} can be done", "ok")
    if task_fault(robot, robot.data.q_home, asked.change(task={"path": "circle", "sizes": {"radius": LEAST_M}})):
        return Finding(what, f"a circle of radius {1e3 * LEAST_M:g} mm cannot be done", "cannot", fault)
    return Finding(what, f"{asked.task.path} cannot be done", "care", f"shrink the path, or move home.q_rad: {fault}")


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
                cures.append(f"level 3 (elbow) stops {kept} before a limit: keep home.q_rad {margin:.0f} {unit} away")
    return _judge("nearest limit", ", ".join(texts), (cures, "care", "; ".join(cures)))


def _speeds(robot: RobotModel) -> Finding:
    most = np.where(robot.chain.prismatic, FASTEST["sliding"], FASTEST["turning"])
    units = ["m/s" if slides else "rad/s" for slides in robot.chain.prismatic]
    text = f"{robot.v_max.min():.2g} to {robot.v_max.max():.2g} {' or '.join(sorted(set(units), reverse=True))}"
    wrong = np.flatnonzero(robot.v_max > most + 1e-9)
    told = ", ".join(f"{robot.data.joint_names[j]} {robot.v_max[j]:.3g} {units[j]}" for j in wrong)
    cure = f"no arm is that fast ({told}): set the limits of the data sheet, in limits.v_max_deg_per_s"
    return _judge("joint speeds", text, (told, "care", cure))


def _weight(robot: RobotModel) -> Finding:
    share = np.abs(robot.gravity(robot.data.q_home)) / robot.tau_max
    j = int(np.argmax(share))
    return _judge(
        "gravity at home", f"{robot.data.joint_names[j]} needs {100 * share[j]:.0f} % of its torque limit",
        (share[j] >= 1.0, "cannot", "the arm cannot carry its own weight: check masses and torque limits"),
        (share[j] > 0.7, "care", "little torque is left to move"),
    )  # fmt: skip


def _bodies(robot: RobotModel) -> Finding:
    # The loader has already refused impossible inertias.
    bodies = [link for link in urdf.read(robot.data.urdf).links if not link.is_frame]
    gyrations = {body.name: math.sqrt(max(body.moments[:3]) / body.mass) for body in bodies}
    total = sum(body.mass for body in bodies)
    far = [f"{name} (radius of gyration {size:.2g} m)" for name, size in gyrations.items() if size > GYRATION_M]
    return _judge(
        "masses", f"{total:.3g} kg, base and tool included",
        (not 0.5 < total < 2000.0, "care", "no arm has this mass: are the masses in kg?"),
        (far, "care", f"too much inertia: {', '.join(far)}; is it about the centre of mass, in kg m^2?"),
    )  # fmt: skip


def _gains(robot: RobotModel, asked: Scenario) -> Finding:
    limit, period = largest_rate(asked.plant), asked.plant.period_s
    gains = asked.control.resolve_gains(robot.data.gains, robot.n)
    tip, wrist = largest_inverse_masses(robot)
    null_space = largest_null_rate(robot, gains.K_N2 + gains.D_N2)
    rates = {"D_X": gains.D_X * tip, "D_N": gains.D_N * wrist, "K_N2": null_space}
    name, rate = max(rates.items(), key=lambda item: item[1])
    cure = (
        f"if gain / inertia exceeds {limit:.0f}/s, a loop of {1e3 * period:g} ms with its delay is unstable: multiply "
        f"{name} by {0.5 * limit / rate:.2g} in the robot file's [gains]"
    )
    text = f"{name} at {100 * rate / limit:.0f} % of the stability limit"
    return _judge("gains", text, (rate >= limit, "cannot", cure), (rate >= CARE * limit, "care", cure))


def largest_rate(plant: PlantSettings) -> float:
    """Return the largest stable ratio r of a velocity gain to an inertia [1/s].

    With a period T and d ticks of delay, v[k+1] = v[k] - T r v[k-d] decays if T r < 2 sin(pi / (2 (2 d + 1)))
    (Levin and May, 1976). d includes the delay of the velocity filter.
    """
    cutoff, period = plant.velocity_cutoff_Hz, plant.period_s
    filter_ticks = math.ceil(1.0 / (2.0 * math.pi * cutoff * period)) if cutoff > 0.0 else 0
    return 2.0 * math.sin(math.pi / (2.0 * (2.0 * (plant.delay_ticks + filter_ticks) + 1.0))) / period

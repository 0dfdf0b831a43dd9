"""What the paper prints and what is computed here: every row of the table with the number that shows it.

    python -m benchmarks.errata [--out docs/errata.md] [--check]

writes docs/errata.md; ``--check`` only says whether the page agrees with the numbers (exit status 1 if not). The
numbers come from 50 seeded poses of the LWR4+ and from two short runs; they carry two significant digits (those of the
runs one), and what is zero but for rounding is written as "below 1e-12", so that any machine computes the same page.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.output import write_atomically
from moc_opt import solvers
from moc_opt.control import rcm, tick
from moc_opt.control.compliance import task_inertia
from moc_opt.control.dense import cholesky
from moc_opt.control.manipulability import (
    consistent_wrist_velocity,
    null_space,
    self_motion_torque,
    velocity_damper,
)
from moc_opt.control.settings import ControlSettings
from moc_opt.model import RobotModel, RobotState, load_robot
from moc_opt.scenario import Scenario, run
from moc_opt.subproblem import NullSpaceQP

Array = NDArray[np.float64]

PAGE = Path(__file__).resolve().parent.parent / "docs" / "errata.md"
POSES = 50
PAPER = ControlSettings.paper()
K = 0.1  # gain of the network, as printed
K_N2 = 80.0


@dataclass(frozen=True)
class Erratum:
    """One row: what is printed, what is computed here, why, and the numbers that show it."""

    name: str
    printed: str
    consistent: str
    why: str
    shown: Callable[[Arm], str]


@dataclass(frozen=True)
class Arm:
    """The arm at rest in the poses that the numbers are taken over."""

    robot: RobotModel
    states: tuple[RobotState, ...]

    @classmethod
    def load(cls, poses: int = POSES, seed: int = 0) -> Arm:
        """The LWR4+ in seeded regular poses."""
        robot, rng = load_robot(), np.random.default_rng(seed)
        return cls(robot, tuple(robot.state(robot.random_regular_pose(rng)) for _ in range(poses)))

    def subproblem(
        self, state: RobotState, c2: float = PAPER.c2, rho: float = PAPER.damping, weight: float = 1.0,
        speed: float = 0.0,
    ) -> NullSpaceQP:  # fmt: skip
        """The paper's subproblem at a state; ``weight`` scales c0, c1, c2 and rho together; tip speed [m/s] along x."""
        robot, lower, upper = self.robot, np.empty(self.robot.n), np.empty(self.robot.n)
        velocity_damper(state.q, robot.q_min, robot.q_max, robot.v_max, PAPER.k0_per_s, lower, upper)
        v_tip = np.array([speed, 0.0, 0.0])
        v_wrist = consistent_wrist_velocity(v_tip, v_tip, state.tool_direction)
        weights = (PAPER.c0 * weight, PAPER.c1 * weight, c2 * weight, rho * weight)
        return NullSpaceQP(state.J_tip, state.J_wrist, v_tip, v_wrist, state.grad_mu, lower, upper, *weights)


def number(value: float) -> str:
    """Two significant digits; rounding errors all alike."""
    if abs(value) < 1e-12:
        return "below 1e-12"
    text = f"{float(f'{value:.2g}'):g}"
    mantissa, _, power = text.partition("e")
    return f"{mantissa}e{int(power)}" if power else text


def span(values: Sequence[float]) -> str:
    """Smallest to largest."""
    low, high = number(min(values)), number(max(values))
    return low if low == high else f"{low} to {high}"


def projectors(state: RobotState) -> tuple[Array, Array, Array]:
    """The printed, the dynamic and the static projector (n, n) of level 2."""
    J, eye = np.array(state.J_tip), np.eye(len(state.q))
    W, factor = task_inertia(J, cholesky(np.array(state.M)))
    printed = np.array([rcm.project_printed(J, e) for e in eye]).T
    dynamic = np.array([rcm.project_dynamic(J, W, factor, e) for e in eye]).T
    static = np.array([rcm.project_static(J, e) for e in eye]).T
    return printed, dynamic, static


def saddle(qp: NullSpaceQP, sign: float = 1.0) -> Array:
    """Jacobian of F(Y) = [dL/dx, -dL/dlambda], (n + 6, n + 6); sign = -1 is F as printed."""
    return sign * np.block([[qp.P, qp.A.T], [-qp.A, np.zeros((6, 6))]])


def idempotence(N: Array) -> float:
    """|N N - N|/|N|."""
    return float(np.linalg.norm(N @ N - N, 2) / np.linalg.norm(N, 2))


def _projector(arm: Arm) -> str:
    found = [(projectors(s), s) for s in arm.states]
    printed, dynamic, static = ([idempotence(ps[i]) for ps, _ in found] for i in range(3))

    def leak(i: int) -> list[float]:
        """Tip acceleration left of that of an unprojected torque."""
        return [
            float(
                np.linalg.norm(s.J_tip @ np.linalg.solve(s.M, ps[i]), 2)
                / np.linalg.norm(s.J_tip @ np.linalg.inv(s.M), 2)
            )
            for ps, s in found
        ]

    return (
        f"&#124;N N - N&#124;/&#124;N&#124; is {span(printed)} as printed, {number(max(dynamic))} (dynamic) and "
        f"{number(max(static))} (static); of the tip acceleration of an unprojected torque the printed one lets "
        f"{span(leak(0))} through, the dynamic one {number(max(leak(1)))}"
    )


def _wrist(arm: Arm) -> str:
    fifth = max(float(np.abs(s.J_wrist[:, 4:]).max()) for s in arm.states)
    least = min(float(np.abs(s.J_wrist[:, :4]).max(axis=0).min()) for s in arm.states)
    return (
        f"shape {arm.states[0].J_wrist.shape}; columns 5, 6 and 7 are {number(fifth)} (their axes meet in the wrist "
        f"centre), each of the others reaches {number(least)} m/rad or more"
    )


def third_level(state: RobotState) -> tuple[Array, Array, Array]:
    """The consistent map (n, n), the printed one with the missing Z appended (n, n), and Z M Z^T (r, r)."""
    Z, M = null_space(state.A), np.array(state.M)
    consistent = np.array([self_motion_torque(M, Z, e) for e in np.eye(len(state.q))]).T
    inner = Z @ M @ Z.T
    return consistent, (inner @ Z @ M).T @ Z, inner


def _third(arm: Arm) -> str:
    found = [third_level(s) for s in arm.states]
    shape = tuple(reversed(null_space(arm.states[0].A).shape))
    factor = [float(value) for *_, inner in found for value in np.linalg.eigvalsh(inner) ** 2]
    still = [
        float(np.abs(s.A @ np.linalg.solve(s.M, N)).max())
        for (N, *_), s in zip(found, arm.states, strict=True)
    ]
    return (
        f"printed shape {shape}, which takes no joint vector; with the missing Z appended its "
        f"&#124;N N - N&#124;/&#124;N&#124; is {span([idempotence(P) for _, P, _ in found])} (with the inverse "
        f"{number(max(idempotence(N) for N, *_ in found))}) and its torque is {span(factor)} times the consistent "
        f"one, which accelerates tip and wrist by {number(max(still))} m/s^2 per unit"
    )


def network(qp: NullSpaceQP, steps: int, sign: float, k: float = 0.5) -> Array:
    """Y <- Y - k F(Y), x clipped to the box (h = 1); |A x - b|_inf over the last tenth of the steps."""
    x, y, slack = np.zeros(qp.n), np.zeros(6), []
    for _ in range(steps):
        F_x, F_y = qp.P @ x + qp.p + qp.A.T @ y, -(qp.A @ x - qp.b)
        x, y = np.clip(x - sign * k * F_x, qp.lower, qp.upper), y - sign * k * F_y
        slack.append(float(np.abs(F_y).max()))
    return np.array(slack[-steps // 10 :])


def _sign(arm: Arm) -> str:
    problems = [arm.subproblem(s, rho=1e-4, weight=100.0, speed=0.005) for s in arm.states[:8]]
    kept = max(float(network(qp, 10_000, 1.0).max()) for qp in problems)
    lost = min(float(network(qp, 1000, -1.0).min()) for qp in problems)
    return (
        f"after 10000 steps (c0 = c1 = 1, k = 0.5) the consistent sign meets the references to "
        f"{'better than 1e-5' if kept < 1e-5 else number(kept)} m/s; the printed one never comes nearer than "
        f"{number(lost)} m/s"
    )


def _gradient(arm: Arm) -> str:
    values = [np.linalg.eigvalsh(G + G.T) for G in (saddle(arm.subproblem(s)) for s in arm.states)]
    return (
        f"eigenvalues of grad F + grad F^T: the smallest {number(min(float(v[0]) for v in values))} in size, "
        f"the largest {span([float(v[-1]) for v in values])}"
    )


def time_constants(arm: Arm) -> tuple[float, float]:
    """(fastest, slowest) mode of dY/dt = -k F(Y) at the printed weights [s]; free directions have none."""
    fastest, slowest = np.inf, 0.0
    for s in arm.states:
        rates = -np.linalg.eigvals(-K * saddle(arm.subproblem(s))).real
        moving = rates[rates > 1e-12]
        fastest, slowest = min(fastest, 1.0 / moving.max()), max(slowest, 1.0 / moving.min())
    return float(fastest), float(slowest)


def _clock(arm: Arm) -> str:
    fastest, slowest = time_constants(arm)
    return f"time constants with eps = 1 s: {number(fastest)} s to {number(slowest)} s, against a tick of 0.002 s"


def torque_of_mu(arm: Arm) -> float:
    """Largest share of mu in the torque of ``rnn-printed`` from rest and in slow motion [Nm]: with c2 less without."""
    rng, printed, share = np.random.default_rng(0), solvers.create("rnn-printed"), 0.0
    for rest in arm.states:
        for v in (np.zeros(arm.robot.n), rng.uniform(-0.01, 0.01, arm.robot.n)):
            s = arm.robot.state(rest.q, v)
            torques = []
            for c2 in (PAPER.c2, 0.0):
                qp = arm.subproblem(s, c2=c2)
                session = printed.start(qp)
                session.observe(v)  # type: ignore[attr-defined]
                x = session.solve(qp).x
                torques.append(tick.third_level(s.record, arm.robot.n, null_space(s.A), x, K_N2, 0.0))
            share = max(share, float(np.abs(torques[0] - torques[1]).max()))
    return share


def gains_in_mu() -> dict[str, float]:
    """Change of mu in one second at rest in a plant that equals the model, from a poor swivel [percent]."""
    base = Scenario(
        duration_s=1.0, start={"swivel": 0.15}, plant={"preset": "nominal"}, judge=False, bound_samples=0,
        task={"wait_s": 2.0}, control={"damping": 0.0, "observer_gain_per_s": 0.0},
    )  # fmt: skip
    found = {}
    for name in ("exact", "rnn-printed"):
        trace = run(base.change(solver={"name": name}))
        found[name] = 100.0 * float(trace.mu[-1] / trace.mu[0] - 1.0)
    return found


def _act(arm: Arm) -> str:
    gain = gains_in_mu()
    idle = "below 0.1" if abs(gain["rnn-printed"]) < 0.1 else number(gain["rnn-printed"])
    return (
        f"mu's share of the torque is at most {number(torque_of_mu(arm))} Nm; in one second at rest mu changes by "
        f"{idle} % with `rnn-printed`, by about {round(gain['exact'], -1):.0f} % with `exact`"
    )


def _gains(arm: Arm) -> str:
    tables = arm.robot.data.gains
    parts = [
        f"{name.upper()}: K_X {tables[name]['K_X']:.0f}, K_N {tables[name]['K_N']:.0f}"
        for name in ("dcac", "moc")
    ]
    return f"{'; '.join(parts)} N/m. `python -m benchmarks.paper` shows every claim with both"


ERRATA = (
    Erratum(
        "projector", "(I - J_T^T J_T) J_W^T F",
        "I - J_T^T Jbar_T^T with Jbar_T = M^-1 J_T^T Lambda_T (dynamic); I - J_T^T pinv(J_T)^T (static) is a setting",
        "not idempotent, and its units do not fit (m^2)", _projector,
    ),
    Erratum(
        "wrist", "J_W is 3x5", "3x7, zero where a joint does not move the wrist",
        "three rows and five columns cannot multiply seven velocities", _wrist,
    ),
    Erratum(
        "third level", "[(Z M Z^T) Z M]^T", "M Z^T (Z M Z^T)^-1 Z", "the inverse is missing, and the shapes", _third,
    ),
    Erratum(
        "sign", "F(Y) = [-dL/dqd, dL/dlambda]", "[dL/dqd, -dL/dlambda]",
        "the paper's own optimality conditions and its equation (2)", _sign,
    ),
    Erratum(
        "gradient", "grad F + grad F^T <= 0, with blocks J J^T (3x3)",
        "2 diag(c0 J_T^T J_T + c1 J_W^T J_W, 0, 0) >= 0, 7x7", "sign and shape; convergence rests on it", _gradient,
    ),
    Erratum(
        "clock", "no time constant", "eps, or m steps per tick",
        "with the printed weights the network's modes are far slower than the task", _clock,
    ),
    Erratum(
        "torque", "K_N2 of 80 on qdd_d at c2 = 0.001, k = 0.1", "kept as the solver `rnn-printed`",
        "the torque that mu causes is too small to act", _act,
    ),
    Erratum(
        "gains", "DCAC compared with MOC at other gains", "every comparison also with matched gains",
        "stiffer springs track better without any third level", _gains,
    ),
)  # fmt: skip


def page(arm: Arm | None = None) -> str:
    """docs/errata.md, computed."""
    arm = Arm.load() if arm is None else arm
    lines = [
        "# What the paper prints and what is computed here",
        "",
        "Su et al., *Manipulability Optimization Control of a Serial Redundant Robot for Robot-assisted Minimally",
        "Invasive Surgery* (2019). Written by `python -m benchmarks.errata`; do not edit by hand. The numbers are",
        f"taken over {len(arm.states)} seeded regular poses of the LWR4+ with its default tool. The same rows are",
        "tests, in `tests/test_errata.py`.",
        "",
        "| printed | computed here | why | the number that shows it |",
        "|---|---|---|---|",
    ]
    for row in ERRATA:
        lines.append(f"| {row.printed} | {row.consistent} | {row.why} | {row.shown(arm)} |")
    return "\n".join(lines) + "\n"


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the page, or check it; 0, or 1 where it does not agree."""
    options = argparse.ArgumentParser(prog="python -m benchmarks.errata", description="Write docs/errata.md.")
    options.add_argument("--out", type=Path, default=PAGE, help="where the page is")
    options.add_argument("--check", action="store_true", help="compare only")
    given = options.parse_args(arguments)
    text = page()
    if not given.check:
        write_atomically(given.out, text.encode())
        return 0
    if given.out.exists() and given.out.read_text(encoding="utf-8") == text:
        return 0
    print(
        f"{given.out} does not agree with the numbers: python -m benchmarks.errata writes it anew",
        file=sys.stderr,
    )
    return 1


if __name__ == "__main__":
    sys.exit(main())

"""The paper's equations as printed and as computed here: every row of the table with the number that shows it.

    python -m benchmarks.errata [--out docs/errata.md] [--check]

writes docs/errata.md; ``--check`` only says whether the page agrees with the numbers (exit status 1 if not). The
numbers come from 50 seeded poses of the LWR4+ and from two short runs; they carry two significant digits (those of the
runs one), and what is zero but for rounding is written as "below 1e-12", so that any machine computes the same page.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.linalg import null_space

from benchmarks.common import cli
from benchmarks.common.markdown import render
from benchmarks.common.output import write_atomically
from benchmarks.subproblems.recipes import along_the_shaft
from moc_opt import solvers
from moc_opt.arrays import Array
from moc_opt.control.settings import ControlSettings
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.robots.chain import desired_wrist
from moc_opt.robots.model import RobotModel, RobotState, load_robot
from moc_opt.scenario import Scenario, run
from moc_opt.solvers.base import ObservingSession
from moc_opt.tasks.trocar import shaft_distance
from moc_opt.vision.board import BOARD_TASKS

PAGE = Path(__file__).resolve().parents[2] / "docs" / "errata.md"
POSES = 50
PAPER = ControlSettings.paper()
K = 0.1  # gain of the network, as printed
K_N2 = np.array([80.0, 120.0, 60.0, 30.0, 20.0, 10.0, 10.0])
"""(7,) Table I [N m s/rad]"""


@dataclass(frozen=True)
class Arm:
    """The arm at rest in the poses that the numbers are taken over."""

    robot: RobotModel
    states: tuple[RobotState, ...]

    @classmethod
    def load(cls, poses: int = POSES, seed: int = 0) -> Arm:
        """Return the LWR4+ in seeded regular poses."""
        robot, rng = load_robot(), np.random.default_rng(seed)
        return cls(robot, tuple(robot.state(robot.random_regular_pose(rng)) for _ in range(poses)))

    def subproblem(
        self, state: RobotState, c2: float = PAPER.c2, rho: float = PAPER.regularization, weight: float = 1.0,
        speed: float = 0.0,
    ) -> NullSpaceQP:  # fmt: skip
        """Make the paper's subproblem at a state; ``weight`` scales c0, c1, c2 and rho; tip speed [m/s] along x."""
        robot, k0, v_tip = self.robot, PAPER.k0_per_s, np.array([speed, 0.0, 0.0])
        lower, upper = (
            np.clip(-k0 * (state.q - limit), -robot.v_max, robot.v_max) for limit in (robot.q_min, robot.q_max)
        )
        v_wrist = along_the_shaft(v_tip, v_tip, state.tool_direction)
        return NullSpaceQP(
            state.J_tip, state.J_wrist, v_tip, v_wrist, state.grad_mu, lower=lower, upper=upper,
            c0=PAPER.c0 * weight, c1=PAPER.c1 * weight, c2=c2 * weight, regularization=rho * weight,
        )  # fmt: skip


# --- both forms, computed ---


def projectors(state: RobotState) -> tuple[Array, Array, Array]:
    """Return the printed, the dynamic and the static projector (n, n) of level 2."""
    J, eye, yields = np.array(state.J_tip), np.eye(len(state.q)), np.linalg.inv(state.M)
    dynamic = eye - J.T @ np.linalg.inv(J @ yields @ J.T) @ J @ yields
    return eye - J.T @ J, dynamic, eye - J.T @ np.linalg.pinv(J).T


def idempotence(N: Array) -> float:
    """Return |N N - N|/|N|."""
    return float(np.linalg.norm(N @ N - N, 2) / np.linalg.norm(N, 2))


def leak(state: RobotState, N: Array) -> float:
    """Return the tip acceleration left of that of an unprojected torque."""
    J, M = state.J_tip, state.M
    return float(np.linalg.norm(J @ np.linalg.solve(M, N), 2) / np.linalg.norm(J @ np.linalg.inv(M), 2))


def third_level(state: RobotState) -> tuple[Array, Array, Array]:
    """Return the consistent map (n, n), the printed one, which lacks a Z, (n, r), and Z (r, n)."""
    Z, M = np.asarray(null_space(state.A, rcond=1e-7).T), np.array(state.M)
    inner = Z @ M @ Z.T
    return M @ Z.T @ np.linalg.inv(inner) @ Z, (inner @ Z @ M).T, Z


def saddle(qp: NullSpaceQP, sign: float = 1.0) -> Array:
    """Return the Jacobian of F(Y) = [dL/dx, -dL/dlambda], (n + 6, n + 6); sign = -1 is F as printed."""
    return sign * np.block([[qp.P, qp.A.T], [-qp.A, np.zeros((6, 6))]])


def network(qp: NullSpaceQP, steps: int, sign: float, k: float = 0.5) -> tuple[Array, Array]:
    """Iterate Y <- Y - k F(Y), x clipped to the box (h = 1); x, and |A x - b|_inf over the last tenth of the steps."""
    x, y, slack = np.zeros(qp.n), np.zeros(6), []
    for _ in range(steps):
        F_x, F_y = qp.P @ x + qp.p + qp.A.T @ y, -(qp.A @ x - qp.b)
        x, y = np.clip(x - sign * k * F_x, qp.lower, qp.upper), y - sign * k * F_y
        slack.append(float(np.abs(F_y).max()))
    return x, np.array(slack[-steps // 10 :])


def rates(qp: NullSpaceQP) -> Array:
    """Return the decay rates [1/s] of dY/dt = -k F(Y) at the printed weights; free directions have none."""
    found = -np.linalg.eigvals(-K * saddle(qp)).real
    return np.sort(found[found > 1e-12])


def torque_of_mu(arm: Arm) -> float:
    """Return the largest share of mu in the torque of ``rnn-printed`` [Nm], at rest and slow: with c2 less without."""
    rng, printed, share = np.random.default_rng(0), solvers.create("rnn-printed"), 0.0
    for rest in arm.states:
        for v in (np.zeros(arm.robot.n), rng.uniform(-0.01, 0.01, arm.robot.n)):
            s = arm.robot.state(rest.q, v)
            torques = []
            for c2 in (PAPER.c2, 0.0):
                qp = arm.subproblem(s, c2=c2)
                session = printed.start(qp)
                assert isinstance(session, ObservingSession)
                session.observe(v)
                torques.append(third_level(s)[0] @ (K_N2 * (session.solve(qp).x - s.v)))
            share = max(share, float(np.abs(torques[0] - torques[1]).max()))
    return share


def true_lambdas(arm: Arm, off_m: float = 0.002) -> list[float]:
    """Return d / |N - N_d| at the depths of the virtual tasks, the trocar a little beside the shaft."""
    found = []
    for s in arm.states:
        across = np.cross(s.tool_direction, np.eye(3)[int(np.argmin(np.abs(s.tool_direction)))])
        across /= np.linalg.norm(across)
        for task in BOARD_TASKS.values():
            trocar = s.tip - task.depth_m * s.tool_direction + off_m * across
            desired, _ = desired_wrist(s.tip, np.zeros(3), trocar, np.zeros(3), s.tool_span)
            distance = float(shaft_distance(s.tip, s.wrist, trocar))
            found.append(distance / float(np.linalg.norm(s.wrist - desired)))
    return found


def gains_in_mu() -> dict[str, float]:
    """Return the change of mu in one second at rest in a plant that equals the model, from a poor swivel [percent]."""
    base = Scenario(
        duration_s=1.0, start={"swivel": 0.15}, plant={"preset": "nominal"}, judge=False, bound_samples=0,
        task={"wait_s": 2.0}, control={"preset": "paper"},
    )  # fmt: skip
    found = {}
    for name in ("exact", "rnn-printed"):
        trace = run(base.change(solver={"name": name}))
        found[name] = 100.0 * float(trace.mu[-1] / trace.mu[0] - 1.0)
    return found


# --- the page ---


def number(value: float) -> str:
    """Write two significant digits; rounding errors all alike."""
    if abs(value) < 1e-12:
        return "below 1e-12"
    text = f"{float(f'{value:.2g}'):g}"
    mantissa, _, power = text.partition("e")
    return f"{mantissa}e{int(power)}" if power else text


def span(values: Sequence[float]) -> str:
    """Write the smallest and the largest."""
    low, high = number(min(values)), number(max(values))
    return low if low == high else f"{low} to {high}"


def numbers(arm: Arm) -> dict[str, str]:
    """Return row of benchmarks/templates/errata.md -> the numbers that show it."""
    states, qps = arm.states, [arm.subproblem(s) for s in arm.states]
    printed, dynamic, static = zip(*map(projectors, states), strict=True)
    leaks = [[leak(s, N) for s, N in zip(states, which, strict=True)] for which in (printed, dynamic)]
    fifth = max(float(np.abs(s.J_wrist[:, 4:]).max()) for s in states)
    least = min(float(np.abs(s.J_wrist[:, :4]).max(axis=0).min()) for s in states)
    right, wrong, Z = zip(*map(third_level, states), strict=True)
    completed = [idempotence(P @ z) for P, z in zip(wrong, Z, strict=True)]
    factor = [float(w) for s, z in zip(states, Z, strict=True) for w in np.linalg.eigvalsh(z @ s.M @ z.T) ** 2]
    still = max(float(np.abs(s.A @ np.linalg.solve(s.M, N)).max()) for s, N in zip(states, right, strict=True))
    slow = [arm.subproblem(s, rho=1e-4, weight=100.0, speed=0.005) for s in states[:8]]
    kept = max(float(network(qp, 10_000, 1.0)[1].max()) for qp in slow)
    lost = min(float(network(qp, 1000, -1.0)[1].min()) for qp in slow)
    values = [np.linalg.eigvalsh(G + G.T) for G in map(saddle, qps)]
    decay = np.concatenate([rates(qp) for qp in qps])
    gain, lambdas = gains_in_mu(), true_lambdas(arm)
    idle = "below 0.1" if abs(gain["rnn-printed"]) < 0.1 else number(gain["rnn-printed"])
    constant = PAPER.rcm_lambda or np.nan
    tables = [
        f"{name.upper()}: K_X {table['K_X']:.0f}, K_N {table['K_N']:.0f} N/m, D_X {table['D_X']:.0f}, "
        f"D_N {table['D_N']:.0f} N s/m" for name in ("dcac", "moc") for table in [arm.robot.data.gains[name]]
    ]  # fmt: skip
    return {
        "projector":
            f"&#124;N N - N&#124;/&#124;N&#124; is {span([*map(idempotence, printed)])} as printed, "
            f"{number(max(map(idempotence, dynamic)))} (dynamic) and {number(max(map(idempotence, static)))} "
            f"(static); of the tip acceleration of an unprojected torque the printed one lets "
            f"{span(leaks[0])} through, the dynamic one {number(max(leaks[1]))}",
        "wrist":
            f"shape {states[0].J_wrist.shape}; columns 5, 6 and 7 are {number(fifth)} (their axes meet in the wrist "
            f"centre), each of the others reaches {number(least)} m/rad or more",
        "third":
            f"printed shape {wrong[0].shape}, which takes no joint vector; with the missing Z appended its "
            f"&#124;N N - N&#124;/&#124;N&#124; is {span(completed)} (with the inverse "
            f"{number(max(map(idempotence, right)))}) and its torque is {span(factor)} times the consistent "
            f"one, which accelerates tip and wrist by {number(still)} m/s^2 per unit",
        "sign":
            f"after 10000 steps (c0 = c1 = 1, k = 0.5) the consistent sign meets the references to "
            f"{'better than 1e-5' if kept < 1e-5 else number(kept)} m/s; the printed one never comes nearer than "
            f"{number(lost)} m/s",
        "gradient":
            f"eigenvalues of grad F + grad F^T: the smallest {number(min(float(v[0]) for v in values))} in size, "
            f"the largest {span([float(v[-1]) for v in values])}",
        "clock":
            f"time constants with eps = 1 s: {number(1.0 / decay.max())} s to {number(1.0 / decay.min())} s, against "
            f"a tick of 0.002 s",
        "act":
            f"mu's share of the torque is at most {number(torque_of_mu(arm))} Nm; in one second at rest mu changes by "
            f"{idle} % with `rnn-printed`, by about {round(gain['exact'], -1):.0f} % with `exact`",
        "lambda":
            f"at the depths of the three virtual tasks the true lambda is {span(lambdas)}, and the published force "
            f"{span([value / constant for value in lambdas])} times that of the true one",
        "gains": f"{'; '.join(tables)}. `python -m benchmarks.paper` shows every claim with both",
    }  # fmt: skip


def page(arm: Arm | None = None) -> str:
    """Make docs/errata.md, with numbers computed on the states of an arm."""
    arm = Arm.load() if arm is None else arm
    return render("errata.md", poses=len(arm.states), **numbers(arm))


def write_page(given: argparse.Namespace) -> int:
    """Write the page, or with ``--check`` compare; status 1 where it does not agree."""
    text = page()
    if not given.check:
        write_atomically(given.out, text.encode())
    elif not given.out.exists() or given.out.read_text(encoding="utf-8") != text:
        print(f"{given.out} does not agree with the numbers: python -m benchmarks.errata", file=sys.stderr)
        return 1
    return 0


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the page, or check it; see `cli.run` for the exit status."""
    options = argparse.ArgumentParser(prog="python -m benchmarks.errata", description="Write docs/errata.md.")
    options.add_argument("--out", type=Path, default=PAGE, help="where the page is")
    options.add_argument("--check", action="store_true", help="compare only")
    return cli.run(options, write_page, arguments)


if __name__ == "__main__":
    sys.exit(main())

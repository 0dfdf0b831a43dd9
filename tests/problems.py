"""Seeded subproblems of random serial arms with a rigid tool."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moc_opt.qp.problem import NullSpaceQP
from moc_opt.robots.chain import Chain, Kinematics, build_kinematics

Array = NDArray[np.float64]
TOOL = 0.38  # wrist to tip [m]


@dataclass(frozen=True)
class Arm:
    """A serial arm at q = 0: axes (n, 3), points on them (n, 3) [m], tip (3,) and wrist (3,) [m]."""

    axes: Array
    points: Array
    tip: Array
    wrist: Array

    def terms(self, q: Array) -> tuple[Array, Array, Array]:
        """Return J_tip and J_wrist, (3, n) each [m/rad], and the gradient (n,) of mu."""
        R, t = np.eye(3), np.zeros(3)
        axes, points = np.empty_like(self.axes), np.empty_like(self.points)
        for i, (axis, point) in enumerate(zip(self.axes, self.points, strict=True)):
            axes[i], points[i] = R @ axis, R @ point + t
            turn = rotation(axis, float(q[i]))
            R, t = R @ turn, R @ (point - turn @ point) + t
        J_tip, J_wrist = (np.cross(axes, R @ place + t - points).T for place in (self.tip, self.wrist))
        i, j = np.indices((len(self.axes), len(self.axes)))
        turned = np.cross(axes[np.minimum(i, j)], J_tip.T[np.maximum(i, j)])  # dJ_j/dq_i
        mu = np.sqrt(max(np.linalg.det(J_tip @ J_tip.T), 0.0))
        return J_tip, J_wrist, mu * np.einsum("jk,ijk->i", np.linalg.pinv(J_tip), turned)

    def kinematics(self) -> Kinematics:
        """Return the arm as CasADi functions for NLP solvers."""
        ends = np.array([self.tip, self.wrist]) - self.points[-1]
        placed = np.diff(self.points, axis=0, prepend=np.zeros((1, 3)))
        turned, slides = np.tile(np.eye(3), (len(self.axes), 1, 1)), np.zeros(len(self.axes), dtype=np.bool_)
        return build_kinematics("arm", Chain(turned, placed, self.axes, slides, ends))


def rotation(axis: Array, angle: float) -> Array:
    K = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    return np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * (K @ K)


def unit(rng: np.random.Generator) -> Array:
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


def random_arm(rng: np.random.Generator, n: int = 7, structured: bool = True) -> Arm:
    """Return an arm with random axes and, if structured and n = 7, a spherical wrist."""
    axes = np.array([unit(rng) for _ in range(n)])
    points = rng.normal(scale=0.25, size=(n, 3))
    tool = unit(rng)
    if structured and n == 7:
        points[4:] = 0.0
        axes[6] = tool
    return Arm(axes, points, TOOL * tool, np.zeros(3))


def problem_of(arm: Arm, q: Array, x_inside: Array, lower: Array, upper: Array, **weights: float) -> NullSpaceQP:
    """Return the subproblem of `arm` at q. The joint velocities `x_inside` satisfy its equality constraints."""
    J_tip, J_wrist, grad_mu = arm.terms(q)
    return NullSpaceQP(
        J_tip, J_wrist, J_tip @ x_inside, J_wrist @ x_inside, grad_mu, lower=lower, upper=upper, q=q, **weights
    )


def random_box(rng: np.random.Generator, n: int) -> tuple[Array, Array]:
    return -rng.uniform(0.3, 3.0, n), rng.uniform(0.3, 3.0, n)


def smooth_sequence(
    rng: np.random.Generator, count: int, *, arm: Arm | None = None, **weights: float
) -> list[NullSpaceQP]:
    """Make `count` subproblems of one arm along a smooth motion, 2 ms apart."""
    arm = random_arm(rng) if arm is None else arm
    lower, upper = random_box(rng, len(arm.axes))
    start, phase = rng.uniform(-1.5, 1.5, len(arm.axes)), rng.uniform(0.0, 2.0 * np.pi, len(arm.axes))
    swing = 0.4 * np.minimum(-lower, upper)
    problems = []
    for t in 0.002 * np.arange(count):
        angle = phase + 2.0 * np.pi * 0.5 * t
        q = start + swing / np.pi * np.sin(angle)
        problems.append(problem_of(arm, q, swing * np.cos(angle), lower, upper, **weights))
    return problems


PARTS = ("J_tip", "J_wrist", "v_tip", "v_wrist", "grad_mu", "lower", "upper", "c0", "c1", "c2", "regularization", "q")


def changed(qp: NullSpaceQP, **parts: Any) -> NullSpaceQP:
    """Return the problem with some of its `PARTS` replaced."""
    return NullSpaceQP(**{**{name: getattr(qp, name) for name in PARTS}, **parts})


def random_problem(
    rng: np.random.Generator, n: int = 7, *, arm: Arm | None = None, structured: bool = True, **weights: float
) -> NullSpaceQP:
    """Return a subproblem at a random pose."""
    arm = random_arm(rng, n, structured) if arm is None else arm
    q = rng.uniform(-1.5, 1.5, len(arm.axes))
    lower, upper = random_box(rng, len(arm.axes))
    middle, half = 0.5 * (lower + upper), 0.5 * (upper - lower)
    return problem_of(arm, q, middle + 0.6 * half * rng.uniform(-1.0, 1.0, len(arm.axes)), lower, upper, **weights)


def out_of_reach(rng: np.random.Generator, qp: NullSpaceQP) -> NullSpaceQP:
    """Return `qp` with references that no x within the bounds meets (Farkas' lemma)."""
    w = qp.A.T @ rng.normal(size=6)
    reach = np.maximum(w * qp.lower, w * qp.upper).sum()
    b = qp.A @ w * (rng.uniform(1.1, 2.0) * reach / (w @ w))
    return changed(qp, v_tip=b[:3], v_wrist=b[3:])


def on_rows(qp: NullSpaceQP, x: Array) -> Array:
    """Return the solution of A y = b that is nearest to x."""
    return np.asarray(x - np.linalg.pinv(qp.A, rcond=1e-6) @ (qp.A @ x - qp.b))


def infeasible_problem(rng: np.random.Generator, n: int = 7, **options: Any) -> NullSpaceQP:
    return out_of_reach(rng, random_problem(rng, n, **options))

"""Solvers on recorded subproblems, one after the other: no robot, no feedback, the same data for all."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.timing import each_us, percentiles
from moc_opt.scenario import Scenario, run
from moc_opt.solvers.base import Solution, Solver
from moc_opt.subproblem import NullSpaceQP, judge

Array = NDArray[np.float64]


def record(scenario: Scenario) -> list[NullSpaceQP]:
    """The 500 Hz sequence of subproblems that a closed-loop run of ``scenario`` meets."""
    rows = run(scenario.change(judge=False, bound_samples=0)).subproblem
    return [NullSpaceQP.from_row(np.array(row)) for row in rows]


def expand(problems: list[NullSpaceQP]) -> None:
    """Compute what the adapters read (P, p, the five rows) before the clock starts."""
    for qp in problems:
        _ = qp.P, qp.p, qp.q
        qp.reduced()


@dataclass(frozen=True)
class Answers:
    """What one solver said to a sequence, judged."""

    solver: str
    mode: str  # "warm": one session for all; "cold": a new session for each
    every: int  # the sequence was thinned to each every-th problem
    us: Array
    setup_us: Array
    solutions: list[Solution]
    primal: Array
    natural: Array
    natural_best: Array
    relative: Array
    loss: Array
    verified: NDArray[np.bool_]

    def summary(self) -> dict[str, Any]:
        """Metrics of DESIGN's names; residuals over the answers that the solver gave."""
        claimed = np.array([s.status.label == "solved" for s in self.solutions])
        given = np.isfinite(self.primal)
        worst = {
            f"{name}_max": float(np.max(getattr(self, name)[given])) if given.any() else None
            for name in ("primal", "natural", "natural_best", "relative", "loss")
        }
        return {
            "solves": len(self.solutions),
            "claimed_solved": int(claimed.sum()),
            "verified_solved": int((claimed & self.verified).sum()),
            "verified": int(self.verified.sum()),
            "silently_wrong": int((claimed & ~self.verified).sum()),
            "failed": int((~claimed).sum()),
            **worst,
            "loss_mean": float(self.loss[given].mean()) if given.any() else None,
            "iterations_mean": float(np.mean([s.iterations for s in self.solutions])),
            **percentiles(self.us, "solve"),
            **percentiles(self.setup_us, "setup"),
        }

    def rows(self) -> list[dict[str, Any]]:
        """One row per solve."""
        return [
            {
                "part": f"open_loop_{self.mode}", "solver": self.solver, "index": i * self.every,
                "status": s.status.label, "iterations": s.iterations, "solve_us": self.us[i],
                "primal": self.primal[i], "natural": self.natural[i], "natural_best": self.natural_best[i],
                "relative": self.relative[i], "loss": self.loss[i], "verified": bool(self.verified[i]),
            }
            for i, s in enumerate(self.solutions)
        ]  # fmt: skip


def solve_all(name: str, solver: Solver, problems: list[NullSpaceQP], warm: bool, every: int = 1) -> Answers:
    """Solve a sequence warm (one session) or cold (a fresh session each), and judge every answer."""
    chosen = problems[::every]
    solutions: list[Solution] = []
    if warm:
        session = solver.start(chosen[0])
        setup = np.empty(0)
        us = each_us(session.solve, chosen, solutions)
    else:
        sessions: list[Any] = []
        setup = each_us(solver.start, chosen, sessions)
        pairs = list(zip(sessions, chosen, strict=True))
        us = each_us(lambda pair: pair[0].solve(pair[1]), pairs, solutions)
    X = np.array([s.x for s in solutions])
    Y = np.array([np.full(6, np.nan) if s.y is None else s.y for s in solutions])
    found = judge(np.array([qp.row for qp in chosen]), X, Y)
    return Answers(
        name, "warm" if warm else "cold", every, us, setup, solutions, *found, verified=found.verified()
    )

"""One NLP solver of CasADi called through buffers, from tick to tick."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from moc_opt.numerics.arrays import Array
from moc_opt.qp.equalities import assembled
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.solvers.base import ShownBySettings, Solution, Status, no_answer

# The rest (sqpmethod's "Search_Direction_Becomes_Too_Small", which is also its answer to an infeasible
# problem) proves nothing.
_STATUS = {
    "Solve_Succeeded": Status.SOLVED,
    "Maximum_Iterations_Exceeded": Status.MAX_ITER,
    "Infeasible_Problem_Detected": Status.INFEASIBLE,
    "0": Status.SOLVED,  # fatrop's; its 1 says no more than "not solved"
}


class _Call:
    """A CasADi function through its buffer: a plain call costs ten times as much."""

    def __init__(self, function: Any, arguments: dict[str, Array], results: dict[str, Array]) -> None:
        self._keep = arguments, results  # the buffer only holds their addresses
        self.run: Callable[[], None]
        self._buffer, self.run = function.buffer()
        for name, array in arguments.items():
            self._buffer.set_arg(function.index_in(name), array.data)
        for name, array in results.items():
            self._buffer.set_res(function.index_out(name), array.data)

    def stats(self) -> dict[str, Any]:
        """Return the solver's status of its last run."""
        return self._buffer.stats()  # type: ignore[no-any-return]


class NLPSession(ShownBySettings):
    """Buffers of one solver; the last answer in them is the warm start."""

    def __init__(self, settings: Any, solver: Any, places: Any) -> None:
        n = settings.kinematics.n
        self._settings, self._n = settings, n
        self._p = np.zeros(n + 7 + n + 6 + 2)
        self._x0, self._lower, self._upper, self._target = (np.zeros(k) for k in (n, n, n, 5))
        self._multipliers0, self._bound_multipliers0 = np.zeros(5), np.zeros(n)
        self._x, self._multipliers, self._bound_multipliers = np.zeros(n), np.zeros(5), np.zeros(n)
        self._q, self._base = np.zeros(n), np.zeros(7 + n)
        self._places = _Call(places, {places.name_in(0): self._q}, {places.name_out(0): self._base})
        self._solver = _Call(
            solver,
            {
                "x0": self._x0,
                "p": self._p,
                "lbx": self._lower,
                "ubx": self._upper,
                "lbg": self._target,
                "ubg": self._target,
                "lam_g0": self._multipliers0,
                "lam_x0": self._bound_multipliers0,
            },
            {"x": self._x, "lam_g": self._multipliers, "lam_x": self._bound_multipliers},
        )

    def solve(self, qp: NullSpaceQP) -> Solution:
        """Answer one subproblem."""
        if self._settings.supports(qp) is not None:
            return no_answer(qp.n, Status.UNSUPPORTED)
        n, part, lift = self._n, qp.fields, assembled(qp).lift
        self._q[:] = part.q
        self._places.run()
        self._p[:n] = part.q
        self._p[n : n + 7] = self._base[:7]
        np.subtract(part.grad_mu, self._base[7:], out=self._p[n + 7 : 2 * n + 7])
        self._p[2 * n + 7 : 2 * n + 13] = lift[3:, 3:].ravel(order="F")
        self._p[2 * n + 13 :] = part.weights[2:]
        self._lower[:], self._upper[:] = part.lower, part.upper
        np.dot(lift, part.b, out=self._target)
        if not self._settings.warm:
            self._forget()
        np.clip(self._x0, part.lower, part.upper, out=self._x0)
        try:
            self._solver.run()
        except RuntimeError:  # fatrop raises where a closed box leaves more equations than joints
            self._forget()
            return no_answer(n, Status.NUMERICAL)
        stats = self._solver.stats()
        status = _STATUS.get(str(stats["return_status"]), Status.NUMERICAL)
        iterations = int(stats["iter_count"])
        if not (np.isfinite(self._x).all() and np.isfinite(self._multipliers).all()):
            self._forget()
            return no_answer(n, Status.NUMERICAL, iterations)
        if status is Status.SOLVED:
            self._x0[:], self._multipliers0[:] = self._x, self._multipliers
            self._bound_multipliers0[:] = self._bound_multipliers
        else:
            self._forget()
        if status not in (Status.SOLVED, Status.MAX_ITER):
            return no_answer(n, status, iterations)
        y = np.dot(self._multipliers, lift) / self._settings.cost_scale
        return Solution(self._x.copy(), y, status, iterations)

    def _forget(self) -> None:
        for start in (self._x0, self._multipliers0, self._bound_multipliers0):
            start[:] = 0.0

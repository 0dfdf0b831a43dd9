"""SciPy's SLSQP as a solver of moc_opt, in twenty lines."""

from dataclasses import dataclass

from scipy.optimize import minimize

from moc_opt.solvers.base import Solution, Status


@dataclass(frozen=True)
class SLSQP:
    ftol: float = 1e-14
    name = "slsqp"

    def supports(self, qp):
        return None  # else the reason why it cannot solve qp

    def start(self, qp):
        return self  # there is no state between ticks, so this object is its own session

    def solve(self, qp):
        rows, scale = qp.reduced(), 1e3  # costs near 1e-4 are scaled up for ftol
        meets = {"type": "eq", "fun": lambda x: rows.A @ x - rows.b, "jac": lambda x: rows.A}
        found = minimize(lambda x: scale * qp.objective(x), 0.5 * (qp.lower + qp.upper), method="SLSQP",
                         jac=lambda x: scale * (qp.P @ x + qp.p), bounds=list(zip(qp.lower, qp.upper, strict=True)),
                         constraints=meets, options={"ftol": self.ftol, "maxiter": 200})  # fmt: skip
        status = Status.SOLVED if found.success else Status.NUMERICAL
        return Solution(found.x, None, status, found.get("nit", 0))  # no duals

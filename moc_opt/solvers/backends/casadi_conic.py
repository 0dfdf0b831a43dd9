"""CasADi's own conic solvers as ``casadi:NAME``, called through ``Function.buffer``.

A plain call of a CasADi function costs a hundred microseconds of conversions; through a buffer it
reads and writes fixed arrays and costs ten.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from moc_opt.errors import SolverError, UnknownNameError
from moc_opt.qp.equalities import ROWS, assembled
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.solvers import checks
from moc_opt.solvers.base import Solution, Status, no_answer
from moc_opt.solvers.options import checked

Array = NDArray[np.float64]
PREFIX = "casadi:"

# Only what is CasADi's own. Its other plug-ins bring a second copy of a library that has an adapter of its
# own here, and two copies in one process share symbols: with the packages daqp and highspy loaded, CasADi's
# daqp crashes and its highs raises. ipqp runs into max_iter on most of these problems, qpoases writes to the
# terminal whatever its print level; cbc, fatrop and superscs want another form of problem.
PLUGINS: dict[str, dict[str, Any]] = {
    "qrqp": {"print_iter": False, "print_header": False, "print_info": False, "max_iter": 100},
}
NEEDS_DAMPING = {"qrqp"}  # cycles on a singular cost


def reasons() -> dict[str, str | None]:
    """Every plug-in in ``PLUGINS`` -> None when this CasADi has it, else the reason why not."""
    return {
        name: None if ca.has_conic(name) else f"this CasADi was built without the plug-in {name!r}"
        for name in PLUGINS
    }


def factory(name: str) -> Callable[..., CasadiConic]:
    """The settings of one plug-in, still to be called with them.

    Raises:
        UnknownNameError: there is no such plug-in here.
        SolverError: CasADi was built without it.
    """
    found = reasons()
    if name not in found:
        raise UnknownNameError("casadi plug-in", name, found)
    if found[name] is not None:
        raise SolverError(f"solver {PREFIX + name!r} cannot run: {found[name]}")
    return partial(CasadiConic, name)


@dataclass(frozen=True)
class CasadiConic:
    """One conic plug-in.

    Args:
        plugin: name as CasADi spells it.
        rows: 5 or 6 equality rows; qrqp fails on six.
        cost_scale: multiplies P and p; the duals are scaled back.
        options: of the plug-in, on top of those in ``PLUGINS``; those of `moc_opt.solvers.options.ALLOWED`.
        warm: start from the last tick's answer and multipliers; after a jump of the data qrqp can then
            claim success for a wrong answer.

    Raises:
        SolverError: a setting is out of range; from ``start`` when the plug-in refuses an option.
    """

    plugin: str
    rows: int = 5
    cost_scale: float = 1e3
    options: Mapping[str, Any] = field(default_factory=dict, hash=False)
    warm: bool = False

    def __post_init__(self) -> None:
        checks.like_defaults(self, rows=ROWS)
        object.__setattr__(self, "options", checked(self.name, self.options))

    def __reduce__(self) -> tuple[Any, ...]:  # a mapping proxy cannot be pickled
        return CasadiConic, (self.plugin, self.rows, self.cost_scale, dict(self.options), self.warm)

    @property
    def name(self) -> str:
        """Name in the registry."""
        return PREFIX + self.plugin

    def supports(self, qp: NullSpaceQP) -> str | None:
        """qrqp needs a positive definite cost; every other plug-in takes all."""
        if self.plugin in NEEDS_DAMPING and qp.regularization <= 1e-10 * (qp.c0 + qp.c1):
            return (
                f"casadi's {self.plugin} cycles without regularization, which is {qp.regularization:g}: "
                "set regularization > 0"
            )
        return None

    def start(self, qp: NullSpaceQP) -> CasadiSession:
        """Build the function for the shape of ``qp``."""
        return CasadiSession(self, qp)


class CasadiSession:
    """One conic function and the arrays it reads and writes."""

    def __init__(self, settings: CasadiConic, qp: NullSpaceQP) -> None:
        self._settings = settings
        self._build(qp)

    def _build(self, qp: NullSpaceQP) -> None:
        self._shape = m, n = assembled(qp, self._settings.rows).A.shape
        form = {"h": ca.Sparsity.dense(n, n), "a": ca.Sparsity.dense(m, n)}
        options = {"error_on_fail": True, **PLUGINS[self._settings.plugin], **self._settings.options}
        try:
            self._function = ca.conic("subproblem", self._settings.plugin, form, options)
        except RuntimeError as error:
            raise SolverError(f"{self._settings.name}: options = {options} are refused: {error}") from error
        sizes = {
            "h": n * n,
            "g": n,
            "a": m * n,
            "lba": m,
            "uba": m,
            "lbx": n,
            "ubx": n,
            "x0": n,
            "lam_x0": n,
            "lam_a0": m,
        }
        self._in = {key: np.zeros(size) for key, size in sizes.items()}
        # matrices by columns, as CasADi stores them
        self._H, self._A = self._in["h"].reshape((n, n), order="F"), self._in["a"].reshape((m, n), order="F")
        self._x, self._cost, self._lam_a, self._lam_x = np.zeros(n), np.zeros(1), np.zeros(m), np.zeros(n)
        # CasADi keeps the addresses of these arrays, so they are only ever written into
        self._buffer, self._evaluate = self._function.buffer()
        for name, array in self._in.items():
            self._buffer.set_arg(self._function.index_in(name), array.data)  # type: ignore[call-arg]
        for name, array in zip(
            ("x", "cost", "lam_a", "lam_x"), (self._x, self._cost, self._lam_a, self._lam_x), strict=True
        ):
            self._buffer.set_res(self._function.index_out(name), array.data)  # type: ignore[call-arg]
        self._back = 1.0 / self._settings.cost_scale

    def update(self, qp: NullSpaceQP) -> None:
        """Write the subproblem into the function's buffers; another shape than the last one's builds a new function."""
        P, p, A, b, self._lift = assembled(qp, self._settings.rows)
        if A.shape != self._shape:
            self._build(qp)
        given, part, scale = self._in, qp.fields, self._settings.cost_scale
        np.multiply(P, scale, out=self._H)
        np.multiply(p, scale, out=given["g"])
        self._A[:] = A
        given["lba"][:] = given["uba"][:] = b
        given["lbx"][:], given["ubx"][:] = part.lower, part.upper

    def solve(self, qp: NullSpaceQP) -> Solution:
        """Answer one subproblem."""
        self.update(qp)
        try:
            self._evaluate()
        except RuntimeError:  # how CasADi reports a failure; asking for statistics every time costs 15 us
            self._start_from(False)
            return no_answer(qp.n, _verdict(self._buffer.stats()))
        self._start_from(self._settings.warm)
        return Solution(self._x.copy(), np.dot(self._lam_a, self._lift) * self._back, Status.SOLVED)

    def _start_from(self, last: bool) -> None:
        for key, value in (("x0", self._x), ("lam_x0", self._lam_x), ("lam_a0", self._lam_a)):
            self._in[key][:] = value if last else 0.0


def _verdict(stats: Mapping[str, Any]) -> Status:
    """Infeasible only where the plug-in says so."""
    text = f"{stats.get('unified_return_status', '')} {stats.get('return_status', '')}".lower()
    if "infeasible" in text and "dual_infeasible" not in text.replace(" ", "_"):
        return Status.INFEASIBLE
    if "limited" in text or "max" in text:
        return Status.MAX_ITER
    return Status.NUMERICAL

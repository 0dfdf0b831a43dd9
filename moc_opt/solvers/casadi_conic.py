"""CasADi's own conic solvers as ``casadi:NAME``, called through ``Function.buffer``.

A plain call of a CasADi function costs a hundred microseconds of conversions; through a buffer it
reads and writes fixed arrays and costs ten.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import casadi as ca
import numpy as np

from moc_opt.errors import SolverError
from moc_opt.solvers.base import Status
from moc_opt.solvers.library import Adapter, LibrarySession, Outcome
from moc_opt.solvers.options import checked

PREFIX = "casadi:"

# Only what is CasADi's own. Its other plug-ins bring a second copy of a library that has an adapter of its
# own here, and two copies in one process share symbols: with the packages daqp and highspy loaded, CasADi's
# daqp crashes and its highs raises. ipqp runs into max_iter on most of these problems, qpoases writes to the
# terminal whatever its print level; cbc, fatrop and superscs want another form of problem.
PLUGINS: dict[str, dict[str, Any]] = {
    "qrqp": {"print_iter": False, "print_header": False, "print_info": False, "max_iter": 100},
}
NEEDS_DEFINITE = {"qrqp"}  # cycles on a singular cost


def reasons() -> dict[str, str | None]:
    """Return every plug-in in ``PLUGINS`` -> None when this CasADi has it, else the reason why not."""
    return {
        name: None if ca.has_conic(name) else f"this CasADi was built without the plug-in {name!r}"
        for name in PLUGINS
    }


class CasadiSession(LibrarySession):
    """One conic function and the arrays it reads and writes."""

    def _allocate(self, m: int, n: int) -> dict[str, Any]:
        sizes = {
            "h": n * n, "g": n, "a": m * n, "lba": m, "uba": m, "lbx": n, "ubx": n, "x0": n, "lam_x0": n, "lam_a0": m,
        }  # fmt: skip
        self._in = given = {key: np.zeros(size) for key, size in sizes.items()}
        self._out = {"x": np.zeros(n), "cost": np.zeros(1), "lam_a": np.zeros(m), "lam_x": np.zeros(n)}
        # matrices by columns, as CasADi stores them
        return {
            "P": given["h"].reshape((n, n)), "p": given["g"], "A": given["a"].reshape((m, n), order="F"),
            "low": given["lba"], "high": given["uba"], "lower": given["lbx"], "upper": given["ubx"],
        }  # fmt: skip

    def _set_up(self, m: int, n: int) -> None:
        settings = self._settings
        form = {"h": ca.Sparsity.dense(n, n), "a": ca.Sparsity.dense(m, n)}
        options = {"error_on_fail": True, **PLUGINS[settings.plugin], **settings.options}
        try:
            self._function = ca.conic("subproblem", settings.plugin, form, options)
        except RuntimeError as error:
            raise SolverError(f"{settings.name}: options = {options} are refused: {error}") from error
        # CasADi keeps the addresses of these arrays, so they are only ever written into
        self._buffer, self._evaluate = self._function.buffer()
        for name, array in self._in.items():
            self._buffer.set_arg(self._function.index_in(name), array.data)  # type: ignore[call-arg]
        for name, array in self._out.items():
            self._buffer.set_res(self._function.index_out(name), array.data)  # type: ignore[call-arg]

    def _run(self) -> Outcome:
        status = Status.SOLVED
        try:
            self._evaluate()
        except RuntimeError:  # how CasADi reports a failure; asking for statistics every time costs 15 us
            status = _verdict(self._buffer.stats())
        last = status is Status.SOLVED and self._settings.warm
        for start, end in (("x0", "x"), ("lam_x0", "lam_x"), ("lam_a0", "lam_a")):
            self._in[start][:] = self._out[end] if last else 0.0
        return status, 0, self._out["x"].copy(), self._out["lam_a"]


@dataclass(frozen=True)
class CasadiConic(Adapter):
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
    session: ClassVar[type[LibrarySession]] = CasadiSession

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "options", checked(self.name, self.options))

    def __reduce__(self) -> tuple[Any, ...]:  # a mapping proxy cannot be pickled
        return CasadiConic, (self.plugin, self.rows, self.cost_scale, dict(self.options), self.warm)

    @property
    def name(self) -> str:  # type: ignore[override]
        """Name in the registry."""
        return PREFIX + self.plugin

    @property
    def needs(self) -> str:  # type: ignore[override]
        """What the plug-in needs of a cost; empty where it copes with every one."""
        return f"casadi's {self.plugin} cycles without regularization" if self.plugin in NEEDS_DEFINITE else ""


def _verdict(stats: Mapping[str, Any]) -> Status:
    """Return the status: infeasible only where the plug-in says so."""
    text = f"{stats.get('unified_return_status', '')} {stats.get('return_status', '')}".lower()
    if "infeasible" in text and "dual_infeasible" not in text.replace(" ", "_"):
        return Status.INFEASIBLE
    if "limited" in text or "max" in text:
        return Status.MAX_ITER
    return Status.NUMERICAL

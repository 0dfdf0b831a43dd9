"""Test sets of the subproblem with certified answers. ``benchmarks/testsets.py`` makes these sets."""

from __future__ import annotations

import io
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moc_opt.arrays import Array
from moc_opt.errors import MocOptError, UnknownNameError
from moc_opt.inputs.files import read_arrays
from moc_opt.qp.problem import NullSpaceQP

SEQUENCES = ("circle", "sinusoid", "spiral", "circle-rho0", "sinusoid-rho0", "spiral-rho0")
INCONSISTENT = tuple(f"inconsistent-1e{power}" for power in (-12, -10, -8, -6, -4))
NAMES = (*SEQUENCES, "random", "near-singular", "joint-limits", "infeasible", *INCONSISTENT, "jumps")
FOLDER = Path(__file__).parent / "subproblems"
ARGUMENTS = (
    "J_tip", "J_wrist", "v_tip", "v_wrist", "grad_mu", "lower", "upper", "c0", "c1", "c2", "regularization", "q",
    "pull",
)  # fmt: skip


class CertificateError(MocOptError, ArithmeticError):
    """An answer cannot be certified, or a test set is not usable."""


@dataclass(frozen=True)
class TestSet:
    """Problems with their certified answers."""

    __test__ = False  # tells pytest that this is no test class

    name: str
    rows: Array  #: (k, 11 n + 10), see `NullSpaceQP.row`
    x: Array  #: (k, n) optima [rad/s], NaN if infeasible
    feasible: NDArray[np.bool_]  #: (k,)

    def problems(self) -> list[NullSpaceQP]:
        """Return the subproblems in order."""
        return [NullSpaceQP.from_row(np.array(row)) for row in self.rows]

    @cached_property
    def judged(self) -> Array:
        """The problems changed by `straightened`, (k, 11 n + 10). Residuals of answers are computed with these."""
        return np.array([straightened(qp).row for qp in self.problems()])

    def thinned(self, every: int) -> TestSet:
        """Return a set of every ``every``-th problem."""
        found = TestSet(self.name, self.rows[::every], self.x[::every], self.feasible[::every])
        vars(found)["judged"] = self.judged[::every]  # fills the cached property
        return found

    def to_bytes(self) -> bytes:
        """Return the set as an .npz file."""
        buffer = io.BytesIO()
        np.savez_compressed(buffer, rows=self.rows, x=self.x, feasible=self.feasible)
        return buffer.getvalue()

    @classmethod
    def load(cls, name: str, folder: Path = FOLDER) -> TestSet:
        """Read a set by name. Raise a CertificateError if the file or an array is missing."""
        path = folder / f"{name}.npz"
        if not path.exists():
            raise CertificateError(f"test set {name!r}: no file {path}; make it with: python -m benchmarks.testsets")
        arrays = read_arrays(path, f"test set {name!r}:", CertificateError)
        try:
            return cls(name, arrays["rows"], arrays["x"], arrays["feasible"])
        except KeyError as error:
            raise CertificateError(f"test set {name!r}: {path} has no array {error}; make it again") from error


def check_name(name: str) -> None:
    """Raise an UnknownNameError if there is no such set."""
    if name not in NAMES:
        raise UnknownNameError("test set", name, NAMES)


def straightened(qp: NullSpaceQP) -> NullSpaceQP:
    """Return the subproblem with the wrist's reference velocity along the shaft set to the tip's."""
    five = qp.reduced()
    b = np.linalg.lstsq(five.lift, five.b, rcond=None)[0] if len(five.b) == 5 else np.array(qp.b)
    b[3:] += five_row_gap(qp, b)  # the tool is rigid: no x meets velocities that differ along the shaft
    return changed(qp, v_tip=b[:3], v_wrist=b[3:], q=None)


def changed(qp: NullSpaceQP, **values: Any) -> NullSpaceQP:
    """Return the subproblem with some constructor arguments replaced."""
    return NullSpaceQP(**{name: getattr(qp, name) for name in ARGUMENTS} | values)


def five_row_gap(qp: NullSpaceQP, b: NDArray[np.floating]) -> Array:
    """Return the difference of the reference velocities along the shaft, tip minus wrist (3,) [m/s]."""
    u = np.linalg.svd(qp.J_tip - qp.J_wrist)[0][:, 2]
    return np.asarray(u * (u @ (b[:3] - b[3:])))

"""The form of a solver's answer; what it is worth the core says (`moc_opt/core/answer.c`)."""

from __future__ import annotations

import numpy as np

from moc_opt.solvers.base import Solution, Status, no_answer

MOST_ITERATIONS = 2**31 - 1  #: The largest number that a trace can hold.

_DOUBLE, _SIX = np.dtype(np.float64), (6,)
_INTEGERS = frozenset({int, *(np.dtype(code).type for code in np.typecodes["AllInteger"])})  # no types made from them


def received(given: object, n: int) -> tuple[Solution, str]:
    """Copy a solver's answer, and return what is wrong with its form as a ``Solution`` ("" for nothing).

    The copy shares no memory with the solver's: x (n,) and y (6,) are arrays of float64 without gaps, iterations an
    int that fits 32 bits. If any part is malformed, the whole answer is refused and x is NaN. NaN in x or y is no
    error of form.
    """
    if not isinstance(given, Solution):
        return no_answer(n, Status.NUMERICAL), f"solve returned a {type(given).__name__}: return a Solution"
    x, y, status, iterations = Solution._make(tuple.__iter__(given)) if type(given) is not Solution else given
    if type(status) is not Status:
        wrong, status = f"the status is a {type(status).__name__}: give a Status", Status.NUMERICAL
    else:
        wrong = _unlike("x", x, (n,)) or ("" if y is None else _unlike("y", y, _SIX))
        if not wrong and type(iterations) not in _INTEGERS:
            wrong = f"iterations is a {type(iterations).__name__}: give an int"
        elif not wrong and not 0 <= iterations <= MOST_ITERATIONS:
            wrong = f"iterations is out of range: give 0 to {MOST_ITERATIONS}"
    if wrong:
        return no_answer(n, status), wrong
    return Solution(x.copy(), None if y is None else y.copy(), status, int(iterations)), ""


def _unlike(name: str, value: object, shape: tuple[int, ...]) -> str:
    if type(value) is not np.ndarray:
        return f"{name} is a {type(value).__name__}: give an array of float64"
    if value.dtype != _DOUBLE:
        return f"{name} is an array of {value.dtype}: give an array of float64"
    return "" if value.shape == shape else f"{name} has shape {value.shape}: give {shape}"

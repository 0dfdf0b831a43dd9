"""The places of a packed subproblem are those of its fields, and of the record that the C code reads."""

import re
from importlib.resources import files

import numpy as np
import pytest

from moc_opt.qp.layout import C0, C1, C2, RHO, Offsets, joints_of, offsets
from moc_opt.qp.problem import NullSpaceQP, fields, row_length


@pytest.mark.parametrize("n", [1, 6, 7, 9])
def test_offsets_are_those_of_the_fields(n):
    record = np.arange(float(row_length(n)))
    named, at = fields(record), offsets(n)
    assert at.end == len(record)
    assert joints_of(at.end) == n
    for name in named._fields:
        assert getattr(named, name).ravel()[0] == getattr(at, name)
    assert sum(part.size for part in named) == at.end


def test_weights_by_name():
    qp = NullSpaceQP(*np.zeros((2, 3, 4)), *np.zeros((2, 3)), np.zeros(4), -np.ones(4), np.ones(4), 1.0, 2.0, 3.0, 4.0)
    weights = qp.row[offsets(4).weights :]
    assert (weights[C0], weights[C1], weights[C2], weights[RHO]) == (1.0, 2.0, 3.0, 4.0)
    assert (qp.c0, qp.c1, qp.c2, qp.regularization) == (1.0, 2.0, 3.0, 4.0)


def test_the_c_header_has_the_same_places():
    text = (files("moc_opt.embedded") / "c" / "moc_subproblem.h").read_text()
    known = {"MOC_N": 7}
    for name, value in re.findall(r"(MOC_\w+) = ([^,\n}]+)", text):
        known[name] = eval(value, {}, known)
    at: Offsets = offsets(7)
    assert [known[f"MOC_{key}"] for key in ("A", "B", "GRAD", "LOWER", "UPPER", "C2", "RHO", "RECORD")] == [
        at.A, at.b, at.grad_mu, at.lower, at.upper, at.weights + C2, at.weights + RHO, at.end,
    ]  # fmt: skip

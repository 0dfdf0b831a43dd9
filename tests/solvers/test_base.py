"""An answer says in one line what it is."""

import numpy as np

from moc_opt.solvers.base import Solution, Status


def test_an_answer_shows_itself():
    found = Solution(np.array([0.1, -2.0]), None, Status.MAX_ITER, 7)
    assert repr(found) == "Solution(status=max_iter, x=[ 0.1, -2. ], y=none, iterations=7)"
    assert "max_iter" in found._repr_html_()
    assert found._fields == ("x", "y", "status", "iterations")

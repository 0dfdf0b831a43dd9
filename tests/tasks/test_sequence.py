"""Legs follow one another without a jump."""

import numpy as np
import pytest

from moc_opt.errors import TaskError
from moc_opt.tasks import Reference, circle, line
from moc_opt.tasks.sequence import ReferenceSequence

A, B = np.array([0.5, 0.0, 0.1]), np.array([0.52, 0.01, 0.08])
APPROACH = Reference(line(A, B), 0.05, 0.2, t_start=0.3)
TASK = Reference(circle(B, (1, 0, 0), radius=0.02, normal=(0, 0, 1)), 0.03, 0.1, t_start=0.5)


def test_times_add_up():
    both = ReferenceSequence([APPROACH, TASK])
    assert both.t_start == 0.3
    assert both.starts() == pytest.approx([0.3, 0.8 + APPROACH.duration])
    assert both.duration == pytest.approx(APPROACH.duration + 0.5 + TASK.duration)
    assert (both.v_max, both.a_max) == (0.05, 0.2)


def test_each_leg_is_played_as_it_is_and_nothing_jumps():
    both = ReferenceSequence([APPROACH, TASK])
    t = np.arange(-0.5, both.t_start + both.duration + 0.5, 1e-3)
    x, dx, ddx = both.at(t)
    np.testing.assert_array_equal(x[0], A)
    np.testing.assert_allclose(both.rows(0.3 + APPROACH.duration + 0.25)[0], B, atol=1e-15)
    later = 0.3 + APPROACH.duration
    np.testing.assert_allclose(both.rows(later + 1.7), TASK.rows(1.7), atol=1e-12)
    assert np.linalg.norm(np.diff(x, axis=0), axis=1).max() <= 0.05e-3 * (1 + 1e-9)
    assert np.linalg.norm(dx, axis=1).max() <= 0.05 * (1 + 1e-9)
    assert np.linalg.norm(np.diff(dx, axis=0), axis=1).max() <= 0.2e-3 * (1 + 1e-6)
    assert np.linalg.norm(ddx, axis=1).max() <= 0.2 * (1 + 1e-9)
    np.testing.assert_allclose(x[-1], B, atol=1e-12)


def test_a_gap_between_legs_is_refused():
    away = Reference(line(B + np.array([0.001, 0, 0]), A), 0.05, 0.2)
    with pytest.raises(TaskError, match="leg 1 begins 1 mm from the end of leg 0"):
        ReferenceSequence([APPROACH, away])


def test_no_legs_and_negative_rests_are_refused():
    with pytest.raises(TaskError, match="one leg or more"):
        ReferenceSequence([])
    with pytest.raises(TaskError, match="t_start = -1"):
        ReferenceSequence([APPROACH, Reference(TASK.path, 0.03, 0.1, t_start=-1.0)])

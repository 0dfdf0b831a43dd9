"""Targets put the shaft through the trocar at every time, and refuse a trocar that is not on the shaft."""

from __future__ import annotations

import numpy as np
import pytest

from moc_opt.errors import TaskError
from moc_opt.planning.targets import lay_targets
from moc_opt.tasks import Reference, Trocar, make_path
from moc_opt.tasks.trocar import shaft_distance

START = np.array([0.5, 0.0, 0.1])


def reference(length: float = 0.04) -> Reference:
    path = make_path("line", START, normal=(0.0, 0.0, 1.0), heading=(1.0, 0.0, 0.0), length=length)
    return Reference(path, 0.05, 0.2, t_start=0.5)


def test_the_shaft_passes_a_breathing_trocar() -> None:
    trocar = Trocar(START + np.array([0.0, 0.02, 0.15]), 0.01, 2.0, (0.0, 0.0, 1.0))
    found = lay_targets(reference(), trocar, 0.378, 3.0, 31)
    assert found.period_s == pytest.approx(0.1)
    np.testing.assert_allclose(np.linalg.norm(found.wrist - found.tip, axis=1), 0.378, atol=1e-12)
    assert shaft_distance(found.tip, found.wrist, trocar.at(found.t_s)[0]).max() < 1e-12
    assert found.arc_length_m[-1] == pytest.approx(0.04, abs=1e-9)
    assert not found.tip.flags.writeable


@pytest.mark.parametrize("point", [[0.52, 0.0, 0.1], [0.5, 0.0, 0.6]])
def test_a_trocar_off_the_shaft_is_refused(point: list[float]) -> None:
    with pytest.raises(TaskError, match="trocar: at t = "):
        lay_targets(reference(), Trocar(point), 0.378, 3.0, 301)


@pytest.mark.parametrize("tool_m", [0.3, 0.4])
def test_no_more_of_the_shaft_than_the_tool_or_the_span_lies_in_the_trocar(tool_m: float) -> None:
    """As a run's own check has it: above the mount there is no shaft."""
    deepest = min(tool_m, 0.378)
    beyond = Trocar(START + np.array([0.0, 0.0, deepest + 1e-3]))
    with pytest.raises(TaskError, match=f"2 to {1e3 * deepest:.0f} mm from its tip"):
        lay_targets(reference(), beyond, 0.378, 3.0, 2, tool_m)


def test_one_time_is_refused() -> None:
    with pytest.raises(TaskError, match="count = 1"):
        lay_targets(reference(), Trocar(START + np.array([0.0, 0.0, 0.15])), 0.378, 3.0, 1)

"""Generated C for every arm of the package, or the reason why there is none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from moc_opt.errors import ControlError
from moc_opt.robots import available_robots
from moc_opt.scenario import Scenario, run
from moc_opt.scenario.exported import export_scenario
from tests.embedded.test_export import needs_compiler, own_cache

__all__ = ["own_cache"]


@pytest.mark.parametrize("name", available_robots())
def test_every_arm_is_exported_or_told_why_not(name: str, tmp_path: Path) -> None:
    asked = Scenario(robot={"name": name}, duration_s=0.3, bound_samples=0)
    if name == "lwr4_rail":
        with pytest.raises(ControlError, match="'lwr4_rail': 7 joints move tip or wrist, and generated C needs six"):
            export_scenario(asked, tmp_path)
        return
    files, operations = export_scenario(asked, tmp_path)
    assert len(files) > 30
    assert 20_000 < operations["in all"] < 100_000


@needs_compiler
@pytest.mark.parametrize("name", ["gen3"])
def test_the_compiled_tick_drives_another_arm_alike(name: str) -> None:
    """A tool against the link's z axis and offsets in the wrist: nothing that the LWR4+ has."""
    asked = Scenario(robot={"name": name}, duration_s=0.4, bound_samples=0, judge=False)
    python, compiled = run(asked), run(asked.change(control={"backend": "c"}))
    np.testing.assert_allclose(compiled.q_rad, python.q_rad, rtol=0, atol=1e-9)
    np.testing.assert_allclose(compiled.tau_Nm, python.tau_Nm, rtol=0, atol=1e-5)

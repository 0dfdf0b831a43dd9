"""A law written in Python runs in the closed loop as the package's own does."""

import runpy
from pathlib import Path

from moc_opt.scenario import Scenario, run

EXAMPLE = Path(__file__).parents[2] / "examples" / "own_law.py"


def test_the_example_s_law_follows_the_path_and_climbs():
    setup = runpy.run_path(str(EXAMPLE))["OwnSetup"]
    scenario = Scenario(duration_s=2.0, start={"swivel": 0.2}, judge=False, bound_samples=0)
    own, dcac = setup(scenario).trace(), run(scenario.change(control=scenario.control.matched_dcac()))
    assert own.meta["ended"] == "completed"
    assert 1e3 * own.tip_error_m.mean() < 3.0
    assert own.mu.mean() > 1.01 * dcac.mu.mean()

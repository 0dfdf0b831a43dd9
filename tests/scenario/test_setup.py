"""Objects built from a scenario: what a controller alone is built of."""

import numpy as np
import pytest

from moc_opt.scenario import Scenario, Setup

RUN = Scenario(duration_s=0.1, judge=False, bound_samples=0)


def test_the_control_end_of_a_wire_builds_no_plant(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = Setup(RUN)

    def refused(*given: object, **named: object) -> None:
        raise AssertionError("a plant was built")

    monkeypatch.setattr("moc_opt.scenario.objects.Plant", refused)
    alone = Setup(RUN, realtime=True)
    adapter = alone.adapter()
    refs = (np.stack(alone.reference.at(0.0)), np.stack(alone.registered.at(0.0)))
    adapter.start(alone.q_start, np.zeros(alone.robot.n), *refs)
    assert np.isfinite(adapter.tick(alone.q_start, np.zeros(alone.robot.n), *refs)).all()
    assert (alone.ticks, alone.q_start.tolist()) == (whole.ticks, whole.q_start.tolist())
    with pytest.raises(AssertionError, match="a plant was built"):
        Setup(RUN)

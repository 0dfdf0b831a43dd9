"""How a run ended, from the text that says it."""

import pytest

from moc_opt.trace.ending import Ending


@pytest.mark.parametrize(
    ("text", "ending", "whole"),
    [
        ("completed", Ending.COMPLETED, True),
        ("oscillated: joint_7 at 47 Hz, 0.51 rad/s", Ending.OSCILLATED, True),
        ("stopped: the tip is 12 mm off (t = 0.100 s)", Ending.STOPPED, False),
        ("ran away at t = 0.250 s", Ending.RAN_AWAY, False),
        ("failed", Ending.FAILED, False),
        ("ScenarioError: seed = -1", Ending.FAILED, False),
        ("", Ending.FAILED, False),
    ],
)
def test_the_first_word_decides(text, ending, whole):
    assert Ending.of(text) is ending
    assert Ending.of(text).whole is whole

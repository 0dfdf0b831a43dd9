"""Controllers of other packages (peers) do the task."""

import re

import numpy as np
import pytest

from benchmarks import peers
from benchmarks.peers import wrist_reference


@pytest.fixture(scope="module")
def task(robot):
    return peers.circle(robot)


@pytest.mark.parametrize("name", list(peers.PEERS))
def test_listed_peer_does_the_task(name, robot, task):
    if reason := peers.missing(name):
        pytest.skip(reason)
    poses, given = peers.perform(peers.PEERS[name](robot), robot, task)
    assert peers.verdict(poses, robot, task).failure is None
    assert len(given) == len(poses) == len(task.tip_refs)


class Puppet:
    """A velocity-level controller. The gains ``tip``, ``shaft`` and ``climb`` (of mu's gradient) can be wrong."""

    level = "velocity"

    def __init__(self, robot, *, tip=1.0, shaft=1.0, climb=30.0):
        self.robot, self.parts, self.climb = robot, np.repeat([tip, shaft], 3), climb

    def tick(self, q, v, tip_ref, trocar):
        state = self.robot.state(q)
        wrist, rate = wrist_reference(tip_ref, trocar, state.tool_span)
        error = np.r_[tip_ref[0] - state.tip, wrist - state.wrist]
        wanted = self.parts * (np.r_[tip_ref[1], rate] + 100.0 * error)
        pinv = np.linalg.pinv(state.A, rcond=1e-9)
        return pinv @ wanted + (np.eye(7) - pinv @ state.A) @ (self.climb * state.grad_mu)


@pytest.mark.parametrize(("wrong", "words"), [
    ({}, None), ({"tip": -1.0}, "tip is"), ({"tip": 0.1}, "tip is"), ({"shaft": 0.02}, "shaft is|tip is"),
    ({"climb": 0.0}, "manipulability rose"), ({"climb": -30.0}, "manipulability rose"),
])  # fmt: skip
def test_failing_peer_is_detected(wrong, words, robot, task, monkeypatch):
    monkeypatch.setitem(peers.PEERS, "puppet", lambda robot: Puppet(robot, **wrong))
    failure = peers.check("puppet")
    assert failure is None if words is None else re.search(words, failure)


def test_gravity_torques_hold_the_ideal_arm(robot, task):
    class Hold:
        level = "torque"

        def tick(self, q, v, tip_ref, trocar):
            return robot.state(q, v).h

    poses, _ = peers.perform(Hold(), robot, task)
    np.testing.assert_allclose(poses[:50], np.tile(task.q_start, (50, 1)), atol=1e-12)
    assert "tip is" in peers.verdict(poses, robot, task).failure
    assert peers.verdict(np.full_like(poses, np.nan), robot, task).failure is not None

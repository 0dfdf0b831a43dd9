"""Other people's controllers: one that is listed does the job, and one that does not is found out."""

import os
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from benchmarks import baselines as peers
from benchmarks.baselines import job as jobs
from benchmarks.baselines.job import tip_gradient, wrist_reference
from moc_opt.errors import UnknownNameError

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def work(robot):
    return jobs.job(robot)


def test_gradient_for_peers_is_the_model_s(robot, regular_poses):
    gradient = tip_gradient(robot)
    for q in regular_poses(5):
        np.testing.assert_allclose(gradient(q), robot.state(q).grad_mu, atol=1e-14)


def test_wrist_reference_puts_the_shaft_through_the_trocar(robot):
    state = robot.state(robot.data.q_home)
    tip_ref = np.array([state.tip + 0.01, [0.02, -0.01, 0.03], np.zeros(3)])
    trocar = np.array([state.tip - 0.15 * state.tool_direction, np.zeros(3)])
    wrist, rate = wrist_reference(tip_ref, trocar, state.tool_span)
    assert jobs.shaft_distance(tip_ref[0], wrist, trocar[0]) < 1e-12
    assert np.linalg.norm(wrist - tip_ref[0]) == pytest.approx(state.tool_span)
    moved = tip_ref + np.array([1e-6 * tip_ref[1], np.zeros(3), np.zeros(3)])
    later, _ = wrist_reference(moved, trocar, state.tool_span)
    np.testing.assert_allclose((later - wrist) / 1e-6, rate, atol=1e-5)


@pytest.mark.parametrize("name", list(peers.PEERS))
def test_a_peer_that_is_listed_does_the_job(name, robot, work):
    if reason := peers.missing(name):
        pytest.skip(reason)
    poses, given = jobs.perform(peers.create(name, robot, jobs.PERIOD_S), robot, work)
    assert jobs.verdict(poses, robot, work).failure is None
    assert len(given) == len(poses) == len(work.tip_refs)


class Puppet:
    """A velocity-level controller of five lines, to be made wrong in one respect."""

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


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({}, None),
        ({"tip": -1.0}, "tip is"),
        ({"tip": 0.1}, "tip is"),
        ({"shaft": 0.02}, "shaft is|tip is"),
        ({"climb": 0.0}, "manipulability rose"),
        ({"climb": -30.0}, "manipulability rose"),
    ],
)
def test_who_does_not_do_the_job_is_found_out(wrong, words, robot, work):
    poses, _ = jobs.perform(Puppet(robot, **wrong), robot, work)
    failure = jobs.verdict(poses, robot, work).failure
    assert failure is None if words is None else re.search(words, failure)


def test_a_torque_peer_moves_the_ideal_arm(robot, work):
    class Hold:
        level = "torque"

        def tick(self, q, v, tip_ref, trocar):
            return robot.state(q, v).h

    poses, _ = jobs.perform(Hold(), robot, work)
    np.testing.assert_allclose(poses[:50], np.tile(work.q_start, (50, 1)), atol=1e-12)
    assert "tip is" in jobs.verdict(poses, robot, work).failure
    assert jobs.verdict(np.full_like(poses, np.nan), robot, work).failure is not None


def test_a_peer_that_cannot_run_has_a_reason(robot, monkeypatch):
    with pytest.raises(UnknownNameError, match=r"peer 'tsit'.*'tsid'"):
        peers.create("tsit", robot, 0.002)
    entry = peers.Library("nobody", "Nobody", "a_package_that_nobody_has", "pip install it")
    monkeypatch.setitem(peers.PEERS, "nobody", entry)
    assert peers.missing("nobody") == "package 'a_package_that_nobody_has' is not installed: pip install it"
    # Of another process, which knows no such peer, or ends.
    monkeypatch.setitem(peers.PEERS, "crash", entry._replace(package="numpy"))
    assert "crash" in peers.missing("crash")
    monkeypatch.setattr(peers, "check", os._exit)
    monkeypatch.setitem(peers.PEERS, 3, entry._replace(package="numpy"))
    assert peers.missing(3) == "crashed: the process died (exit code 3)"


def test_the_extra_installs_what_is_said_to_be_installed_by_it():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]["peers"]
    given = {re.split(r"[<>=]", name)[0] for name in extras}
    assert given == {entry.install.removeprefix("pip install ") for entry in peers.PEERS.values() if entry.made}

"""The compiled signs of motion against their definitions, written with whole histories, on random readings."""

from __future__ import annotations

import numpy as np
import pytest

from moc_opt.control import motion_kernels as kernels
from moc_opt.control.observer import momentum_residual
from moc_opt.control.safety_settings import MotionSettings
from moc_opt.model.robot_model import RobotModel

N, PERIOD, TICKS = 7, 0.002, 260
TAU_MAX = np.linspace(40.0, 160.0, N)


def readings(rng, rest, whole):
    """Random q, v, tau, wrench, tip, elapsed of TICKS readings; from ``rest`` on all encoders repeat themselves.

    Before it a joint repeats its reading now and then; where ``whole`` the wrench does so too from ``rest`` on.
    """
    v = rng.normal(scale=0.05, size=(TICKS, N))
    elapsed = PERIOD * rng.integers(1, 4, TICKS)
    q = np.cumsum(elapsed[:, None] * v, axis=0) + rng.normal(scale=2e-4, size=(TICKS, N))
    for k in range(1, TICKS):
        kept = rng.random(N) < (1.0 if k > rest else 0.3)
        q[k, kept] = q[k - 1, kept]
        v[k] *= k <= rest
    wrench = rng.normal(size=(TICKS, 6))
    if whole:
        wrench[rest:] = wrench[rest]
    tau = np.cumsum(rng.normal(scale=0.02, size=(TICKS, N)), axis=0)
    tip = np.cumsum(rng.normal(scale=3e-5, size=(TICKS, 3)), axis=0)
    return q, v, tau, wrench, tip, elapsed


def in_a_row(same):
    """How often in a row True stands in each column of (k, m), up to each line."""
    count = np.zeros(same.shape)
    for k in range(1, len(same)):
        count[k] = np.where(same[k], count[k - 1] + 1, 0)
    return count


def expected(q, v, tau, wrench, tip, elapsed, patience, s):
    """What is wrong with each reading, by the definitions, from all readings up to it."""
    repeats = in_a_row(np.vstack([np.zeros((1, N), bool), np.diff(q, axis=0) == 0.0]))
    alike = np.concatenate([[False], (np.diff(wrench, axis=0) == 0.0).all(1)])
    wrench_repeats = in_a_row(alike[:, None])[:, 0]
    keep, gap, peak, found = 1.0 - np.minimum(1.0, elapsed / s.motion_s), np.zeros(N), np.abs(v[0]), []
    for k in range(len(q)):
        if k:
            gap = keep[k] * gap + q[k] - q[k - 1] - elapsed[k] * v[k]
            peak = np.maximum(keep[k] * peak, np.abs(v[k]))
        found.append(kernels.NOTHING)
        allowed = np.inf if s.repeat_reading_ticks is None else s.repeat_reading_ticks
        again = wholly_repeated(q, v)
        noise = k >= 99 and not alike[:100].any()
        if noise and wrench_repeats[k] > s.repeat_whole_ticks:
            found[-1] = kernels.WRENCH_REPEATED
        longest = np.inf if s.repeat_joint_ticks is None else s.repeat_joint_ticks
        if again[: k + 1].sum(0).max() > allowed or repeats[k].max() > longest:
            found[-1] = kernels.ONE_REPEATED
        if (np.abs(gap) > s.motion_rad + s.motion_lag_s * peak).any():
            found[-1] = kernels.RAN_AWAY
        if repeats[k].min() > patience:
            begun = np.flatnonzero(repeats[: k + 1].min(1) <= patience)[-1]
            whole = wrench_repeats[k] > patience
            way, torque = (s.repeat_whole_m, s.repeat_whole_torque) if whole else (s.repeat_m, s.repeat_torque)
            moved = np.abs(tip[k] - tip[begun]).max() > way or (np.abs(tau[k] - tau[begun]) > torque * TAU_MAX).any()
            if moved or (noise and wrench_repeats[k] > s.repeat_whole_ticks):
                found[-1] = kernels.REPEATED
        if again[: k + 1].all(1).sum() > allowed:
            found[-1] = kernels.REPEATED
    return found


def wholly_repeated(q, v):
    """Where a joint that has had a velocity repeats both position and velocity, (k, n)."""
    same = np.vstack([np.zeros((1, N), bool), (np.diff(q, axis=0) == 0.0) & (np.diff(v, axis=0) == 0.0)])
    return same & (np.maximum.accumulate(np.abs(v), axis=0) > 0.0)


LEVELS = [
    {}, {"motion_rad": 0.001, "motion_lag_s": 0.0}, {"motion_s": 0.01, "motion_rad": 1e-4, "motion_lag_s": 0.02},
    {"repeat_joint_ticks": 5}, {"repeat_reading_ticks": 0}, {"repeat_reading_ticks": 6}, {"repeat_whole_ticks": 4},
    {"repeat_m": 2e-4}, {"repeat_whole_m": 1e-4},
    {"repeat_torque": 2e-3}, {"repeat_whole_torque": 1e-3},
]  # fmt: skip


@pytest.mark.parametrize("whole", [False, True])
@pytest.mark.parametrize("levels", LEVELS)
def test_readings_are_judged_as_their_definitions_say(levels, whole):
    found = set()
    for seed, (rest, patience) in enumerate([(230, 3), (120, 0), (60, 5)]):
        s = MotionSettings(**({"motion_rad": 0.5, "repeat_torque": 0.5, "repeat_m": 0.5} | levels))
        given = readings(np.random.default_rng(seed), rest, whole)
        memory, still = np.zeros((kernels.ROWS, N)), np.zeros(13)
        memory[kernels.REPEATS] = -1.0
        wanted = expected(*given, patience, s)
        for k, now in enumerate(zip(*given, strict=True)):
            q, v, tau, wrench, tip, elapsed = now
            code = kernels.compare_readings(
                patience, TAU_MAX, s.levels, memory, still, q, v, tau, wrench, tip, elapsed
            )
            assert code == wanted[k], k
            assert kernels.has_noise(still) == (k >= 99 and not (whole and rest < 99))
            found.add(code)
    assert len(found) > 1 or not levels or (not whole and "whole" in "".join(levels)), "no level was reached"


@pytest.mark.parametrize(
    ("far_off", "speed", "told"),
    [(0.002, 1e9, kernels.UNEXPLAINED), (1.0, 1e-4, kernels.STUCK), (1.0, 1e9, kernels.NOTHING)],
)
def test_momentum_is_judged_as_its_definition_says(robot: RobotModel, far_off: float, speed: float, told: int) -> None:
    """r against its mean, and the speed that a joint that repeats its reading must have gathered."""
    rng = np.random.default_rng(0)
    s = MotionSettings(residual_torque=far_off, residual_s=0.05, stuck_rad_per_s=speed)
    held, patience, settled_at = np.full(N, 0.05), 2, 6
    memory = np.zeros((kernels.ROWS, N))
    integral, r = np.zeros(N), np.zeros(N)
    mean, begun, gathered, far = (np.zeros(N) for _ in range(4))
    found = set()
    for k in range(80):
        state = robot.state(np.array(robot.data.q_home), rng.normal(scale=1e-3, size=N))
        tau = robot.gravity(state.q) + rng.normal(scale=0.5, size=N) + (k > 40) * 2.0
        memory[kernels.REPEATS] = np.where(np.arange(N) < 3, k, 0)
        args = (patience, TAU_MAX, s.levels, memory, held, PERIOD, state.record, tau, int(k > settled_at))
        code = kernels.compare_momentum(*args)
        momentum_residual(
            state.M, state.energy_slope, state.gravity, state.v, tau, s.residual_rate_per_s, PERIOD, integral, r
        )
        np.testing.assert_allclose(memory[kernels.RESIDUAL], r, rtol=1e-12)
        if k <= settled_at:
            mean, begun, gathered = r.copy(), r.copy(), np.zeros(N)
        mean = mean + PERIOD / s.residual_s * (r - mean)
        beyond = np.sign(r - begun) * np.maximum(np.abs(r - begun) - held, 0.0)
        gathered = gathered + PERIOD * beyond / np.diag(state.M)
        far = np.where(np.abs(r - mean) > s.residual_torque * TAU_MAX, far + 1, 0)
        stuck = (np.where(np.arange(N) < 3, k, 0) > patience) & (np.abs(gathered) > s.stuck_rad_per_s)
        expected = (
            kernels.UNEXPLAINED if (far > patience).any() else kernels.STUCK if stuck.any() else kernels.NOTHING
        )
        assert code == expected, k
        found.add(code)
        if code == kernels.UNEXPLAINED:  # the arm is stopped: what is remembered serves nothing any more
            break
        np.testing.assert_allclose(memory[kernels.MEAN], mean, rtol=1e-9)
        np.testing.assert_allclose(memory[kernels.UNSEEN], gathered, rtol=1e-9, atol=1e-15)
        np.testing.assert_array_equal(memory[kernels.EXCEEDED], far)
    assert found == {kernels.NOTHING, told}


def test_what_is_gathered_unseen_begins_at_the_mean_of_the_residual():
    """Not at its last value, in which the velocity that one coarse step shows has its share."""
    s, rng = MotionSettings(), np.random.default_rng(3)
    memory, still = np.zeros((kernels.ROWS, N)), np.zeros(13)
    memory[[kernels.RESIDUAL, kernels.MEAN, kernels.UNSEEN]] = rng.normal(size=(3, N))
    kept = np.arange(N) < 3
    memory[kernels.SHOWN] = np.where(kept, 0.1, 0.2)
    unseen = memory[kernels.UNSEEN].copy()
    q, rest = np.full(N, 0.1), np.zeros(N)
    kernels.compare_readings(3, TAU_MAX, s.levels, memory, still, q, rest, rest, np.zeros(6), np.zeros(3), PERIOD)
    np.testing.assert_array_equal(memory[kernels.AT_REPEAT], np.where(kept, 0.0, memory[kernels.MEAN]))
    np.testing.assert_array_equal(memory[kernels.UNSEEN], np.where(kept, unseen, 0.0))

"""Where the wrist belongs: the shaft passes the trocar, and its velocity is the derivative."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from moc_opt.model.shaft_kernels import desired_wrist, desired_wrists
from moc_opt.tasks import Trocar, shaft_distance

BOTH = pytest.mark.parametrize("kernel", [desired_wrist, desired_wrist.py_func], ids=["compiled", "plain"])
SEEDS = st.integers(0, 2**32 - 1)


def unit(rng):
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


@BOTH
@settings(max_examples=60)
@given(seed=SEEDS)
def test_desired_wrist_velocity_is_the_derivative(kernel, seed):
    """Along a motion of tip and trocar, dN_d is the difference quotient of N_d."""
    rng = np.random.default_rng(seed)
    start, rate, distance = rng.normal(size=3), rng.uniform(0.5, 3.0), rng.uniform(0.1, 0.3)
    trocar = Trocar(start + distance * unit(rng), 0.02, 3.0, unit(rng))
    sway = 0.3 * distance * unit(rng)  # never as far as the trocar
    span, t, step = 0.378, rng.uniform(0.0, 3.0), 1e-5

    def desired(time):
        tip, velocity = start + sway * np.sin(rate * time), sway * rate * np.cos(rate * time)
        p, dp = trocar.at(time)
        return kernel(tip, velocity, p, dp, span)

    slope = (desired(t + step)[0] - desired(t - step)[0]) / (2.0 * step)
    np.testing.assert_allclose(desired(t)[1], slope, atol=1e-6 * (1.0 + np.abs(slope).max()))


@settings(max_examples=60)
@given(seed=SEEDS)
def test_desired_wrist_puts_the_shaft_through_the_trocar(seed):
    rng = np.random.default_rng(seed)
    tip, trocar = rng.normal(size=3), rng.normal(size=3)
    wrist, _ = desired_wrist(tip, np.zeros(3), trocar, np.zeros(3), 0.378)
    assert np.linalg.norm(wrist - tip) == pytest.approx(0.378, rel=1e-12)
    assert float(shaft_distance(tip, wrist, trocar)) < 1e-12
    assert (wrist - tip) @ (trocar - tip) > 0.0  # the trocar lies on the wrist's side


@settings(max_examples=60)
@given(seed=SEEDS, count=st.integers(0, 5))
def test_rows_are_wrists_one_by_one(seed, count):
    tips, trocars = np.random.default_rng(seed).normal(size=(2, count, 3))
    found = desired_wrists(tips, trocars, 0.4)
    assert found.shape == (count, 3)
    for tip, trocar, wrist in zip(tips, trocars, found, strict=True):
        way = trocar - tip
        np.testing.assert_allclose(wrist, tip + 0.4 * way / np.linalg.norm(way), rtol=1e-12, atol=1e-12)

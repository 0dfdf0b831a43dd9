"""Oscillation of traces."""

import numpy as np
import pytest

from moc_opt.errors import TraceError
from moc_opt.scenario import Scenario, run
from moc_opt.trace import oscillation as limits
from moc_opt.trace.oscillation import describe, judged_for_oscillation, shaking
from moc_opt.trace.trace import MissingDataError, Trace

PERIOD = 0.002
NAMES = tuple(f"joint_{i}" for i in range(1, 8))
SLIDES = (False,) * 7
QUICK = {"bound_samples": 0, "judge": False, "start": {"swivel": "random"}}
STIFF = {"K_X": 3000.0, "D_X": 80.0, "K_N": 800.0, "D_N": 60.0, "K_N2": 80.0, "D_N2": 1.0}


def made(joint=0, amplitude=0.0, hertz=50.0, column="v_rad_per_s", ticks=1500, period=PERIOD, where=None):
    """Return a slow motion with an oscillation of one `joint` between the times `where`."""
    t = period * np.arange(ticks)
    columns = {
        "t_s": t, "v_rad_per_s": 0.5 * np.sin(2.0 * np.pi * 0.5 * t)[:, None] * np.ones(7),
        "tau_Nm": 40.0 * np.cos(2.0 * np.pi * 0.5 * t)[:, None] * np.ones(7),
    }  # fmt: skip
    shape = np.ones(ticks) if where is None else (where[0] <= t) & (t < where[1])
    columns[column][:, joint] += amplitude * shape * np.sin(2.0 * np.pi * hertz * t)
    return Trace(columns, {"ended": "completed", "period_s": period})


@pytest.mark.parametrize(("ticks", "period"), [(8, 0.01), (8, 0.1), (8, 0.07), (12, 0.07), (90, 0.003), (1500, 0.002)])
def test_oscillation_figures_equal_their_definitions(ticks, period):
    t = 3.0 + period * np.arange(ticks)
    v = np.random.default_rng(ticks).normal(size=(ticks, 3)) + 3.0 * np.sin(2.0 * np.pi * 5.0 * t)[:, None]
    half, first = round(1.0 / 8.0 / period) // 2, min(round(0.5 / period), ticks // 2)
    mean = [v[max(k - half, 0) : k + half + 1].mean(axis=0) for k in range(ticks)]
    width = min(round(1.0 / period), ticks - first)
    windows = np.lib.stride_tricks.sliding_window_view((v - mean)[first:], width, axis=0)
    row, joint = np.unravel_index(np.argmax((windows**2).mean(axis=-1)), windows.shape[:2])
    worst = windows[row, joint]
    parts = sorted((part**2).sum() for part in np.array_split(worst, 8))
    hertz, size = np.fft.rfftfreq(width, period), np.abs(np.fft.rfft((worst - worst.mean()) * np.hanning(width)))
    largest = hertz[np.argmax(np.where((hertz >= 8.0 - 1e-9) | (hertz == hertz[-1]), size, -1.0))]
    rest = np.sqrt(sum(parts[:6]) / (0.75 * width))
    found = shaking(Trace({"t_s": t, "v_rad_per_s": v}), "v_rad_per_s")
    assert found[1:] == pytest.approx((np.sqrt(np.mean(worst**2)), largest, rest), abs=1e-9)
    assert found.joint == joint or period > 1.0 / 12.0  # above this period, the mean covers one tick: v - mean is 0
    for rms, rest, counts in ((0.3, 0.11, True), (0.3, 0.1, False), (0.2, 0.15, False), (0.1, 0.15, False)):
        assert found._replace(rms=rms, rest=rest).above(0.2) == counts


@pytest.mark.parametrize("factor", [0.9, 1.1])
@pytest.mark.parametrize(("column", "limit", "unit", "slides"), [
    ("v_rad_per_s", limits.LIMIT_RAD_PER_S, "rad/s", False), ("tau_Nm", limits.LIMIT_NM, "Nm", False),
    ("v_rad_per_s", limits.LIMIT_M_PER_S, "m/s", True), ("tau_Nm", limits.LIMIT_N, "N", True),
])  # fmt: skip
def test_joint_oscillates_only_above_its_limit(factor, column, limit, unit, slides):
    """Joint 5 shakes too, but below its limit."""
    trace = made(0, factor * np.sqrt(2.0) * limit, 71.0, column)
    values = np.array(getattr(trace, column))
    values[:, 4] += 0.5 * limits.LIMIT_RAD_PER_S * np.sin(2.0 * np.pi * 31.0 * trace.t_s)
    found = judged_for_oscillation(trace.with_columns(**{column: values}), NAMES, (slides, *SLIDES[1:])).meta
    assert found["period_s"] == PERIOD
    if factor < 1.0:
        assert found["ended"] == "completed"
    else:
        assert found["ended"].startswith("oscillated: joint_1 at 71 Hz, ")
        assert found["ended"].endswith(f" {unit}")


@pytest.mark.parametrize("joint", [2, 5])
@pytest.mark.parametrize(("amplitude", "where", "at", "size"), [
    (0.5, (1.7, 9.0), 0.8, 3.0), (0.283, (1.7, 9.0), 0.8, 1.13), (0.5, (0.0, 2.0), 3.6, 3.0),
])  # fmt: skip
def test_short_burst_does_not_hide_an_oscillation(joint, amplitude, where, at, size):
    """The burst of joint 3, `jerk`, is stronger than the oscillation."""
    values = np.array(made(joint, amplitude, 40.0, where=where, ticks=2000).v_rad_per_s)
    jerk = made(2, size, 16.0, where=(at, at + 0.0625), ticks=2000)
    values[:, 2] += jerk.v_rad_per_s[:, 2]
    assert describe(jerk, NAMES, SLIDES) == ""
    both = jerk.with_columns(v_rad_per_s=values)
    assert shaking(both, "v_rad_per_s").joint == 2  # the burst has the largest rms
    assert describe(both, NAMES, SLIDES).startswith(f"joint_{joint + 1} at 40 Hz")


@pytest.mark.parametrize(("amplitude", "hertz", "where", "says"), [
    # Slow motions.
    (1.0, 0.2, None, False), (1.0, 1.0, None, False), (1.0, limits.ABOVE_HZ / 4.0, None, False),
    # The start is not judged.
    (3.0, 40.0, (0.0, 0.9 * limits.START_S), False), (3.0, 40.0, (limits.START_S, 2.0 * limits.START_S), True),
    # Shaking for one second.
    (1.0, 47.0, (0.5, 1.5), True), (1.0, 47.0, (2.0, 3.0), True), (1.0, 47.0, (7.0, 8.0), True),
    # A burst of 0.1 s, and shaking for 0.5 s.
    *((2.0, 30.0, (begin, begin + 0.1), False) for begin in (1.0, 1.07, 1.9)),
    *((2.0, 30.0, (begin, begin + 0.5), True) for begin in (1.0, 1.07, 1.9)),
])  # fmt: skip
def test_only_lasting_shaking_is_an_oscillation(amplitude, hertz, where, says):
    trace = made(6, amplitude, hertz, ticks=4000, where=where)
    assert (describe(trace, NAMES, SLIDES).startswith(f"joint_7 at {hertz:.0f} Hz")) == says
    assert says or describe(trace, NAMES, SLIDES) == ""


def test_brief_run_or_stop_at_an_unknown_time_is_not_judged():
    shaken = made(0, 2.0)
    stopped = Trace(shaken.columns, {**shaken.meta, "ended": "stopped: x"})
    assert judged_for_oscillation(stopped, NAMES, SLIDES).meta == stopped.meta
    for ticks, says in ((450, "completed"), (500, "completed"), (501, "oscillated")):  # 501 ticks last 1 s
        for since in (0.0, 0.5):
            brief = Trace({**shaken.head(ticks).columns, "t_s": since + shaken.t_s[:ticks]}, shaken.meta)
            assert judged_for_oscillation(brief, NAMES, SLIDES).meta["ended"].startswith(says)


@pytest.mark.parametrize(("begin", "amplitude", "says"), [(1.0, 2.0, True), (1.0, 0.1, False), (2.01, 9.0, False)])
def test_stopped_run_names_only_an_oscillation_before_the_stop(begin, amplitude, says):
    trace = made(3, amplitude, 24.0, where=(begin, 3.0)).with_meta(ended="stopped: x (t = 2.000 s)", stopped_at_s=2.0)
    said = judged_for_oscillation(trace, NAMES, SLIDES).meta["ended"]
    assert said.startswith("stopped: x (t = 2.000 s)")
    assert ("; oscillated before: joint_4 at 24 Hz, " in said) == says
    assert said == trace.meta["ended"] or says


def test_trace_that_cannot_be_judged_is_refused():
    trace = made()
    for part, kind, said in (
        (trace.select(np.arange(len(trace)) % 3 == 0), MissingDataError, "some ticks are left out"),
        (trace.select(np.arange(len(trace)) < 3), MissingDataError, "four or more"),
        (trace.with_columns(t_s=np.zeros(len(trace))), TraceError, "does not increase"),
        (trace.with_columns(t_s=np.where(trace.t_s < 2.0, trace.t_s, np.inf)), TraceError, "does not increase"),
    ):
        with pytest.raises(kind, match=said):
            shaking(part, "v_rad_per_s")
    assert shaking(trace.select(trace.t_s > 0.5), "v_rad_per_s").rms < 0.1  # consecutive ticks


@pytest.mark.parametrize(("changes", "joint"), [
    ({"plant": {"delay_ticks": 2}, "control": STIFF}, "joint_5"),
    ({"plant": {"friction": 0.0}, "control": STIFF}, "joint_7"),
    ({"control": {**STIFF, "regularization": 0.0}}, "joint_5"),
], ids=["delay", "no friction", "rho = 0"])  # fmt: skip
def test_unstable_loop_is_found_to_oscillate(changes, joint):
    """The guard's thresholds are off, because they would stop these runs."""
    free = {"rcm_error_m": None, "trocar_force_N": None, "motion": False}
    trace = run(Scenario(seed=1, duration_s=4.0, guard=free, **changes, **QUICK))
    assert trace.meta["ended"].startswith(f"oscillated: {joint} at "), trace.meta["ended"]
    assert shaking(trace, "v_rad_per_s").rms > 2.0 * limits.LIMIT_RAD_PER_S


@pytest.mark.parametrize("changes", [
    {"control": {"preset": "robust"}}, {"control": {"law": "dcac"}}, {"solver": {"name": "rnn"}},
    {"faults": {"bump_N": 60.0}}, {"faults": {"encoder_noise_rad": 1e-4}}, {"plant": {"preset": "nominal"}},
    {"control": {"preset": "tuned"}, "plant": {"delay_ticks": 3}},
], ids=str)  # fmt: skip
def test_ordinary_runs_stay_below_half_of_the_limits(changes):
    trace = run(Scenario(seed=2, duration_s=5.0, **changes, **QUICK))
    assert trace.meta["ended"] == "completed"
    assert shaking(trace, "v_rad_per_s").rms < 0.5 * limits.LIMIT_RAD_PER_S
    assert shaking(trace, "tau_Nm").rms < 0.5 * limits.LIMIT_NM

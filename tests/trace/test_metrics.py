"""Each metric equals a number computed by hand."""

from __future__ import annotations

import math
from importlib.metadata import EntryPoint

import numpy as np
import pytest

from moc_opt.errors import MocOptError, TraceError
from moc_opt.trace import metrics
from moc_opt.trace.metrics import METRICS, metric, summarize
from moc_opt.trace.trace import MissingDataError, Trace

NAN = math.nan


def run(**changed: object) -> Trace:
    columns: dict[str, object] = {
        "t_s": [0.0, 0.002, 0.004, 0.006], "tau_Nm": [[0.0, 0.0], [3.0, 4.0], [3.0, 4.0], [3.0, 14.0]],
        "v_rad_per_s": [[0.0, 0.0], [0.0, 2.0], [0.0, 0.0], [0.0, 2.0]], "mu": [0.1, 0.2, 0.3, 0.4],
        "mu_bound": [0.2, NAN, 0.4, NAN], "mu_best_from_start": [0.1, 0.4, 0.5, 0.6], "mu_best": [0.5] * 4,
        "tip_error_m": [0.001, 0.003, 0.001, 0.003], "tip_error_registered_m": [0.0, 0.001, 0.002, 0.003],
        "tip_error_model_m": [0.0, 0.0, 0.0, 0.001], "rcm_error_m": [0.0, 0.0, 0.0, 0.004],
        "rcm_error_registered_m": [0.001, 0.0, 0.0, 0.001], "rcm_error_model_m": [0.0, 0.0, 0.003, 0.001],
        "trocar_force_N": [[3.0, 4.0, 0.0], [0.0, 0.0, -1.0], [0.0, 0.0, 0.0], [0.0, 2.0, 0.0]],
        "status": ["solved", "solved", "infeasible", "solved"], "fault": ["none", "lied", "infeasible", "stopped"],
        "limited": [3, 0, 1, 0], "verified": [True, False, True, False], "solve_us": [10.0, 20.0, NAN, 30.0],
        "tick_us": [50.0, 100.0, 150.0, 100.5], "primal": [1e-9, 1e-3, NAN, -0.0], "natural": [1e-8, 2e-3, NAN, 0.0],
        "loss": [0.0, 0.5, NAN, 0.25], "travelling": [True, False, True, False],
    }  # fmt: skip
    columns.update({name: value for name, value in changed.items() if name != "meta"})
    present = {name: np.asarray(value) for name, value in columns.items() if value is not None}
    return Trace(present, changed.get("meta", META))  # type: ignore[arg-type]


META = {"deadline_us": 100, "ended": "stopped: for a test", "ticks": 4, "ticks_planned": 16}


def test_every_metric_equals_its_hand_computed_value() -> None:
    summary = summarize(run(), baseline=run(mu=[0.2, 0.2, 0.2, 0.2]))
    expected = {
        "completed": 0.0, "share_of_run": 0.25, "mu_mean": 0.25, "mu_final": 0.4, "mu_gain_percent": 25.0,
        "mu_fraction_of_bound": 0.2 / 0.3, "mu_fraction_of_best_from_start": 0.25 / 0.4, "mu_fraction_of_best": 0.5,
        "tip_error_model_mean_mm": 0.25, "tip_error_model_max_mm": 1.0, "tip_error_registered_mean_mm": 1.5,
        "tip_error_registered_max_mm": 3.0, "tip_error_mean_mm": 2.0, "tip_error_max_mm": 3.0,
        "rcm_error_model_mean_mm": 1.0, "rcm_error_model_max_mm": 3.0, "rcm_error_registered_mean_mm": 0.5,
        "rcm_error_registered_max_mm": 1.0, "rcm_error_mean_mm": 1.0, "rcm_error_max_mm": 4.0,
        "trocar_force_mean_N": 2.0, "trocar_force_max_N": 5.0,
        # Steps of 5, 0 and 10 Nm in 2 ms.
        "torque_rate_rms_Nm_per_s": math.sqrt((2500.0**2 + 5000.0**2) / 3.0),
        # Joint 2 has the means 1 rad/s and 5.5 Nm over all four ticks. These two metrics use only ticks 3 and 4.
        # In these, joint 2 deviates from its means by -1 and 1 rad/s, and by -1.5 and 8.5 Nm.
        "oscillation_rad_per_s": 1.0, "oscillation_Nm": math.sqrt((1.5**2 + 8.5**2) / 2.0),
        "solve_p50_us": 20.0, "solve_p99_us": 29.8, "tick_p50_us": 100.25,
        "tick_p99_us": float(np.percentile([50.0, 100.0, 150.0, 100.5], 99)), "deadline_misses": 2.0,
        "claimed_solved": 3.0, "verified_solved": 2.0, "silently_wrong": 2.0, "faults": 2.0, "limited_ticks": 2.0,
        "primal_max": 1e-3, "natural_max": 2e-3, "loss_max": 0.5,
    }  # fmt: skip
    assert list(summary) == list(expected) == list(METRICS)
    assert summary == pytest.approx(expected, rel=1e-12)
    assert all(type(value) is float for value in summary.values())


def test_metrics_whose_data_are_missing_are_left_out() -> None:
    nothing = [NAN] * 4
    trace = run(meta={}, solve_us=nothing, primal=nothing, natural=nothing, loss=nothing, mu_bound=nothing)
    gone = {"mu_gain_percent", "deadline_misses", "solve_p50_us", "solve_p99_us", "primal_max"}
    gone |= {"natural_max", "loss_max", "mu_fraction_of_bound", "completed", "share_of_run"}
    assert set(METRICS) - set(summarize(trace)) == gone
    with pytest.raises(MissingDataError, match="give the trace of DCAC"):
        METRICS["mu_gain_percent"](trace)
    with pytest.raises(MissingDataError, match="'loss' is NaN at every tick"):
        METRICS["loss_max"](trace)
    without = set(METRICS) - set(summarize(run(tau_Nm=None, status=None), run()))
    assert without == {"torque_rate_rms_Nm_per_s", "oscillation_Nm", "claimed_solved", "silently_wrong"}
    assert summarize(run(meta={"ended": "oscillated: joint_7"}))["completed"] == 0.0
    for planned, share in ((1, 1.0), (0, None)):
        assert summarize(run(meta={"ticks": 1, "ticks_planned": planned})).get("share_of_run") == share
    assert "share_of_run" not in summarize(run(meta={"ticks": 1}))
    assert "mu_gain_percent" not in summarize(trace, baseline=run(mu=[0.0] * 4))
    assert "mu_gain_percent" in summarize(trace, baseline=run(t_s=None))


def test_metrics_of_a_diverged_run_are_nan_or_infinite() -> None:
    """NaN in a solver's column means that the tick had no subproblem. NaN in any other column means divergence."""
    summary = summarize(run(mu=[0.1, NAN, 0.3, 0.4], tip_error_m=[NAN] * 4, primal=[0.0, math.inf, NAN, 0.0]))
    assert np.isnan([summary["mu_mean"], summary["tip_error_max_mm"]]).all()
    assert summary["primal_max"] == math.inf


def test_torque_rate_skips_gaps_between_ticks() -> None:
    assert "torque_rate_rms_Nm_per_s" not in summarize(run().select([False, True, False, True]))
    ends = run().select([True, False, True, True])
    assert summarize(ends)["torque_rate_rms_Nm_per_s"] == pytest.approx(5000.0)


def test_trace_that_cannot_be_summarized_is_refused() -> None:
    empty = Trace({"mu": []})
    refused = {
        "trace is empty": lambda: summarize(empty), "baseline is empty": lambda: summarize(run(), empty),
        "'t_s' does not increase": lambda: summarize(run(t_s=[0.0, 0.002, 0.002, 0.004])),
        **{rf"deadline_us'\] = {bad!r}": lambda bad=bad: summarize(run(meta={"deadline_us": bad}))
           for bad in (0, -1.0, "fast", True)},
    }  # fmt: skip
    for said, call in refused.items():
        with pytest.raises(MocOptError, match=said):
            call()


def test_metric_can_be_registered() -> None:
    @metric
    def tip_speed_max_m_per_s(trace: Trace) -> float:
        """Largest speed of the tip [m/s]."""
        return float(trace.tip_speed_m_per_s.max())

    assert METRICS["tip_speed_max_m_per_s"].about == "Largest speed of the tip [m/s]."
    assert [METRICS[name].unit for name in ("completed", "loss_max", "mu_mean")] == ["1", "1", "m^3"]
    assert "tip_speed_max_m_per_s" not in summarize(run())
    speed = run().with_columns(tip_speed_m_per_s=[0.1, 0.5, 0.2, 0.3])
    assert summarize(speed)["tip_speed_max_m_per_s"] == tip_speed_max_m_per_s(speed) == 0.5

    def completed(trace: Trace) -> float:
        return 0.0

    with pytest.raises(TraceError, match="no docstring"):
        metric(completed)
    completed.__doc__ = "Another one."
    with pytest.raises(TraceError, match=r"'completed' already exists in moc_opt\.trace\.metrics"):
        metric(completed)
    # A notebook may register the same function again.
    assert metric(METRICS["completed"].function) is METRICS["completed"]


def test_broken_metric_does_not_hide_the_others(monkeypatch):
    values = {"len": "builtins:len", "number": "math:pi", "gone": "no_such:f", "abs": "builtins:abs"}
    found = {name: [EntryPoint(name, value, metrics.GROUP)] for name, value in values.items()}
    monkeypatch.setattr(metrics.plugins, "plugins", lambda group: found)
    monkeypatch.setattr(metrics, "_LOADED", {})
    trace = Trace({"t_s": [0.0, 0.1], "mu": [0.1, 0.2]})
    with pytest.warns(UserWarning, match="metric 'gone': .* does not load") as said:
        summary, lacking = metrics.evaluate(trace)
    assert any("is no function" in str(one.message) for one in said)
    assert any("'abs' cannot be computed (TypeError" in str(one.message) for one in said)
    assert (summary["len"], summary["mu_mean"], lacking.get("abs")) == (2.0, pytest.approx(0.15), None)
    assert (set(metrics.load_plugins()), lacking["faults"][:16]) == ({"number", "gone"}, "MissingDataError")

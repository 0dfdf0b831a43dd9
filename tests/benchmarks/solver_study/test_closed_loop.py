"""Sweeps in closed loop: replayed deadlines are exact, answers are followed as they are, costs begin where they do."""

from functools import partial

import numpy as np
import pytest

from benchmarks.solver_study import sweeps
from benchmarks.solver_study.cases import trials
from benchmarks.solver_study.closed_loop import Asked, run_each
from benchmarks.solver_study.sweeps import (
    accuracy_sweeps,
    beginning_of_cost,
    box_sweep,
    damping_sweep,
    deadline_sweep,
)
from moc_opt.errors import ScenarioError
from moc_opt.scenario import Scenario, make_solver, run
from moc_opt.study import run as run_jobs
from moc_opt.study.trials import BASELINE, variant

SHORT = Scenario(duration_s=0.2, bound_samples=2)
RNG = np.random.default_rng(8)
TIMES = tuple(np.round(RNG.lognormal(3.0, 0.5, 100), 2).tolist())


def replayed(late, budget, times=TIMES):
    return SHORT.change(
        solver={"name": "exact", "settings": {}, "replay_us": times},
        control={"supervisor": {"budget_us": budget, "late": late}},
    )


@pytest.mark.parametrize("late", ["hold", "zero", "iterate"])
def test_replayed_deadlines_repeat_to_the_bit(late):
    budget = float(np.percentile(TIMES, 80))
    one, two = run(replayed(late, budget)), run(replayed(late, budget))
    np.testing.assert_array_equal(one.q_rad, two.q_rad)
    np.testing.assert_array_equal(one.solve_us, TIMES)
    assert ((one.fault == "late") == (np.array(TIMES) > budget)).all()


def test_what_stands_for_a_late_answer_shows():
    budget = float(np.percentile(TIMES, 50))
    runs = {late: run(replayed(late, budget)) for late in ("hold", "zero", "iterate")}
    late = runs["zero"].fault == "late"
    assert 40 <= late.sum() <= 60
    assert (runs["zero"].applied_x_rad_per_s[late] == 0.0).all()
    np.testing.assert_array_equal(runs["iterate"].applied_x_rad_per_s, runs["iterate"].x_rad_per_s)
    np.testing.assert_array_equal(runs["iterate"].q_rad, run(SHORT).q_rad)  # nothing was lost
    k = int(np.flatnonzero(late[1:] & ~late[:-1])[0]) + 1
    np.testing.assert_array_equal(runs["hold"].applied_x_rad_per_s[k], runs["hold"].x_rad_per_s[k - 1])


def test_a_recording_begins_again_and_comes_from_a_file(tmp_path):
    path = tmp_path / "times.npy"
    np.save(path, np.array([1.0, 2.0, 30.0]))
    found = run(replayed("hold", 10.0, str(path)))
    np.testing.assert_array_equal(found.solve_us, np.resize([1.0, 2.0, 30.0], 100))
    assert (found.fault == "late").sum() == 33


def test_a_recording_that_is_none_is_refused(tmp_path):
    np.save(tmp_path / "bad.npy", np.array([[1.0, np.nan]]))
    for given, words in (
        (str(tmp_path / "bad.npy"), "one time"),
        (str(tmp_path / "no.npy"), r"no\.npy.*no such file"),
        ((), "at least"),
    ):
        with pytest.raises(ScenarioError, match=words):
            run(replayed("hold", 10.0, given))
    with pytest.raises(ScenarioError):
        replayed("hold", 10.0, (-1.0,))


def test_a_deadline_sweep_is_late_as_often_as_it_says():
    sweep = deadline_sweep("osqp", np.array(TIMES), [10.0])
    assert [p.label for p in sweep.points] == ["10% late, hold", "10% late, zero", "10% late, iterate"]
    point = sweep.points[0].changes
    budget, times = point["control"]["supervisor"]["budget_us"], np.array(point["solver"]["replay_us"])
    assert np.mean(times > budget) == pytest.approx(0.1, abs=0.011)


def test_every_point_of_every_sweep_is_a_scenario(robot):
    for sweep in [*accuracy_sweeps(True), damping_sweep(True), box_sweep(True)]:
        assert len({p.label for p in sweep.points}) == len(sweep.points)
        for point in sweep.points:
            changed = SHORT.change(**{k: dict(v) for k, v in point.changes.items()})
            assert changed.control.law == "moc"
            make_solver(changed.solver.name, robot, **changed.solver.settings)
            if point.setting is not None:
                assert not changed.control.supervisor.check
                assert dict(point.setting.options) == changed.solver.settings


def of_points(points, cases):
    do = partial(run_jobs, workers=2)
    bases = run_each(do, [Asked(BASELINE, variant(trial, BASELINE)) for trial in cases.values()])
    runs = sweeps.run_points(do, points, cases)
    return [sweeps.figures(point, mine, bases) for (_, point), mine in zip(points, runs, strict=True)]


def test_one_step_of_the_network_loses_manipulability():
    cases = trials(Scenario(duration_s=2.0, bound_samples=4), ["circle"], 9, 1)  # begins far below the best swivel
    (sweep,) = (s for s in accuracy_sweeps(False) if s.name == "rnn.steps")
    chosen = [p for p in sweep.points if p.label in ("steps=1", "steps=100")]
    one, many = of_points([(sweep, point) for point in chosen], cases)
    assert one["mu_mean"] < 0.98 * many["mu_mean"]
    assert 0.0 < one["mu_fraction_of_bound"] < many["mu_fraction_of_bound"] <= 1.0
    assert one["primal_max"] > 3.0 * many["primal_max"]
    assert not any(key.endswith("_us") for key in one)  # several run at a time: times would mean nothing


def test_a_narrow_box_is_infeasible_and_the_share_is_counted():
    cases = trials(Scenario(duration_s=4.0, bound_samples=2), ["circle"], 0, 1)
    points = {p.label: p for p in box_sweep(False).points}
    labels = ("k0=0.1 hold", "k0=5 least-violation")
    found = dict(zip(labels, of_points([(box_sweep(False), points[label]) for label in labels], cases), strict=True))
    assert found["k0=0.1 hold"]["infeasible_percent"] > 0.0
    assert found["k0=5 least-violation"]["infeasible_percent"] == 0.0


def test_costs_begin_where_a_metric_leaves_its_last_value():
    points = {f"eps={v:g}": {"mu_mean": m, "tip_error_model_mean_mm": 1.0} for v, m in
              ((1e-1, 0.2), (1e-2, 0.30), (1e-3, 0.299), (1e-4, 0.3))}  # fmt: skip
    found = beginning_of_cost(points)
    assert found == {"mu_mean": "eps=0.01", "tip_error_model_mean_mm": "eps=0.1"}

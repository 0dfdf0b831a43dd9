import numpy as np
import pytest

from benchmarks import faults
from benchmarks.faults import FREE, Case, Config, measure, recovery, run_case, worst
from benchmarks.goals import judge
from moc_opt.scenario import Scenario
from moc_opt.study.command import CONFIGS
from moc_opt.study.results import Results
from moc_opt.trace.trace import Trace

SHIPPED = Config.load(CONFIGS / "faults.toml")
TINY = """
trials = 1
solvers = ["exact"]
scenario = { control = { preset = "tuned" }, duration_s = 0.4, bound_samples = 0 }
[cases]
lies = { group = "solver", faults = { solver = "lie", solver_share = 0.2 } }
gone = { group = "sensors", faults = { nan_at_s = 0.1, nan_ticks = 100000 }, from_s = 0.1 }
camera = { group = "camera", camera_lost_s = [0.1, 0.2] }
"""


def run_of(error, level=1e-3, **meta):
    error = np.asarray(error, dtype=float)
    n = len(error)
    columns = {
        "t_s": 0.01 * np.arange(n), "tip_error_m": error, "rcm_error_m": np.full(n, level),
        "tip_m": np.zeros((n, 3)), "trocar_force_N": np.zeros((n, 3)), "v_rad_per_s": np.zeros((n, 7)),
    }  # fmt: skip
    return Trace(columns, {"ended": "completed", **meta})


def test_every_configured_fault_changes_the_scenario():
    assert {case.group for case in SHIPPED.cases.values()} == {"solver", "sensors", "plant", "contact", "camera"}
    for case in SHIPPED.cases.values():
        assert case.corrupt(SHIPPED.scenario) != SHIPPED.scenario or case.camera_lost_s is not None
    kinds = {case.faults.get("solver") for case in SHIPPED.cases.values()} - {None}
    assert kinds == {"fail", "nan", "lie", "raise", "outside", "rig", "malformed", "hang"}


def test_summary_counts_every_run(tiny):
    study = tiny(faults, TINY)
    assert [(row["controller"], row["case"]) for row in study.rows] == [
        ("dcac", "none"), ("dcac", "gone"), ("dcac", "camera"),
        ("exact", "none"), ("exact", "lies"), ("exact", "gone"), ("exact", "camera"),
    ]  # fmt: skip
    summary = study.summary
    gone, lies = summary["cases"]["gone"]["exact"], summary["cases"]["lies"]["exact"]
    assert (gone["stopped"], lies["survived"]) == (1, 1)
    assert lies["injected"] == lies["detected"] > 10
    assert summary["goals"]["missed"]["reached"] == "yes"


def test_recovery_ends_when_errors_stay_below_limits():
    free = run_of(np.full(300, 1e-3))
    error = np.full(300, 1e-3)
    error[100:150] = 5e-3
    case = Case(group="contact", from_s=1.0, until_s=1.4)
    # From t = 1.69 s on, the mean of the current row and the 19 before it is below the threshold.
    assert recovery(run_of(error), free, case, "completed") == pytest.approx(1.69 - 1.4, abs=0.02)
    assert recovery(run_of(error), free, Case(group="plant"), "completed") == pytest.approx(1.69, abs=0.02)
    assert recovery(free, free, case, "completed") == 0.0
    assert recovery(run_of(np.full(300, 2e-3)), free, case, "completed") is None
    assert recovery(run_of(error), free, case, "stopped: x") is None
    assert recovery(free, free, FREE["none"], "completed") == 0.0


@pytest.mark.parametrize(("error", "ended", "expected"), [
    (1e-3, "completed", "survived"), (0.05, "completed", "diverged"), (np.nan, "completed", "diverged"),
    (1e-3, "stopped: x", "stopped"), (1e-3, "ran away at t = 1 s", "ran away"),
    (1e-3, "oscillated: joint_7", "oscillated"),
])  # fmt: skip
def test_each_ending_gives_the_expected_outcome(error, ended, expected):
    free = run_of(np.full(10, 1e-3))
    found = measure(run_of(np.full(10, error), ended=ended), free, ended, FREE["none"], (20.0, 20.0))
    assert found["outcome"] == expected
    assert measure(None, free, "refused: x", FREE["none"], (20.0, 20.0)) == {"outcome": "refused"}


def test_detected_harmless_and_missed_faults_are_counted():
    trace = run_of(np.zeros(6)).with_columns(
        injected=[True, True, True, False, False, True],
        fault=["lied", "none", "none", "lied", "infeasible", "stopped"],
        verified=[False, True, False, True, True, False],
    )
    counts = {"injected": 3, "detected": 1, "harmless": 1, "missed": 1, "false_alarms": 1}
    assert faults.detection(trace) == counts


def row(case, solver, kind="survived", **figures):
    base = {"case": case, "group": "solver", "controller": solver, "trial": 0, "ended": "completed"}
    return {**base, "outcome": kind, "ticks": 100, "recover_s": 0.1, **figures}


def test_each_bad_row_makes_one_goal_fail():
    good = {"injected": 5, "detected": 5, "missed": 0, "rcm_mean_percent": 1.0, "rcm_max_percent": 2.0,
            "false_alarms": 0}  # fmt: skip

    def missed_goals(*rows):
        found = judge({"rows": worst(Results(rows))}, faults.goals_of(SHIPPED.cases))
        return [key for key, goal in found.items() if goal["reached"] != "yes"]

    fine = [
        row("solver-lies", "exact", **good), row("solver-nan-always", "exact", **{**good, "rcm_mean_percent": 4.0}),
        row("nan-lasting", "exact", "stopped", last_speed_rad_per_s=0.01, recover_s=None),
    ]
    assert missed_goals(*fine) == []
    assert "recover_s" not in worst(Results(fine))[-1]
    bad = [row("delay-5", "rnn", kind) for kind in ("diverged", "ran away", "refused")]
    bad += [row("solver-lies", "rnn", **{**good, name: value}) for name, value in (
        ("missed", 1), ("rcm_mean_percent", 6.0), ("rcm_max_percent", 6.0), ("false_alarms", 30),
    )]  # fmt: skip
    bad.append(row("solver-nan-always", "rnn", **{**good, "rcm_mean_percent": 6.0}))
    bad.append(row("nan-lasting", "rnn", "stopped", last_speed_rad_per_s=0.2))
    assert [len(missed_goals(*fine, one)) for one in bad] == [1] * 9, "each bad row makes one goal fail"
    [mixed] = worst(Results([row("a", "exact"), row("a", "exact", "stopped")]))
    assert mixed["outcome"] == "1 survived, 1 stopped"


def test_tip_reference_waits_while_the_camera_is_lost():
    asked = Scenario(control={"preset": "tuned"}, duration_s=2.0, bound_samples=0, judge=False)
    trace, ended = run_case(asked, (0.8, 1.4))
    assert ended == "completed"
    t, speed = trace.t_s[1:], np.linalg.norm(np.diff(trace.tip_ref_m, axis=0), axis=1) / 0.002
    assert (speed[(t > 1.2) & (t < 1.4)] == 0.0).all()
    assert speed[t > 1.8].min() > 0.001
    assert (speed <= 0.051).all()
    trace, ended = run_case(Scenario(robot={"name": "no such"}, duration_s=0.1), None)
    assert trace is None
    assert ended.startswith("refused: UnknownNameError")

"""The recorded sequence: what a run asked tick by tick, and nothing computed while the clock runs."""

import numpy as np

from benchmarks.solver_study.closed_parts import JOBS
from benchmarks.solver_study.config import Config, OpenLoop
from benchmarks.solver_study.solving import expand
from benchmarks.solver_study.study import Study, record_sequence, run_study

CONFIG = Config(open_loop=OpenLoop(ticks=40, cold=4), parts=["open_loop"])


def test_neighbours_are_one_period_apart():
    rows = np.array([qp.row for qp in record_sequence(CONFIG)])
    assert len(rows) == 40
    q = rows[:, -7:]
    assert 0.0 < np.abs(np.diff(q, axis=0)).max() < 0.02  # 2 ms at a few rad/s


def test_expanding_leaves_nothing_to_compute():
    problems = record_sequence(CONFIG)[:3]
    expand(problems)
    for qp in problems:
        assert {"P", "p", "_reduced"} <= set(qp.__dict__)


def test_the_study_s_sequence_is_thinned_for_cold_sessions(tmp_path):
    config = CONFIG
    study = Study(config, ["exact", "quadprog"], tmp_path, lambda *_: None)
    found = run_study(study, JOBS)
    warm, cold = found.summary["open_loop_warm"]["exact"], found.summary["open_loop_cold"]["exact"]
    assert (warm["solves"], cold["solves"]) == (40, 4)
    assert warm["verified_solved"] == 40
    assert {"solve_p99_9_us", "timed_solves"} <= set(warm)
    assert "setup_p50_us" in cold
    # without regularization one of them cannot take the problems, and says so
    bare = config.model_copy(update={"scenario": config.scenario.change(control={"regularization": 0.0})})
    study = Study(bare, ["exact", "quadprog"], tmp_path, lambda *_: None)
    found = run_study(study, JOBS)
    assert "regularization" in found.summary["not_run"]["quadprog"]["reason"]
    assert set(found.summary["open_loop_warm"]) == {"exact"}

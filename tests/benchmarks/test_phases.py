"""Phases of a run: the same ticks for all controllers of a trial."""

from typing import Any

import numpy as np
import pytest

from benchmarks.phases import PHASES, with_phases
from moc_opt.study.trials import BASELINE, Run


def made(controller: str, travelling: list[int] | None, trial: str = "t", **more: Any) -> Run:
    """A run of four ticks, whose k-th is in error by 2^k um, or less by its controller."""
    error = 1e-6 * 2.0 ** np.arange(4) * (2.0 if controller == BASELINE else 1.0)
    columns = dict.fromkeys(("t_s", "mu", "tip_error_m", "rcm_error_model_m"), error)
    columns["trocar_force_N"] = np.outer(error, (0.0, 0.6, -0.8))
    flags = {} if travelling is None else {"travelling": np.array(travelling, float)}
    return Run({"trial": trial, "controller": controller, **more}, {**columns, **flags})


def test_phases_are_the_same_ticks_for_all_controllers_of_a_trial() -> None:
    runs = [
        made(BASELINE, None), made("exact", [1, 0, 0, 0]), made("rnn", [0, 0, 1, 0]),
        Run({"trial": "t", "controller": "osqp", "whole": False}),
        made("exact", [0, 0, 0, 0], "other trial"), made("exact", [0, 1, 0, 0], "t", group="other group"),
        made(BASELINE, None, "of DCAC alone"),
    ]  # fmt: skip
    base, exact, rnn, broken, still, grouped, alone = (run.row for run in with_phases(runs))
    for row, scale in ((base, 2.0), (exact, 1.0), (rnn, 1.0)):
        assert (row["travelling_ticks"], row["settled_ticks"]) == (2, 2)
        assert row["travelling_mu_mean"] == pytest.approx(scale * 2.5e-6)  # 1 and 4
        assert row["settled_tip_error_mean_mm"] == pytest.approx(scale * 5e-3)  # 2 and 8
        assert row["settled_rcm_error_model_mean_mm"] == row["settled_tip_error_mean_mm"]
        assert row["settled_trocar_force_mean_N"] == pytest.approx(scale * 5e-6)
    means = ("mu_mean", "tip_error_mean_mm", "rcm_error_model_mean_mm", "trocar_force_mean_N", "ticks")
    assert {*exact} == {"trial", "controller", *(f"{phase}_{name}" for phase in PHASES for name in means)}
    assert broken == runs[3].row
    assert (still["settled_ticks"], "travelling_mu_mean" in still) == (4, False)
    assert grouped["travelling_mu_mean"] == pytest.approx(2e-6)
    assert alone == runs[-1].row
    short = Run(runs[2].row, {name: column[:3] for name, column in runs[2].columns.items()})
    assert with_phases([runs[1], short]) == [runs[1], short], "of different lengths, they share no tick"

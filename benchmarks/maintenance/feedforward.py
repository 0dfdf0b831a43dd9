"""What the acceleration feed-forward does: its torque, and the errors of tip and RCM with and without it.

python -m benchmarks.feedforward [--out DIR] [--trials N] [--seed N] [--json]

MOC with `exact` in the default scenario on random swivels, each trial with a seed of its own, by its own kinematics.
"""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks.common import cli
from benchmarks.common.output import environment
from benchmarks.paper_experiment.trials import seeds
from moc_opt.report.tables import Column, Table
from moc_opt.scenario import Scenario, Setup
from moc_opt.study import each
from moc_opt.study.statistics import mean, relative_changes, spread, too_few
from moc_opt.trace.metrics import summarize
from moc_opt.trace.trace import Trace

STREAM = 10
"""Of the seeds."""
PRESETS = ("default", "tuned")
FIGURES = {"tip": "tip_error_model_mean_mm", "rcm": "rcm_error_model_mean_mm"}
COLUMNS = [
    Column("preset", "preset"), Column("torque_Nm", "torque", unit="Nm"),
    Column("tip_with_mm", "tip, with", unit="mm"), Column("tip_without_mm", "without", unit="mm"),
    Column("tip_without_percent", "change", unit="%"), Column("rcm_with_mm", "RCM, with", unit="mm"),
    Column("rcm_without_mm", "without", unit="mm"), Column("rcm_without_percent", "change", unit="%"),
]  # fmt: skip


def feedforward_torque(trace: Trace, setup: Setup) -> float:
    """Return the mean length of its torque [Nm] over every tenth tick, from the law as docs/method.md has it.

    It is taken at the true state; the controller takes it at what its encoders show.
    """
    robot, lengths = setup.robot, []
    reference = setup.reference.at(trace.t_s)
    for k in range(0, len(trace), 10):
        s = robot.state(trace.q_rad[k], trace.v_rad_per_s[k])
        shaft, u, v = trace.trocar_registered_m[k] - s.tip, s.tool_direction, s.v
        distance, dX, ddX = float(np.linalg.norm(shaft)), s.J_tip @ v, reference[2][k]
        e, closing = shaft / distance, -float(shaft @ dX) / distance  # |r|' with dr = -dX: the trocar is at rest
        turn = (-dX - closing * e) / distance
        pull = -ddX - 2.0 * closing * turn
        wrist = ddX + s.tool_span * ((pull - (e @ pull) * e) / distance - (turn @ turn) * e)
        across = np.linalg.svd(u[None])[2][1:]
        rows = np.vstack([s.J_tip, across @ s.J_wrist])
        wanted = np.concatenate([ddX - s.drift_tip, across @ (wrist - s.drift_wrist)])
        inertia = np.linalg.inv(rows @ np.linalg.solve(s.M, rows.T))
        lengths.append(float(np.linalg.norm(rows.T @ inertia @ wanted)))
    return float(np.mean(lengths))


def run_job(job: tuple[str, int]) -> dict[str, Any]:
    """Return one row: a trial of a preset with and without the feed-forward."""
    preset, seed = job
    base = Scenario(judge=False, bound_samples=0, seed=seed, start={"swivel": "random"})
    base = base.change(control={} if preset == "default" else {"preset": preset})
    row: dict[str, Any] = {"preset": preset, "seed": seed}
    for key, on in (("with", True), ("without", False)):
        setup = Setup(base.change(control={"feedforward": on}))
        trace = setup.trace()
        found = summarize(trace)
        row |= {f"{name}_{key}": found[metric] for name, metric in FIGURES.items()}
        if on:
            row["torque_Nm"] = feedforward_torque(trace, setup)
    return row


def study(given: Namespace) -> cli.Results:
    """Run the trials."""
    seed = given.seed or 0
    drawn = seeds(seed, STREAM, given.trials)
    rows = each(run_job, [(preset, one) for preset in PRESETS for one in drawn])
    summary: dict[str, dict[str, Any]] = {}
    for preset in PRESETS:
        mine = [row for row in rows if row["preset"] == preset]
        summary[preset] = mean([row["torque_Nm"] for row in mine]).entries("torque_Nm")
        for name in FIGURES:
            on, off = ([row[f"{name}_{key}"] for row in mine] for key in ("with", "without"))
            summary[preset] |= mean(on).entries(f"{name}_with_mm") | mean(off).entries(f"{name}_without_mm")
            summary[preset] |= relative_changes(off, on).entries(f"{name}_without_percent")
    shown = [
        {"preset": preset, **{column.key: spread(found, column.key) for column in COLUMNS[1:]}}
        for preset, found in summary.items()
    ]
    about = f"{given.trials} trials; tip and RCM by the robot's own kinematics; 95 % intervals. "
    table = Table("The acceleration feed-forward", COLUMNS, shown, about + (too_few(given.trials) or ""))
    return cli.Results(summary, environment({"trials": given.trials}, seed, given.argv), rows, tables=[table])


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the measurement; see `cli.run` for the exit status."""
    options = cli.parser("feedforward", "What the acceleration feed-forward does.", configured=False)
    options.add_argument("--trials", type=int, default=15)
    options.add_argument("--seed", type=cli.seed_number)
    return cli.run(options, study, arguments)


if __name__ == "__main__":
    sys.exit(main())

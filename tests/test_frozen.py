"""Metrics of runs equal those in frozen.json. ``python -m tests.test_frozen --write`` rewrites it."""

import json
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

import moc_opt as mo

FIGURES = Path(__file__).with_name("frozen.json")

SHAPES: dict[Any, dict[str, Any]] = {
    "waypoints": {"waypoints_m": ((0.0, 0.0, 0.0), (0.02, 0.01, 0.005), (0.03, -0.01, 0.0), (0.05, 0.0, -0.005))},
    "line": {"sizes": {"length": 0.08}},
}
SHORT: dict[str, Any] = {"duration_s": 2.0, "bound_samples": 0, "judge": True}
TASK: dict[str, Any] = {"wait_s": 0.1, "hold_s": 0.1}
ARMS = ("lwr4", "iiwa14", "panda", "gen3", "xarm7", "lwr4_rail")
PATHS = ("circle", "sinusoid", "spiral", "line", "waypoints")
SOLVERS = ("exact", "rnn", "osqp", "nlp-sqp")

VARIANTS: dict[str, dict[str, Any]] = tomllib.loads("""
whole-circle = { task = { path = "circle", sizes.radius = 0.015 } }
whole-line-rnn = { task.path = "line", solver.name = "rnn" }
tuned = { control.preset = "tuned" }
tuned-gen3-osqp = { control.preset = "tuned", robot.name = "gen3", solver.name = "osqp" }
robust = { control.preset = "robust", plant.delay_ticks = 3 }
robust-panda-nlp-sqp = { control.preset = "robust", robot.name = "panda", solver.name = "nlp-sqp" }
paper-rnn = { control.preset = "paper", solver.name = "rnn" }
paper-rnn-printed = { control.preset = "paper", solver.name = "rnn-printed" }
paper-exact = { control.preset = "paper" }
paper-dcac = { control = { preset = "paper", law = "dcac" } }
dcac = { control.law = "dcac", task.path = "spiral" }
static-projector = { control.projector = "static" }
scaled-climb = { control.climb = "scaled" }
receding = { control.third_level = "receding" }
receding-rail = { control.third_level = "receding", robot.name = "lwr4_rail" }
planned = { control.third_level = "planned" }
planned-iiwa14-osqp = { control.third_level = "planned", robot.name = "iiwa14", solver.name = "osqp" }
nominal = { plant.preset = "nominal" }
nominal-panda-osqp = { plant.preset = "nominal", robot.name = "panda", solver.name = "osqp", task.path = "sinusoid" }
nominal-xarm7-rnn = { plant.preset = "nominal", robot.name = "xarm7", solver.name = "rnn" }
nominal-uncompensated = { plant.preset = "nominal", control = { observer_gain_per_s = 0.0, feedforward = false } }
uncompensated = { control = { observer_gain_per_s = 0.0, feedforward = false } }
elastic-joints = { plant = { joint_stiffness_Nm_per_rad = 8000.0, substeps = 9 } }
too-late = { plant.delay_ticks = 6 }
unregularized = { control.regularization = 0.0 }
one-gain-for-all-joints = { control = { K_N2 = 80.0, D_N2 = 1.0 }, plant.delay_ticks = 2 }
random-start = { start = { pose = "random", swivel = "random" }, seed = 4 }
breathing = { trocar = { breathing_amplitude_m = 0.005, breathing_period_s = 2.0 } }
lying-solver = { faults = { solver = "lie", solver_share = 0.2 } }
failing-solver = { faults = { solver = "fail", solver_share = 0.2 } }
pushed-and-loaded = { faults = { bump_N = 20.0, bump_at_s = 0.6, payload_kg = 0.3 } }
trocar-slips = { faults = { slip_m = 0.004, slip_at_s = 0.8 } }
encoders-lost = { faults = { nan_at_s = 0.8, nan_ticks = 1000 } }
encoders-jump = { faults = { jump_at_s = 0.5, jump_rad = 0.2 } }
""")
for name in ("whole-circle", "whole-line-rnn"):
    VARIANTS[name]["duration_s"] = None
for fallback in ("hold", "damping", "least-violation"):
    VARIANTS[f"fast-{fallback}"] = {  # many infeasible subproblems
        "seed": 4, "task": {"v_max_m_per_s": 0.43, "a_max_m_per_s2": 8.0}, "start": {"check_path": False},
        "guard": {"rcm_error_m": 0.012}, "control": {"fallback": fallback},
    }  # fmt: skip


def scenarios() -> dict[str, mo.Scenario]:
    tables: dict[str, dict[str, Any]] = {}
    for a, arm in enumerate(ARMS):
        for s, solver in enumerate(SOLVERS):
            path = PATHS[(a + s) % len(PATHS)]
            tables[f"{arm}-{path}-{solver}"] = {
                "robot": {"name": arm}, "task": {"path": path}, "solver": {"name": solver}, "seed": a + s,
            }  # fmt: skip
    found = {}
    for name, table in (tables | VARIANTS).items():
        task = TASK | table.get("task", {})
        task |= SHAPES.get(task.get("path"), {})
        found[name] = mo.Scenario(**(SHORT | table | {"task": task, "name": name}))
    return found


SCENARIOS = scenarios()
METRICS = (
    "mu_mean", "mu_final", "tip_error_model_mean_mm", "tip_error_registered_mean_mm", "rcm_error_model_mean_mm",
    "rcm_error_mean_mm", "trocar_force_mean_N", "torque_rate_rms_Nm_per_s", "claimed_solved", "verified_solved",
    "silently_wrong",
)  # fmt: skip


def run(scenario: mo.Scenario) -> dict[str, Any]:
    trace = mo.run(scenario)
    metrics = mo.summarize(trace)
    ended = str(trace.meta["ended"]).partition(":")[0]
    return {"ended": ended, "ticks": len(trace)} | {name: metrics[name] for name in METRICS if name in metrics}


def tolerance(metric: str, figure: float, ticks: int) -> float:
    if metric in ("silently_wrong", "ticks"):
        return 2.0
    if metric.startswith("mu_"):
        return 0.01 * figure
    if metric.endswith("_solved"):
        return 0.01 * ticks
    floor = {"mm": 0.001, "N": 0.01, "s": 1.0}[metric.rsplit("_", 1)[1]]
    return max(0.15 * figure, floor)


FROZEN: dict[str, Any] = json.loads(FIGURES.read_text(encoding="utf-8"))["runs"]


def test_every_scenario_has_a_frozen_run() -> None:
    assert set(FROZEN) == set(SCENARIOS)


@pytest.mark.parametrize("name", SCENARIOS)
def test_run_has_its_frozen_figures(name: str) -> None:
    was, now = FROZEN[name], run(SCENARIOS[name])
    assert set(now) == set(was)
    ended = now.pop("ended")
    assert ended == was["ended"], f"{name}: ended: frozen {was['ended']}, found {ended}"
    moved = [
        f"{metric}: frozen {was[metric]:.5g}, found {figure:.5g}"
        for metric, figure in now.items()
        if not abs(figure - was[metric]) <= tolerance(metric, was[metric], was["ticks"])
    ]
    assert not moved, f"{name}: " + "; ".join(moved)


def write() -> None:
    runs = {name: run(scenario) for name, scenario in SCENARIOS.items()}
    for figures in runs.values():
        figures.update({name: float(f"{figure:.6g}") for name, figure in figures.items() if isinstance(figure, float)})
    FIGURES.write_text(json.dumps({"runs": runs}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    if sys.argv[1:] != ["--write"]:
        sys.exit("usage: python -m tests.test_frozen --write")
    write()

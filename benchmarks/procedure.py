"""The operative procedure: a hand guides the tip to the incision, the camera finds the board, the arm does the task."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from pydantic import Field
from scipy.spatial import cKDTree

from moc_opt.arrays import Array
from moc_opt.control import Controller
from moc_opt.errors import TaskError
from moc_opt.inputs.settings import Settings
from moc_opt.planning.self_motion import self_motion
from moc_opt.robots.inverse_kinematics import pose_through
from moc_opt.scenario import Scenario, isolated, make_safety_filter, make_solver, make_stop
from moc_opt.scenario.preflight import check_reachable
from moc_opt.sim.loop import simulate
from moc_opt.sim.plant import Plant
from moc_opt.tasks import Path as TipPath
from moc_opt.tasks import Reference, Trocar
from moc_opt.tasks.timelaw import WaitingReference, flags_at
from moc_opt.trace.metrics import summarize
from moc_opt.trace.oscillation import judged_for_oscillation
from moc_opt.trace.trace import Trace
from moc_opt.vision.augmented_reality import Augmented
from moc_opt.vision.board import Board, board_below, board_task
from moc_opt.vision.camera import CameraSettings
from moc_opt.vision.hands_on import HandsOnSettings, HandsOnStatus, guide_to
from moc_opt.vision.tracking import TrackerSettings

METRICS = ("mu_mean", "tip_error_mean_mm", "rcm_error_mean_mm", "trocar_force_mean_N")


class ProcedureSettings(Settings):
    KIND: ClassVar[str] = "[procedure]"
    hands_on: HandsOnSettings = HandsOnSettings()
    camera: CameraSettings = CameraSettings()
    board: Board = Board()
    tracker: TrackerSettings = TrackerSettings()
    film: bool = Field(True, description="save what the surgeon sees during the first task")


def perform(parts: ProcedureSettings, scenario: Scenario, name: str, film: Path | None = None) -> dict[str, Any]:
    task = board_task(name)
    robot = scenario.robot.arm()
    home = robot.state(robot.data.q_home)
    hand_seed, plant_seed, swivel_seed, eye_seed = np.random.SeedSequence(scenario.seed).generate_state(4).tolist()
    # Guiding by hand already causes a registration error. The plant adds none.
    plant = Plant(robot.data, scenario.plant.model_copy(update={"trocar_registration_error_m": 0.0}), seed=plant_seed)
    incision = home.tip - task.depth_m * home.tool_direction
    guided = guide_to(incision, plant, robot, parts.hands_on, seed=hand_seed)
    if guided.registered is None:
        raise TaskError(f"hands-on: {guided.status.value}")

    phantom = board_below(incision, home.tool_direction, task.depth_m)
    scene = Augmented(robot, phantom, camera=parts.camera, board=parts.board, tracker=parts.tracker, seed=eye_seed)
    estimate = scene.locate(guided.q)
    path = scene.board.task_in_base(task, estimate)
    q = pose_through(robot, path.start, guided.registered)
    q = self_motion(robot, q).at(np.random.default_rng(swivel_seed).uniform(0.05, 0.95, 1))[0]
    trace, waited, lost = _run(scenario, plant, scene, path, q, (guided.trocar, guided.registered))
    count = scene.film(film, trace, path, guided.registered) if film is not None else 0
    deviation = 1e3 * from_path(trace.tip_m, scene.board.task_in_base(task, phantom))  # from the task on the true board
    metrics = summarize(trace)
    return {
        "ended": trace.meta["ended"], "share_of_run": metrics["share_of_run"],
        "registered": guided.status is HandsOnStatus.REGISTERED, "registration_error_mm": 1e3 * guided.error_m,
        "guiding_s": float(guided.trace.t_s[-1]),
        "hand_force_max_N": float(np.linalg.norm(guided.trace.hand_force_N, axis=1).max()),
        **scene.accuracy(estimate, task),
        "waited_s": waited, "lost_s": lost, "pictures": count,
        **{name: metrics[name] for name in METRICS},
        "path_deviation_mean_mm": float(deviation.mean()), "path_deviation_max_mm": float(deviation.max()),
    }  # fmt: skip


def _run(
    scenario: Scenario, plant: Plant, scene: Augmented, path: TipPath, q: Array, trocars: tuple[Array, Array]
) -> tuple[Trace, float, float]:
    """Return (trace, waiting time [s], time in which the board is not seen [s])."""
    period, (true, registered) = scenario.plant.period_s, trocars
    robot, task = scenario.robot.arm(), scenario.task
    reference = Reference(path, task.v_max_m_per_s, task.a_max_m_per_s2, t_start=task.wait_s)
    check_reachable(robot, q, reference, Trocar(registered))
    waiting = WaitingReference(reference, period)
    lost = sum(end - begin for begin, end in scene.board.lost_s)
    settling = 2.0 * waiting.settle_s * (1 + len(scene.board.lost_s))
    seconds = reference.t_start + reference.duration + lost + settling + task.hold_s
    times = period * np.arange(round(seconds / period))
    # The tool is drawn in its first pose, because later poses are not known yet.
    looked_at, seen = scene.watch(seconds, q)
    rows, played = waiting.play(flags_at(times, looked_at, seen))
    last = int(np.searchsorted(played, reference.t_start + reference.duration))
    ticks = min(len(times), last + round(task.hold_s / period))
    solver = isolated(make_solver(scenario.solver.name, robot, **scenario.solver.settings), scenario)
    plant.reset(q)
    still = np.zeros(3)
    trace = simulate(
        plant, Controller(robot, scenario.control, solver, period), rows[:ticks],
        np.tile(np.stack([true, still]), (ticks, 1, 1)), np.tile(np.stack([registered, still]), (ticks, 1, 1)),
        safety_filter=make_safety_filter(robot, scenario), stop=make_stop(scenario),
    )  # fmt: skip
    mu = np.array([robot.state(pose).mu for pose in trace.q_rad])
    waited = float(times[min(last, len(times) - 1)] - (reference.t_start + reference.duration))
    trace = judged_for_oscillation(trace.with_columns(mu=mu), robot.data.joint_names, robot.chain.prismatic)
    return trace, waited, float(np.mean(~seen) * seconds)


def from_path(points: Array, path: TipPath, samples: int = 4000) -> Array:
    """Return the distance (k,) [m] of each point (k, 3) from the path."""
    line = path.at(np.linspace(0.0, path.length, samples))[0]
    found: Array = cKDTree(line).query(points)[0]
    return found

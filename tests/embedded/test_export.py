"""The generated C tick: the same numbers as the Python one, refused where it would not be, readable, cached."""

from __future__ import annotations

import os
import shutil
import subprocess
import tomllib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from moc_opt import solvers
from moc_opt.control import Controller, ControlSettings
from moc_opt.control.presets import PAPER
from moc_opt.control.safety_filter import SafetyFilterSettings
from moc_opt.control.supervisor import SupervisorSettings
from moc_opt.embedded import (
    CompilerError,
    NativeController,
    Recording,
    TickSpec,
    dynamics,
    export,
    record,
    swivel,
)
from moc_opt.embedded.arm import Arm
from moc_opt.embedded.compiler import FLAGS, cache_directory, compile_library
from moc_opt.embedded.layout import layout
from moc_opt.embedded.support import GUARDED, OBEYED, OF_A_COURSE, SUPERVISED, check_safety_filter
from moc_opt.embedded.symbolic import build_tick
from moc_opt.errors import ControlError, RobotError
from moc_opt.model.robot_model import RobotModel
from moc_opt.qp.problem import compute_residuals
from moc_opt.scenario import Scenario, Setup
from moc_opt.scenario.adapter import ControllerAdapter
from moc_opt.sim.loop import LoggedController, simulate
from moc_opt.solvers.base import Solver, Status
from moc_opt.solvers.exact.elimination import EMPTY, OK, STUCK
from moc_opt.solvers.exact.solver import Exact
from moc_opt.trace.trace import Trace

Array = NDArray[np.float64]
Draw = Callable[..., list[Array]]
PERIOD = 0.002

needs_compiler = pytest.mark.skipif(
    not any(map(shutil.which, ("cc", "gcc", "clang"))), reason="no C compiler (cc, gcc, clang) on the path"
)

LAWS: dict[str, dict[str, Any]] = {
    "moc": {},
    "dcac": {"law": "dcac"},
    "dcac-damped": {"law": "dcac", "dcac_damping": [3.0, 5.0, 2.0, 1.0, 0.5, 0.0, 0.2], "projector": "printed"},
    "paper": {**PAPER, "limit_torque": False},
    "all-else": {
        "projector": "static", "feedforward": True, "fallback": "hold", "speed_fraction": 0.2, "ramp_s": 0.01,
        "limit_margin_rad": 0.4,
        "regularization": 1e-4, "c2": 0.002, "K_N2": [20.0, 30.0, 15.0, 8.0, 5.0, 4.0, 3.0],
    },
}  # fmt: skip


@pytest.fixture(scope="module", autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Libraries of this test run only, compiled once."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield


def solver_of(control: ControlSettings) -> Solver | None:
    return Exact() if control.law == "moc" else None


def seeded_ticks(robot: RobotModel, poses: list[Array], seed: int = 0) -> Recording:
    """Independent ticks near each pose: tip off its reference, trocar off the shaft, all moving; tau is empty."""
    rng = np.random.default_rng(seed)
    q, v = np.array(poses), rng.normal(scale=0.3, size=(len(poses), robot.n))
    tip_ref, trocar = np.empty((len(poses), 3, 3)), np.empty((len(poses), 2, 3))
    for k, pose in enumerate(poses):
        state = robot.state(pose)
        tip_ref[k] = rng.normal(size=(3, 3)) * [[2e-3], [0.05], [0.1]]
        tip_ref[k, 0] += state.tip
        trocar[k] = rng.normal(size=(2, 3)) * [[2e-3], [2e-3]]
        trocar[k, 0] += state.tip - rng.uniform(0.08, 0.2) * state.tool_direction
    return Recording(q, v, tip_ref, trocar, np.empty((len(poses), 0)))


# ---- equations, before any compiler -------------------------------------------------------------------


@pytest.mark.parametrize("arm", ["robot", "odd_robot"])
def test_dynamics_are_those_of_the_model(arm: str, request: pytest.FixtureRequest) -> None:
    robot: RobotModel = request.getfixturevalue(arm)
    q, v = ca.SX.sym("q", robot.n), ca.SX.sym("v", robot.n)
    numbers = Arm.of(robot)
    frames = dynamics.joint_frames(numbers, q)
    at = dynamics.points(numbers, frames)
    outputs = {
        "tip": at.tip, "wrist": at.wrist, "J_tip": at.J_tip, "J_wrist": at.J_wrist,
        "h": dynamics.bias_torque(numbers, frames, v), "drift_tip": dynamics.drift(at, at.J_tip, v),
        **dict(zip(("mu", "grad_mu"), dynamics.manipulability(at), strict=True)),
        **dict(zip(("mu_shaft", "grad_mu_shaft"), dynamics.shaft_manipulability(at), strict=True)),
        **dict(zip(("M", "gravity"), dynamics.inertia_and_gravity(numbers, frames), strict=True)),
        **dict(zip(("momentum", "energy_slope"), dynamics.momentum(numbers, frames, v), strict=True)),
    }  # fmt: skip
    function = ca.Function("terms", [q, v], list(outputs.values()), ["q", "v"], list(outputs))
    rng = np.random.default_rng(3)
    for _ in range(20):
        pose, speed = rng.uniform(robot.q_min, robot.q_max), rng.normal(size=robot.n)
        state = robot.state(pose, speed)
        known = {
            "gravity": robot.gravity(pose),
            "momentum": state.M @ speed,
            "energy_slope": robot.coriolis(pose, speed).T @ speed,
        }
        for name, value in function(q=pose, v=speed).items():
            expected = np.asarray(known.get(name, getattr(state, name, None)), dtype=float)
            got = np.array(value).reshape(expected.shape)
            np.testing.assert_allclose(got, expected, rtol=1e-10, atol=1e-11, err_msg=name)


def test_gradient_is_zero_where_mu_is(robot: RobotModel) -> None:
    q = ca.SX.sym("q", robot.n)
    numbers = Arm.of(robot)
    mu, grad = dynamics.manipulability(dynamics.points(numbers, dynamics.joint_frames(numbers, q)))
    found = ca.Function("mu", [q], [mu, grad])(np.zeros(robot.n))  # stretched out: singular
    assert float(found[0]) == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_array_equal(np.array(found[1]).ravel(), np.zeros(robot.n))


@pytest.fixture(scope="module")
def swivel_function() -> Any:
    """The branch-free solver on bare numbers: (A, b, gradient, lower, upper) -> (x, dual, status, z), rho = 1e-5."""
    A, b, g = ca.SX.sym("A", 5, 6), ca.SX.sym("b", 5), ca.SX.sym("g", 6)
    lower, upper = ca.SX.sym("l", 6), ca.SX.sym("u", 6)
    triangle = swivel.triangulate(A)
    z = swivel.null_vector(triangle)
    box, weights = swivel.Box(lower, upper), {"c2": 1e-3, "rho": 1e-5, "tolerance": 1e-9}
    found = swivel.solve(triangle, z, b, g, box, list(range(6)), **weights)
    return ca.Function("swivel", [A, b, g, lower, upper], [*found, z])


@settings(max_examples=200)
@given(seed=st.integers(0, 2**32 - 1), scale=st.floats(-3, 3), tight=st.floats(0.01, 2.0))
def test_swivel_answers_satisfy_the_optimality_conditions(
    swivel_function: Any, seed: int, scale: float, tight: float
) -> None:
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(5, 6)) * 10.0**scale
    g, width = rng.normal(size=6), tight * rng.uniform(0.5, 1.5, 6)
    b = A @ rng.uniform(-width, width) * rng.choice([1.0, 1.0, 3.0])
    x, dual, status, z = (np.array(part).ravel() for part in swivel_function(A, b, g, -width, width))
    norm = np.linalg.norm(A)
    np.testing.assert_allclose(A @ z, 0.0, atol=1e-13 * norm)
    assert np.linalg.norm(z) == pytest.approx(1.0, abs=1e-13)
    if status[0] == EMPTY:
        # Farkas: no point of the line x0 + w z is in the box
        x0 = np.linalg.lstsq(A, b, rcond=None)[0]
        ends = np.sort([(-width - x0) / z, (width - x0) / z], axis=0)
        assert ends[0].max() > ends[1].min()
        return
    assert status[0] == OK
    condition = np.linalg.cond(A)
    np.testing.assert_allclose(A @ x, b, atol=1e-13 * norm * condition)
    assert (np.abs(x) <= width).all()
    force = 1e-5 * x - 1e-3 * g + A.T @ dual
    natural = x - np.clip(x - force, -width, width)
    np.testing.assert_allclose(natural, 0.0, atol=1e-14 * condition)


def test_swivel_says_when_rows_repeat(swivel_function: Any) -> None:
    A = np.random.default_rng(0).normal(size=(5, 6))
    A[4] = A[3]
    x, _, status, z = swivel_function(A, A @ np.full(6, 0.1), np.ones(6), -np.ones(6), np.ones(6))
    assert int(status) == STUCK
    np.testing.assert_array_equal(np.array(x), 0.0)
    np.testing.assert_allclose(A @ np.array(z), 0.0, atol=1e-13)


# ---- refusals -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "solver", "words"),
    [
        ({}, None, r"\[solver\] name = None"),
        ({}, "rnn", r"\[solver\] name = 'rnn'.*'exact' only"),
        ({"law": "dcac"}, "exact", "'dcac' takes no solver"),
        ({"observer_gain_per_s": 600.0}, "exact", r"observer_gain_per_s = 600.0.*below 500"),
    ],
)  # fmt: skip
def test_settings_that_c_cannot_do_are_refused(
    robot: RobotModel, changes: dict[str, Any], solver: str | None, words: str
) -> None:
    made = None if solver is None else solvers.create(solver)
    with pytest.raises(ControlError, match=words):
        build_tick(TickSpec(robot, ControlSettings(**changes), made, PERIOD))


def test_an_arm_with_two_freedoms_is_refused_where_the_null_space_is_used(odd_robot: RobotModel) -> None:
    gains = dict.fromkeys(("K_X", "D_X", "K_N", "D_N", "K_N2", "D_N2"), 10.0)
    robot = RobotModel(replace(odd_robot.data, gains={"default": gains}))
    for control in (ControlSettings(), ControlSettings(law="dcac", dcac_damping=1.0)):
        with pytest.raises(ControlError, match=r"\[robot\] name = 'odd': 7 joints"):
            build_tick(TickSpec(robot, control, solver_of(control), PERIOD))
    assert build_tick(TickSpec(robot, ControlSettings(law="dcac"), None, PERIOD)).n == 7


def test_every_control_setting_is_either_obeyed_or_refused(robot: RobotModel) -> None:
    refused = {"third_level", "climb", *OF_A_COURSE}  # below
    unknown = set(ControlSettings.model_fields) - OBEYED - refused
    assert not unknown, f"teach moc_opt.embedded about {unknown}, or refuse it in support.py and say so here"

    class Later(ControlSettings):
        sharpness: float = 0.0

    build_tick(TickSpec(robot, Later(), Exact(), PERIOD))
    with pytest.raises(ControlError, match=r"third_level = 'planned' is not known"):
        build_tick(TickSpec(robot, ControlSettings(third_level="planned"), Exact(), PERIOD))
    with pytest.raises(ControlError, match=r"climb = 'scaled' is not known"):
        build_tick(TickSpec(robot, ControlSettings(climb="scaled"), Exact(), PERIOD))
    unread = [
        ControlSettings(law="dcac", climb="scaled", horizon_s=0.5, replan_per_s=40.0),
        ControlSettings(horizon_s=0.5, replan_per_s=40.0),  # of third_level 'receding' alone
        ControlSettings(course_speed_fraction=0.5, course_margin_rad=0.2, course_observer_gain_per_s=30.0),
    ]
    for control in unread:  # what is never read is no reason to refuse
        build_tick(TickSpec(robot, control, None if control.law == "dcac" else Exact(), PERIOD))
    with pytest.raises(ControlError, match=r"sharpness = 2.0 is not known"):
        build_tick(TickSpec(robot, Later(sharpness=2.0), Exact(), PERIOD))


def test_every_setting_of_guard_and_supervisor_is_either_obeyed_or_refused() -> None:
    for known, kind in ((GUARDED, SafetyFilterSettings), (SUPERVISED, SupervisorSettings)):
        unknown = set(kind.model_fields) ^ known
        assert not unknown, f"teach moc_opt/embedded/c about {unknown}, or refuse it in support.py and say so here"

    class Later(SafetyFilterSettings):
        softness: float = 0.0

    check_safety_filter(Later())
    with pytest.raises(ControlError, match=r"\[guard\] softness = 2.0 is not known.*leave it out"):
        check_safety_filter(Later(softness=2.0))


# ---- compiled ------------------------------------------------------------------------------------------


@needs_compiler
@pytest.mark.parametrize("law", LAWS)
def test_c_equals_python_on_seeded_states(robot: RobotModel, regular_poses: Draw, law: str) -> None:
    control = ControlSettings(**LAWS[law])
    ticks = seeded_ticks(robot, regular_poses(60, seed=5))
    python = Controller(robot, control, solver_of(control), PERIOD)
    native = NativeController(robot, control, solver_of(control), PERIOD)
    python.start(robot.state(ticks.q[0], ticks.v[0]), ticks.tip_ref[0], ticks.trocar[0])
    native.start(ticks.q[0], ticks.v[0], ticks.tip_ref[0], ticks.trocar[0])
    seen = set()
    for q, v, tip_ref, trocar in zip(*ticks[:4], strict=True):
        state = robot.state(q, v)
        expected, got = python.tick(state, tip_ref, trocar), native.tick(q, v, tip_ref, trocar)
        np.testing.assert_allclose(got, expected, rtol=1e-11, atol=1e-10)
        shown = native.state  # what the safety filter takes of it
        for part in ("q", "v", "tip", "wrist", "M", "h", "energy_slope", "gravity", "grad_mu"):
            np.testing.assert_allclose(getattr(shown, part), getattr(state, part), atol=1e-9, err_msg=part)
        terms = native.terms()
        for name in ("mu", "grad_mu", "M", "h", "tip", "wrist"):
            np.testing.assert_allclose(
                terms[name], getattr(state, name), rtol=1e-11, atol=1e-10, err_msg=name
            )
        np.testing.assert_allclose(native.external_torque, python.external_torque, atol=1e-9)
        if control.law == "dcac":
            assert native.status is None
            continue
        assert python.solution is not None
        assert python.subproblem is not None
        assert native.status is python.solution.status
        seen.add(native.status)
        np.testing.assert_allclose(native.answer, python.answer, atol=1e-10)
        np.testing.assert_allclose(terms["subproblem"], python.subproblem.row, atol=1e-10)
        if native.status is Status.SOLVED:  # the multipliers are not unique, what they do is
            assert python.solution.y is not None
            difference = python.subproblem.A.T @ (terms["dual"] - python.solution.y)
            np.testing.assert_allclose(difference, 0.0, atol=1e-10)
    assert control.law == "dcac" or seen == {Status.SOLVED, Status.INFEASIBLE}


def loop(setup: Setup, brain: LoggedController) -> Trace:
    t = setup.times()
    references = (setup.reference.at(t), setup.trocar.at(t), setup.registered.at(t))
    return simulate(setup.plant, brain, *(np.stack(parts, axis=1) for parts in references))


@needs_compiler
@pytest.mark.parametrize(
    ("plant", "law"),
    [
        ({"preset": "nominal"}, "moc"),
        ({"preset": "nominal"}, "dcac"),
        # An encoder's steps hide small differences from the feedback, and gravity lets them grow by e every
        # quarter of a second; without them two ways of rounding stay together (to some 1e-11 over eight seconds).
        ({"preset": "realistic", "encoder_resolution_rad": 0.0}, "moc"),
        ({"preset": "realistic", "encoder_resolution_rad": 0.0}, "all-else"),
    ],
)
def test_a_whole_run_leaves_the_same_trace(plant: dict[str, Any], law: str) -> None:
    scenario = Scenario(plant=plant, control=LAWS[law], judge=False, bound_samples=0)
    setups = [Setup(scenario) for _ in range(2)]
    python = loop(setups[0], ControllerAdapter(setups[0].controller()))
    control = scenario.control
    brain = NativeController(setups[1].robot, control, solver_of(control), scenario.plant.period_s)
    native = loop(setups[1], brain)
    assert len(native) == len(python) > 4000
    assert set(native.columns) == set(python.columns)
    for name in {"status", "fault"} & set(native.columns):
        np.testing.assert_array_equal(native.columns[name], python.columns[name])
    for name in set(native.columns) - {"status", "fault", "tick_us", "solve_us", "dual"}:
        difference = np.abs(native.columns[name] - python.columns[name])
        assert np.array_equal(np.isnan(native.columns[name]), np.isnan(python.columns[name])), name
        assert np.nanmax(difference) <= 1e-9, name


@needs_compiler
def test_the_trace_has_no_answer_where_there_was_none(robot: RobotModel, regular_poses: Draw) -> None:
    ticks = seeded_ticks(robot, regular_poses(60, seed=5))
    native = NativeController(robot, ControlSettings(**LAWS["paper"]), Exact(), PERIOD)
    native.start(*(part[0] for part in ticks[:4]))
    columns = native.columns(60)
    for k in range(60):
        native.tick(*(part[k] for part in ticks[:4]))
        native.note(k, columns)
    none = columns["status"] == "infeasible"
    assert 0 < none.sum() < 60
    np.testing.assert_array_equal(columns["applied_x_rad_per_s"][none], 0.0)
    for name in ("x_rad_per_s", "dual"):
        np.testing.assert_array_equal(np.isnan(columns[name]).all(axis=1), none)
    judged = compute_residuals(columns["subproblem"], columns["x_rad_per_s"], columns["dual"])
    np.testing.assert_array_equal(judged.verified(), ~none)


@needs_compiler
def test_bad_input_is_named_and_leaves_the_state_alone(robot: RobotModel, regular_poses: Draw) -> None:
    ticks = seeded_ticks(robot, regular_poses(2))
    native = NativeController(robot, ControlSettings(), Exact(), PERIOD)
    q, v, tip_ref, trocar = (part[0] for part in ticks[:4])
    with pytest.raises(ControlError, match="tick before start"):
        native.tick(q, v, tip_ref, trocar)
    with pytest.raises(RobotError, match=r"v = .* is not finite"):
        native.start(q, v * np.nan, tip_ref, trocar)
    native.start(q, v, tip_ref, trocar)
    first = native.tick(q, v, tip_ref, trocar)
    before = native.external_torque
    for name in ("q", "v", "tip_ref", "trocar"):
        given = {"q": q, "v": v, "tip_ref": tip_ref, "trocar": trocar}
        given[name] = given[name].copy()
        given[name].flat[1] = np.inf
        with pytest.raises((RobotError, ControlError), match=f"^{name} = .* is not finite"):
            native.tick(**given)
    with pytest.raises(ControlError, match="not finite: the tip is in a singular pose"):
        native.tick(q, v, tip_ref, np.vstack([native.terms()["tip"], np.zeros(3)]))  # the trocar at the tip
    with pytest.raises(ControlError, match=r"tip_ref has shape \(3,\)"):
        native.tick(q, v, tip_ref[0], trocar)
    np.testing.assert_array_equal(native.external_torque, before)
    native.start(q, v, tip_ref, trocar)
    np.testing.assert_array_equal(native.tick(q, v, tip_ref, trocar), first)


@needs_compiler
def test_a_straight_elbow_falls_back_with_a_finite_torque(robot: RobotModel) -> None:
    q = np.array([0.3, 0.6, 0.2, 0.0, 0.4, 0.9, 0.0])  # the wrist cannot move along the stretched arm
    ticks = seeded_ticks(robot, [q])
    native = NativeController(robot, ControlSettings(), Exact(), PERIOD)
    native.start(q, np.zeros(robot.n), ticks.tip_ref[0], ticks.trocar[0])
    tau = native.tick(q, np.zeros(robot.n), ticks.tip_ref[0], ticks.trocar[0])
    assert native.status is Status.NUMERICAL
    assert np.isfinite(tau).all()
    np.testing.assert_array_equal(native.answer, np.zeros(robot.n))


# ---- the files -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def exported(robot: RobotModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The default law on 20 ticks of a slow drift away from home."""
    rng = np.random.default_rng(1)
    ticks = seeded_ticks(robot, [robot.data.q_home] * 20)
    v = np.tile(rng.normal(scale=0.1, size=robot.n), (20, 1))
    q = robot.data.q_home + PERIOD * np.cumsum(v, axis=0)
    recording = record(TickSpec(robot, ControlSettings(), Exact(), PERIOD), q, v, ticks.tip_ref, ticks.trocar)
    out = tmp_path_factory.mktemp("exported")
    written = export(TickSpec(robot, ControlSettings(), Exact(), PERIOD), recording, out)
    assert sorted(path.name for path in written) == sorted(path.name for path in out.iterdir())
    return out


def test_the_header_tells_all(exported: Path) -> None:
    header = (exported / "moc_tick.h").read_text()
    for fields in layout(7, "moc", 2):
        for field in fields:
            assert f"{field.name}{f'[{field.length}]' if field.shape else ''}" in header
            assert field.meaning in header
    for words in (
        "K_X = 3000.0",
        "rotor inertia",
        "lwr4",
        "period [s] = 0.002",
        "MOC_TICK_BAD_INPUT",
        "[Nm]",
    ):
        assert words in header
    assert "backend" not in header


def test_every_file_in_c_says_its_licence(exported: Path) -> None:
    project = tomllib.loads((Path(__file__).resolve().parents[2] / "pyproject.toml").read_text("utf-8"))["project"]
    files = [file for file in exported.iterdir() if file.suffix in (".c", ".h")]
    assert len(files) > 10
    for file in files:
        assert file.read_text("utf-8").startswith(f"/* SPDX-License-Identifier: {project['license']} */\n"), file.name


def test_the_same_law_gives_the_same_text(exported: Path, robot: RobotModel, tmp_path: Path) -> None:
    recording = Recording(*(np.zeros((1, *shape)) for shape in ((7,), (7,), (3, 3), (2, 3), (7,))))
    export(TickSpec(robot, ControlSettings(), Exact(), PERIOD), recording, tmp_path)
    for name in ("moc_tick.c", "moc_tick.h", "moc_arm.c", "moc_constants.c", "main.c", "Makefile"):
        assert (tmp_path / name).read_text() == (exported / name).read_text()
    with pytest.raises(ControlError, match="cannot be written"):
        export(TickSpec(robot, ControlSettings(), Exact(), PERIOD), recording, tmp_path / "Makefile")


@needs_compiler
def test_the_self_test_compiles_without_a_warning_runs_and_can_fail(exported: Path, tmp_path: Path) -> None:
    def build_and_run(folder: Path) -> subprocess.CompletedProcess[str]:
        subprocess.run(["make", "clean"], cwd=folder, check=True, capture_output=True)
        flags = f"CFLAGS={' '.join(FLAGS)} -Werror"
        return subprocess.run(
            ["make", "test", flags], cwd=folder, capture_output=True, text=True, timeout=120
        )

    exported = Path(shutil.copytree(exported, tmp_path / "right"))
    done = build_and_run(exported)
    assert done.returncode == 0, done.stdout
    assert "one tick: mean" in done.stdout
    assert "20 ticks, 0 with fallback" in done.stdout

    wrong = Path(shutil.copytree(exported, tmp_path / "wrong"))
    table = (wrong / "recording.h").read_text()
    last = table.rstrip().removesuffix("}\n};").split(", ")[-1]
    (wrong / "recording.h").write_text(table.replace(last, repr(float(last) + 1e-6)))
    failed = build_and_run(wrong)
    assert failed.returncode != 0
    assert "largest difference" in failed.stdout, failed.stderr


# ---- compiler and cache --------------------------------------------------------------------------------

TINY = {"tiny.c": "int tiny(void) { return 7; }\n"}


@needs_compiler
def test_a_library_is_compiled_once_per_content(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    first = compile_library(TINY)
    made = first.stat().st_mtime_ns
    assert first.parent == tmp_path / "moc_opt" == cache_directory()
    assert compile_library(TINY) == first
    assert first.stat().st_mtime_ns == made
    assert compile_library({"tiny.c": TINY["tiny.c"].replace("7", "8")}) != first
    assert all(path.suffix == ".so" for path in first.parent.iterdir()), "scratch left behind"


@needs_compiler
def test_many_may_compile_the_same_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    with ThreadPoolExecutor(4) as pool:
        assert len(set(pool.map(compile_library, [TINY] * 4))) == 1
    assert len(list((tmp_path / "moc_opt").iterdir())) == 1


@needs_compiler
def test_a_failed_compilation_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    with pytest.raises(CompilerError, match=r"failed:\n(?s:.*)error"):
        compile_library({"tiny.c": "int tiny(void) { return nothing; }\n"})
    assert list((tmp_path / "moc_opt").iterdir()) == []


def test_no_compiler_is_said(robot: RobotModel, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "no-such-compiler -m64")
    with pytest.raises(CompilerError, match="CC = 'no-such-compiler -m64' is not on the path"):
        NativeController(robot, ControlSettings(law="dcac"), None, PERIOD)
    monkeypatch.delenv("CC")
    monkeypatch.setenv("PATH", "")
    with pytest.raises(CompilerError, match="neither cc, gcc nor clang"):
        NativeController(robot, ControlSettings(law="dcac"), None, PERIOD)


def test_a_relative_cache_home_is_ignored(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", "here" + os.sep)
    assert cache_directory() == Path.home() / ".cache" / "moc_opt"

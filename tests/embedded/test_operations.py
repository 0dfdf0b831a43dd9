"""The stated number of operations: no step does more, counted by doubles that count."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from moc_opt.control import ControlSettings
from moc_opt.embedded import TickSpec, guarded, operations
from moc_opt.embedded.guarded import GuardedController
from moc_opt.embedded.symbolic import build_tick
from moc_opt.model.robot_model import RobotModel
from moc_opt.solvers.exact.solver import Exact

Array = NDArray[np.float64]
COUNTED = Path(__file__).with_name("counted.h")

pytestmark = pytest.mark.skipif(shutil.which("g++") is None, reason="no C++ compiler (g++) on the path")


@pytest.fixture(scope="module")
def counting(robot: RobotModel, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The controller compiled with doubles that count: a function settings -> (controller, library)."""

    def build(texts: Mapping[str, str]) -> Path:
        folder = tmp_path_factory.mktemp("counted")
        for name, text in texts.items():
            (folder / name).write_text(text)
        sources = []
        for name in texts:
            if name.endswith(".c"):
                wrapped = folder / f"{name}pp"
                wrapped.write_text(f'#include "{COUNTED}"\nextern "C" {{\n#include "{name}"\n}}\n')
                sources.append(str(wrapped))
        (folder / "counter.cpp").write_text("unsigned long operations = 0;\n")
        library = folder / "counted.so"
        subprocess.run(
            ["g++", "-std=c++20", "-O0", "-w", "-fpermissive", "-ffp-contract=off", "-shared", "-fPIC", *sources,
             str(folder / "counter.cpp"), "-o", str(library)],
            check=True,
        )  # fmt: skip
        return library

    @cache
    def make(control: ControlSettings) -> tuple[GuardedController, ctypes.CDLL]:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(guarded, "compile_library", build)
            made = GuardedController(robot, control, Exact() if control.law == "moc" else None)
        return made, made.library

    return make


def counter(library: ctypes.CDLL) -> ctypes.c_ulong:
    return ctypes.c_ulong.in_dll(library, "operations")


@pytest.mark.parametrize(
    "control",
    [{}, {"fallback": "damping"}, {"fallback": "hold", "supervisor": {"hold_ticks": 0}},
     {"law": "dcac", "dcac_damping": 3.0}],
    ids=["default", "damping", "hold", "dcac"],
)  # fmt: skip
def test_no_step_does_more_than_is_stated(
    counting: Callable[..., Any], robot: RobotModel, control: dict[str, Any]
) -> None:
    settings = ControlSettings(**control)
    controller, library = counting(settings)
    tick = build_tick(TickSpec(robot, settings, Exact() if settings.law == "moc" else None, 0.002))
    stated, rng, most, least = operations.worst_path(tick)["in all"], np.random.default_rng(0), 0, 10**9
    count, faults = counter(library), set()
    for k in range(400):
        q, v = rng.uniform(robot.q_min, robot.q_max), rng.normal(scale=0.3, size=robot.n)
        if k % 3 == 0:
            q[3] = 0.0
        state = robot.state(q)
        tip_ref = rng.normal(size=(3, 3)) * [[1e-3], [0.05 * (k % 4)], [0.1]]
        tip_ref[0] += state.tip
        trocar = np.array([state.tip - 0.15 * state.tool_direction, np.zeros(3)])
        controller.start(q, v, np.zeros(robot.n))
        for stamp in range(2):
            count.value = 0
            tau = controller.tick(q, v, tip_ref, trocar, np.zeros(6), stamp)
            if not controller.reason:
                most, least = max(most, count.value), min(least, count.value)
                faults.add(controller.fault)
        assert np.isfinite(tau).all()
    assert least > tick.tick.n_instructions() // 2  # or nothing was counted
    assert most <= stated
    assert settings.law == "dcac" or {"none", "infeasible"} <= faults


def test_each_function_is_counted_from_above_and_not_far(counting: Callable[..., Any]) -> None:
    """The parts on their own, at the rows that they are stated for; those without a way out early are exact."""
    _, library = counting(ControlSettings())
    count, n = counter(library), 7
    rng = np.random.default_rng(1)

    def spent(function: str, *given: Any, restype: Any = None) -> int:
        arguments = [ctypes.c_void_p(x.ctypes.data) if isinstance(x, np.ndarray) else x for x in given]
        call = getattr(library, function)
        call.restype = restype
        count.value = 0
        call(*arguments)
        return int(count.value)

    M = np.eye(n) + 0.1 * np.ones((n, n))
    Z = np.linalg.qr(rng.normal(size=(n, n)))[0]
    x, out = rng.normal(size=n), np.zeros(n)
    assert spent("moc_all_finite", n, x) == operations.all_finite(n)
    assert spent("moc_cholesky", n, M, np.zeros((n, n))) == operations.cholesky(n)
    assert spent("moc_solve_factored", n, np.linalg.cholesky(M), x.copy()) == operations.solve_factored(n)
    found = spent("moc_third_level", M, Z, n, x, x, ctypes.c_double(0.5), out)
    assert 0.9 * operations.third_level(n, n) <= found <= operations.third_level(n, n)
    assert spent("moc_orthonormalise", n, rng.normal(size=(n, n))) == operations.orthonormalise(n, n)

    record = np.concatenate([
        rng.normal(size=6 * n), rng.normal(size=6), rng.normal(size=n), -rng.uniform(1.0, 2.0, n),
        rng.uniform(1.0, 2.0, n), [0.01, 0.01, 1e-3, 1e-5], np.zeros(n),
    ])  # fmt: skip
    five = type("Residuals", (ctypes.Structure,), {"_fields_": [("x", ctypes.c_double * 5)]})
    for rows in (1, 2, n):
        answers = rng.normal(size=(40, n))
        judged = max(spent("moc_compute_residuals", record, Z, rows, answer, restype=five) for answer in answers)
        assert 0.8 * operations.residual_check(n, rows) <= judged <= operations.residual_check(n, rows)
        most = 0
        for seed in range(40):
            drawn = np.random.default_rng(seed)
            record[6 * n : 6 * n + 6] = drawn.normal(scale=10.0 ** drawn.uniform(-2, 2), size=6)
            most = max(most, spent("moc_retreat", record, Z, rows, out))
        assert 0.05 * operations.retreat(n, rows) <= most <= operations.retreat(n, rows)


def test_the_straight_elbow_is_counted_from_above(counting: Callable[..., Any], robot: RobotModel) -> None:
    """Rank four, with answers and without: elimination, kernel and answer together."""
    _, library = counting(ControlSettings())
    count, rng, most = counter(library), np.random.default_rng(2), 0
    plane = type("Plane", (ctypes.Structure,), {"_fields_": [("bytes", ctypes.c_char * (8 * 48 + 4 * 15))]})
    library.moc_eliminate.restype = plane
    answered = set()
    for _ in range(40):
        q = rng.uniform(robot.q_min, robot.q_max)
        q[3] = 0.0
        state, x, Z = robot.state(q), np.zeros(7), np.zeros((7, 7))
        reach = rng.uniform(-0.5, 0.5, 7) * rng.choice([0.0, 1.0, 5.0])
        record = np.concatenate([
            state.A.ravel(), state.A @ reach, state.grad_mu, -np.ones(7), np.ones(7), [0.01, 0.01, 1e-3, 1e-5], q,
        ])  # fmt: skip
        at = record.ctypes.data
        count.value = 0
        eliminated = library.moc_eliminate(ctypes.c_void_p(at), ctypes.c_void_p(at + 8 * 42))
        assert library.moc_kernel(ctypes.byref(eliminated), ctypes.c_void_p(Z.ctypes.data)) == 3
        answered.add(
            library.moc_singular_answer(ctypes.byref(eliminated), ctypes.c_void_p(at), ctypes.c_void_p(x.ctypes.data))
        )
        most = max(most, count.value)
    assert answered == {0, 1}
    assert 0.2 * operations.straight_elbow(7) <= most <= operations.straight_elbow(7)


def test_the_number_is_in_the_header_and_that_of_its_parts(robot: RobotModel) -> None:
    from moc_opt.embedded.export import safe_files

    tick, texts = safe_files(TickSpec(robot, ControlSettings(), Exact(), 0.002))
    found = operations.worst_path(tick)
    assert found["in all"] == sum(value for part, value in found.items() if part != "in all")
    assert f"#define MOC_OPERATIONS {found['in all']}" in " ".join(texts["moc_constants.h"].split())
    assert "#define SWEEPS 50 " in texts["moc_answer.c"]
    assert operations.SWEEPS == 50

"""The package's folders and modules lie on floors. A module imports only from its own floor or below."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[1] / "moc_opt"
FLOORS = (  # from low to high
    ("errors", "arrays", "core"),
    ("inputs", "figures"),
    ("robots", "qp", "tasks"),
    ("solvers", "trace"),
    ("control", "sim"),
    ("vision", "planning", "realtime"),
    ("scenario",),
    ("export", "report"),
    ("study", "live", "robots.check", "robots.command", "robots.new"),
    ("commands", "__init__", "__main__"),
    ("benchmarks", "tests", "examples"),
)
FLOOR = {room: floor for floor, rooms in enumerate(FLOORS) for room in rooms}


def rooms_imported(source):
    for node in ast.walk(ast.parse(source)):
        stem = f"{node.module}." if isinstance(node, ast.ImportFrom) else ""
        for alias in node.names if isinstance(node, ast.Import | ast.ImportFrom) else ():
            top, room, module, *_ = f"{stem}{alias.name}..".split(".")
            if top == "moc_opt" or top in FLOORS[-1]:
                names = (f"{room}.{module}", room, "__init__") if top == "moc_opt" else (top,)
                yield next(name for name in names if name in FLOOR)


def test_module_imports_only_from_its_floor_or_below():
    for file in PACKAGE.rglob("*.py"):
        place = file.relative_to(PACKAGE)
        floor = FLOOR.get(".".join(place.with_suffix("").parts), FLOOR.get(place.parts[0].removesuffix(".py")))
        above = [room for room in rooms_imported(file.read_text()) if FLOOR[room] > floor]
        assert above == [], place


HEAVY = ("mujoco", "pinocchio", "casadi", "osqp", "proxsuite", "qpsolvers", "scipy", "pyarrow", "polars", "plotly")
LOADS_NONE_OF = {
    "import moc_opt": (*HEAVY, "numpy", "pydantic"),
    "import moc_opt; moc_opt.NullSpaceQP": HEAVY,
    "import moc_opt.tasks, moc_opt.trace.metrics": HEAVY,
    "import moc_opt.robots": ("mujoco", "pinocchio", "casadi"),
    "import moc_opt; moc_opt.solvers.create('exact')": ("mujoco", "pinocchio", "moc_opt.robots"),
    "import moc_opt.robots.model": ("mujoco", "osqp", "proxsuite", "qpsolvers", "polars"),
    "import moc_opt.sim": ("pinocchio", "casadi", "osqp", "qpsolvers", "moc_opt.solvers", "moc_opt.control"),
}


@pytest.mark.parametrize(("statement", "others"), LOADS_NONE_OF.items())
def test_import_loads_only_what_it_needs(statement, others):
    code = f"import sys\n{statement}\nprint([m for m in {others!r} if m in sys.modules])"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"

"""Who may import whom: the rules as data, read off the syntax trees, and proof that a breach would be seen."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "moc_opt"

# Every module belongs to the room with the longest name that fits.
ROOMS = {
    "public": ["moc_opt"],
    "command line": ["moc_opt.__main__"],
    "errors": ["moc_opt.errors", "moc_opt.names"],
    "files": ["moc_opt.files", "moc_opt.memory"],
    "settings": ["moc_opt.settings"],
    "compiled": ["moc_opt.compiled", "moc_opt.lanes"],
    "subproblem": ["moc_opt.subproblem", "moc_opt.optimality", "moc_opt.extremes"],
    "robots": ["moc_opt.robots"],
    "model": [
        "moc_opt.model", "moc_opt.model_kernels", "moc_opt.link_kernels", "moc_opt.state", "moc_opt.kinematics",
        "moc_opt.selfmotion", "moc_opt.selfmotion_kernels", "moc_opt.travel", "moc_opt.placing",
    ],
    "tasks": ["moc_opt.tasks"],
    "trace": ["moc_opt.trace", "moc_opt.trace_file", "moc_opt.trace_writer", "moc_opt.ending"],
    "metrics": ["moc_opt.metrics", "moc_opt.oscillation"],
    "protocol": ["moc_opt.solvers.base"],
    "solvers": ["moc_opt.solvers"],
    "control": ["moc_opt.control"],
    "assemblies": [
        "moc_opt.agreement", "moc_opt.reach", "moc_opt.preflight", "moc_opt.handson", "moc_opt.augmented",
        "moc_opt.views",
    ],
    "embedded": ["moc_opt.embedded"],
    "sim": ["moc_opt.sim"],
    "report": ["moc_opt.report"],
    "pictures": [
        "moc_opt.report.replay", "moc_opt.report.map", "moc_opt.report.map_figure", "moc_opt.report.map_page",
        "moc_opt.report.courses", "moc_opt.report.runs", "moc_opt.report.swivel",
    ],
    "scenario": [
        "moc_opt.scenario", "moc_opt.scenario_tables", "moc_opt.layout", "moc_opt.driver", "moc_opt.exported",
        "moc_opt.rows",
    ],
    "live": ["moc_opt.live"],
}  # fmt: skip

# Rooms that a room may import from, besides itself.
ALLOWED = {
    "errors": set(),
    "files": {"errors"},
    "settings": {"errors", "files"},
    "compiled": set(),
    "subproblem": {"errors"},
    "tasks": {"errors"},
    "trace": {"errors", "files"},
    "robots": {"errors", "files", "settings"},
    "metrics": {"errors", "trace"},
    "protocol": {"errors", "subproblem"},
    "solvers": {"errors", "compiled", "subproblem", "protocol"},
    "model": {"errors", "compiled", "robots"},
    "sim": {"errors", "settings", "compiled", "robots", "tasks", "trace"},
    "report": {"errors", "files", "metrics", "trace"},
    "control": {"errors", "files", "settings", "compiled", "tasks", "subproblem", "robots", "model", "protocol"},
    "assemblies": {"errors", "settings", "tasks", "trace", "robots", "model", "sim", "control"},
    "pictures": {"errors", "trace", "model", "report"},
    "embedded": {"errors", "subproblem", "model", "protocol", "solvers", "control"},
    "scenario": {
        "errors", "files", "settings", "tasks", "trace", "subproblem", "robots", "metrics", "model", "protocol",
        "solvers", "sim", "report", "control", "assemblies", "embedded",
    },
    "live": {"errors", "tasks", "model", "solvers", "control", "pictures", "scenario"},
    "command line": {"errors", "metrics", "report", "scenario", "trace", "embedded", "pictures", "live"},
    "public": {"errors", "metrics", "model", "scenario", "solvers", "subproblem", "trace"},
}  # fmt: skip

# From the ground up; a room imports from floors below its own, and from its own floor's errors and settings.
FLOORS = [
    {"errors", "files", "settings", "compiled", "tasks", "trace"},
    {"subproblem", "robots", "metrics"},
    {"protocol", "solvers", "model", "sim", "report"},
    {"control"},
    {"assemblies", "embedded", "pictures"},
    {"scenario"},
    {"live"},
    {"command line", "public"},
]
GROUND = {"errors", "files", "settings", "compiled"}
SAME_FLOOR = {("solvers", "protocol")}

# Other people's packages; a room that is not named here may use any but those of NEVER.
ONLY = {
    "errors": set(),
    "files": {"numpy"},
    "settings": {"pydantic"},
    "compiled": {"numba", "llvmlite"},
    "subproblem": {"numpy"},
    "tasks": {"numpy"},
    "metrics": {"numpy"},
    "trace": {"numpy", "pyarrow"},
    "robots": {"numpy", "pydantic"},
    "protocol": {"numpy"},
    "control": {"numpy", "numba", "pydantic"},
    "scenario": {"numpy", "pydantic"},
    "public": set(),
}
NEVER = {
    "solvers": {"pinocchio", "mujoco", "pydantic"},
    "sim": {"pinocchio", "casadi", "osqp", "proxsuite", "qpsolvers"},
    "model": {"mujoco", "osqp", "proxsuite", "qpsolvers"},
    "report": {"pinocchio", "mujoco", "casadi", "numba"},
}
OUTSIDE = {"benchmarks", "tests", "examples"}  # imported by nothing in moc_opt


def module_name(file, root=ROOT):
    """moc_opt/sim/plant.py -> moc_opt.sim.plant."""
    parts = file.relative_to(root).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_name(file): file for file in sorted(PACKAGE.rglob("*.py"))}


def room_of(module):
    """The room with the longest prefix; the bare package only for itself."""
    fits = [
        (len(prefix), room)
        for room, prefixes in ROOMS.items()
        for prefix in prefixes
        if module == prefix or (prefix != "moc_opt" and module.startswith(prefix + "."))
    ]
    return max(fits)[1] if fits else None


def imports(source, module, package=False):
    """(line, dotted name) of everything a source imports, wherever in it, names of our modules in texts included."""
    found = []
    home = module.split(".") if package else module.split(".")[:-1]
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found += [(node.lineno, alias.name) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            stem = home[: len(home) - node.level + 1] if node.level else []
            base = ".".join([*stem, *([node.module] if node.module else [])])
            for alias in node.names:
                whole = f"{base}.{alias.name}"
                found.append((node.lineno, whole if whole in MODULES else base))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            # importlib and registries name modules in texts
            text = node.value
            if re.fullmatch(r"(moc_opt|benchmarks|tests|examples)(\.\w+)+", text) and (
                text in MODULES or not text.startswith("moc_opt")
            ):
                found.append((node.lineno, text))
    return found


def breaches(source, module, package=False):
    """What in a source breaks the rules, one text each."""
    room, wrong = room_of(module), []
    if room is None:
        return [f"{module} is in no room: give it one, and its rules"]
    for line, name in imports(source, module, package):
        top = name.split(".")[0]
        where = f"{module}:{line} ({room}) imports {name}"
        if top in OUTSIDE:
            wrong.append(f"{where}: nothing in moc_opt may")
        elif top == "moc_opt":
            target = room_of(name)
            if target != room and target not in ALLOWED[room]:
                wrong.append(f"{where} ({target}): allowed are {sorted(ALLOWED[room])}")
        elif top not in sys.stdlib_module_names and (
            (room in ONLY and top not in ONLY[room]) or top in NEVER.get(room, ())
        ):
            wrong.append(f"{where}: this room may not use that package")
    return wrong


# --- the rules hold ---


def test_every_module_has_a_room():
    assert [module for module in MODULES if room_of(module) is None] == []
    assert set(ALLOWED) == set(ROOMS)
    assert set().union(*FLOORS) == set(ROOMS)


@pytest.mark.parametrize("module", MODULES)
def test_module_keeps_the_rules(module):
    file = MODULES[module]
    assert breaches(file.read_text(encoding="utf-8"), module, file.name == "__init__.py") == []


def test_rules_agree_with_the_floors():
    floor = {room: level for level, rooms in enumerate(FLOORS) for room in rooms}
    for room, targets in ALLOWED.items():
        for target in targets:
            below = floor[target] < floor[room]
            assert below or target in GROUND - {room} or (room, target) in SAME_FLOOR, (
                f"{room} imports {target}"
            )


def test_no_circle_between_modules():
    """Not even inside a room."""
    edges = {}
    for module, file in MODULES.items():
        source = file.read_text(encoding="utf-8")
        top_level = [node for node in ast.parse(source).body if isinstance(node, ast.Import | ast.ImportFrom)]
        text = "\n".join(ast.unparse(node) for node in top_level)
        names = {name for _, name in imports(text, module, file.name == "__init__.py")}
        edges[module] = {name for name in names if name in MODULES and name != module}
    done, path = set(), []

    def visit(module):
        assert module not in path, " -> ".join([*path[path.index(module) :], module])
        if module in done:
            return
        path.append(module)
        for name in edges[module]:
            visit(name)
        path.pop()
        done.add(module)

    for module in MODULES:
        visit(module)


# --- and a breach would be seen ---


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("moc_opt.subproblem", "from moc_opt.model import RobotModel"),
        ("moc_opt.subproblem", "import scipy"),
        ("moc_opt.errors", "import numpy"),
        ("moc_opt.errors", "from moc_opt import trace"),
        ("moc_opt.tasks.paths", "from ..robots import loader"),
        ("moc_opt.tasks.paths", "import numba"),
        ("moc_opt.solvers.osqp", "from moc_opt.model import load_robot"),
        ("moc_opt.solvers.osqp", "import pinocchio as pin"),
        ("moc_opt.solvers.osqp", "def f():\n    from moc_opt.robots.loader import load_data"),
        ("moc_opt.control.controller", "from moc_opt.solvers.exact import Exact"),
        ("moc_opt.control.controller", "from moc_opt import solvers"),
        ("moc_opt.control.controller", "import moc_opt.sim.plant"),
        ("moc_opt.sim.plant", "from moc_opt.control import Controller"),
        ("moc_opt.sim.plant", "import moc_opt.solvers"),
        ("moc_opt.sim.plant", "from moc_opt.model import RobotModel"),
        ("moc_opt.sim.plant", "import pinocchio"),
        ("moc_opt.metrics", "from moc_opt.subproblem import judge"),
        ("moc_opt.report.tables", "from moc_opt.scenario import Scenario"),
        ("moc_opt.model", "import importlib\nimportlib.import_module('moc_opt.scenario')"),
        ("moc_opt.scenario", "from benchmarks import output"),
        ("moc_opt.scenario", "import tests.problems"),
        ("moc_opt.scenario", "if False:\n    import examples"),
        ("moc_opt.control.rcm", "import moc_opt as mo"),
    ],
)
def test_a_breach_is_seen(module, source):
    assert len(breaches(source, module)) == 1


@pytest.mark.parametrize(
    ("module", "source"),
    [
        (
            "moc_opt.subproblem",
            "import numpy as np\nfrom moc_opt.errors import SubproblemError\nimport itertools",
        ),
        (
            "moc_opt.control.controller",
            "from moc_opt.solvers.base import Solver\nfrom moc_opt.control import tick",
        ),
        ("moc_opt.solvers.exact", "from moc_opt.solvers.base import Status\nfrom .polytope import project"),
        ("moc_opt.scenario", "from moc_opt import solvers\nfrom moc_opt.sim.plant import Plant"),
        ("moc_opt.trace", "KEY = 'moc_opt.meta'"),
    ],
)
def test_what_is_allowed_passes(module, source):
    assert breaches(source, module) == []


# --- what importing costs ---


def run_python(code):
    return subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False, timeout=60
    )


HEAVY = (
    "mujoco",
    "pinocchio",
    "casadi",
    "numba",
    "osqp",
    "proxsuite",
    "qpsolvers",
    "scipy",
    "pyarrow",
    "plotly",
)


def test_importing_the_package_imports_nothing_heavy():
    code = f"import sys, moc_opt; print([m for m in {(*HEAVY, 'numpy', 'pydantic')!r} if m in sys.modules])"
    found = run_python(code)
    assert found.returncode == 0, found.stderr
    assert found.stdout.strip() == "[]"


@pytest.mark.parametrize(
    ("statement", "forbidden"),
    [
        ("import moc_opt as mo; mo.NullSpaceQP", HEAVY),
        ("import moc_opt.tasks", HEAVY),
        ("import moc_opt.metrics", HEAVY),
        ("import moc_opt.robots", ("mujoco", "pinocchio", "casadi", "numba")),
        (
            "import moc_opt as mo; mo.solvers.create('exact')",
            ("mujoco", "pinocchio", "casadi", "osqp", "proxsuite"),
        ),
        ("import moc_opt.model", ("mujoco", "osqp", "proxsuite", "qpsolvers", "pyarrow")),
        ("import moc_opt.sim", ("pinocchio", "casadi", "osqp", "proxsuite", "qpsolvers")),
    ],
)
def test_a_room_loads_only_what_it_needs(statement, forbidden):
    found = run_python(f"import sys\n{statement}\nprint([m for m in {forbidden!r} if m in sys.modules])")
    assert found.returncode == 0, found.stderr
    assert found.stdout.strip() == "[]"

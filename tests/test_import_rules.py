"""Who may import whom: the rules as data, read off the syntax trees, and proof that a breach would be seen.

The folders of moc_opt are its rooms; what lies beside them are errors, the public names and the command line.
The folders of benchmarks/ are rooms too; what lies beside them are its commands.
"""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "moc_opt"

FILES = {
    "moc_opt": "public", "moc_opt.metrics": "public", "moc_opt.subproblem": "public",  # the last two are old names
    "moc_opt.__main__": "command line", "moc_opt.errors": "errors",
}  # fmt: skip

# From the ground up: a room, and what it may import from: rooms above it. "solvers.base" is a module of one. Errors and
# the type of all numbers are everybody's.
ALLOWED = {"errors": set(), "numerics": set()} | {room: {"errors", "numerics.arrays", *others} for room, others in {
    "inputs": set(),
    "figures": set(),
    "qp": {"numerics"},
    "tasks": {"inputs"},
    "trace": {"inputs", "figures"},
    "robots": {"inputs"},
    "model": {"numerics", "robots"},
    "redundancy": {"numerics", "model", "trace"},
    "planning": {"inputs", "numerics", "model", "redundancy", "tasks"},
    "solvers": {"inputs", "numerics", "qp"},
    "control": {"inputs", "numerics", "qp", "robots", "model", "tasks", "solvers.base"},
    "sim": {"inputs", "numerics", "robots", "tasks", "trace"},
    "realtime": {"inputs", "qp.layout", "sim", "trace"},
    "vision": {"inputs", "robots", "model", "tasks", "trace", "sim"},
    "procedure": {"inputs", "robots", "model", "redundancy", "tasks", "trace", "control", "sim"},
    "embedded": {"inputs", "numerics", "qp", "robots", "model", "solvers", "control"},
    "report": {"figures", "inputs", "trace", "model", "redundancy", "planning"},
    "scenario": {
        "inputs", "numerics", "qp", "tasks", "trace", "robots", "model", "redundancy", "planning", "solvers", "control",
        "sim", "realtime", "procedure", "embedded",
    },
    "live": {"inputs", "tasks", "model", "redundancy", "solvers", "control", "report", "scenario"},
    "commissioning": {"inputs", "robots", "model", "redundancy", "control", "sim", "report", "scenario"},
    "comparison": {"figures", "inputs", "trace", "solvers.base", "report", "scenario"},
    "public": {"qp", "trace", "model", "planning", "solvers", "scenario", "comparison"},
    "commands": {
        "inputs", "trace", "tasks", "robots", "solvers", "realtime", "report", "scenario", "live", "commissioning",
        "comparison", "public",
    },
    "command line": {"report", "commands"},
}.items()}  # fmt: skip

# Other people's packages; a room that is not named here may use any but those of NEVER.
ONLY = {
    "errors": set(),
    "inputs": {"numpy", "pydantic", "jinja2"},
    "numerics": {"numpy", "numba", "llvmlite"},
    "figures": {"numpy", "plotly"},
    "tasks": {"numpy"},
    "trace": {"numpy", "pyarrow"},
    "robots": {"numpy", "pydantic"},
    "planning": {"numpy", "numba", "casadi"},
    "realtime": {"numpy", "pydantic"},
    "control": {"numpy", "numba", "pydantic"},
    "procedure": {"numpy", "pydantic", "scipy"},
    "scenario": {"numpy", "pydantic", "pyarrow"},
    "public": set(),
}
ONLY_MODULES = {  # whoever has a subproblem or a trace needs numpy alone
    "moc_opt.qp.problem": {"numpy"}, "moc_opt.qp.residuals": {"numpy"}, "moc_opt.qp.extremes": {"numpy"},
    "moc_opt.qp.reduction": {"numpy"}, "moc_opt.qp.layout": set(),
    "moc_opt.solvers.base": {"numpy"}, "moc_opt.numerics.arrays": {"numpy"},
    "moc_opt.trace.trace": {"numpy", "pandas", "plotly", "xarray"},  # the others for their types alone
}  # fmt: skip
# Methods of public objects that hand them on: what they import upwards or from others lies inside a function.
VIEWS = {"moc_opt.trace.views": {"moc_opt.figures"}}
GROUPS = {"moc_opt.trace.metrics.registry": "moc_opt.metrics"}  # of entry points, and no import
NEVER = {
    "solvers": {"pinocchio", "mujoco", "pydantic"},
    "sim": {"pinocchio", "casadi", "osqp", "proxsuite", "qpsolvers"},
    "model": {"mujoco", "osqp", "proxsuite", "qpsolvers"},
    "redundancy": {"mujoco", "osqp", "proxsuite", "qpsolvers"},
    "report": {"pinocchio", "mujoco", "casadi", "numba"},
}
OUTSIDE = {"benchmarks", "tests", "examples"}  # imported by nothing in moc_opt


# From the ground up: a room of benchmarks/, and which of the others it may import. What maintainers run may use all.
BENCHMARKS = {
    "common": set(),
    "baselines": set(),
    "subproblems": {"common"},
    "paper_experiment": {"common"},
    "solver_study": {"common", "subproblems"},
    "sweeps": {"common"},
    "planning": {"common"},
    "plant_study": {"common", "paper_experiment"},
    "robots_study": {"common", "paper_experiment"},
    "latency": {"common", "baselines", "solver_study"},
    "reliability": {"common", "subproblems", "solver_study", "sweeps", "latency"},
}
BENCHMARKS["maintenance"] = set(BENCHMARKS)


def module_name(file, root=ROOT):
    """moc_opt/sim/plant.py -> moc_opt.sim.plant."""
    parts = file.relative_to(root).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_name(file): file for file in sorted(PACKAGE.rglob("*.py"))}


def room_of(module):
    """The folder below moc_opt; None where there is no such room."""
    if module in FILES:
        return FILES[module]
    room = module.split(".")[1]
    return room if room in ALLOWED else None


def imports(source, module, package=False):
    """(line, dotted name) of everything a source imports, wherever in it, names of our modules in texts included."""
    found = []
    home = module.split(".") if package else module.split(".")[:-1]
    tree = ast.parse(source)
    # The name of a group of entry points is the name of no module.
    groups = {n.value for n in ast.walk(tree) if isinstance(n, ast.Assign) and ast.unparse(n.targets[0]) == "GROUP"}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found += [(node.lineno, alias.name) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            stem = home[: len(home) - node.level + 1] if node.level else []
            base = ".".join([*stem, *([node.module] if node.module else [])])
            for alias in node.names:
                whole = f"{base}.{alias.name}"
                found.append((node.lineno, whole if whole in MODULES or base == "benchmarks" else base))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and node not in groups:
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
            inner = ".".join(name.split(".")[1:3])
            if target != room and not {target, inner} & ALLOWED[room]:
                wrong.append(f"{where} ({target}): allowed are {sorted(ALLOWED[room])}")
        elif top not in sys.stdlib_module_names and (
            top not in ONLY_MODULES.get(module, ONLY.get(room, {top})) or top in NEVER.get(room, ())
        ):
            wrong.append(f"{where}: this room may not use that package")
    return wrong


def benchmark_breaches(source, module):
    """What in a source of benchmarks/ breaks its rules; a command may import every room, and nothing a command."""
    parts = module.split(".")
    room = parts[1] if len(parts) > 2 or parts[1] in BENCHMARKS else None
    allowed = set(BENCHMARKS) - {"maintenance"} if room is None else BENCHMARKS[room] | {room}
    wrong = []
    for line, name in imports(source, module):
        top, _, inner = name.partition(".")
        target = inner.partition(".")[0]
        if top == "tests" or (top == "benchmarks" and target and target not in allowed):
            wrong.append(f"{module}:{line} imports {name}: allowed are {sorted(allowed)}")
    return wrong


# --- the rules hold ---


def test_every_folder_is_a_room_and_every_file_lies_in_one():
    assert [module for module in MODULES if room_of(module) is None] == []
    folders = {file.parent.name for file in PACKAGE.glob("*/__init__.py")}
    assert folders | set(FILES.values()) == set(ALLOWED)
    assert len(list(PACKAGE.glob("*.py"))) <= 5


@pytest.mark.parametrize("module", MODULES)
def test_module_keeps_the_rules(module):
    file = MODULES[module]
    assert breaches(file.read_text(encoding="utf-8"), module, file.name == "__init__.py") == []


@pytest.mark.parametrize("rules", [ALLOWED, BENCHMARKS], ids=["moc_opt", "benchmarks"])
def test_rooms_import_from_rooms_below_them(rules):
    floor = {room: level for level, room in enumerate(rules)}
    for room, targets in rules.items():
        for target in targets:
            assert floor[target.partition(".")[0]] < floor[room], f"{room} imports {target}"


def test_benchmarks_keep_the_rules():
    home = ROOT / "benchmarks"
    files = [file for file in sorted(home.rglob("*.py")) if file != home / "__init__.py"]
    assert {file.relative_to(home).parts[0] for file in files if file.parent != home} == set(BENCHMARKS)
    assert [text for file in files for text in benchmark_breaches(file.read_text(), module_name(file))] == []


def test_the_name_of_a_group_of_entry_points_is_no_import():
    """And of nothing else: the same text anywhere else names a module."""
    assert breaches("GROUP = 'moc_opt.metrics'", "moc_opt.trace.metrics.registry") == []
    assert len(breaches("HOME = 'moc_opt.metrics'", "moc_opt.trace.metrics.registry")) == 1


def test_old_names_are_the_same_objects():
    import moc_opt.metrics
    import moc_opt.subproblem
    from moc_opt.qp import problem
    from moc_opt.trace import metrics

    assert moc_opt.metrics.summarize is metrics.summarize
    assert moc_opt.metrics.metric is metrics.metric
    assert moc_opt.subproblem.NullSpaceQP is problem.NullSpaceQP
    assert moc_opt.subproblem.judge is problem.compute_residuals


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
        ("moc_opt.qp.problem", "from moc_opt.model.robot_model import RobotModel"),
        ("moc_opt.qp.problem", "import scipy"),
        ("moc_opt.errors", "import numpy"),
        ("moc_opt.errors", "from moc_opt import trace"),
        ("moc_opt.tasks.paths", "from ..robots import loader"),
        ("moc_opt.tasks.paths", "import numba"),
        ("moc_opt.solvers.backends.osqp", "from moc_opt.model.robot_model import load_robot"),
        ("moc_opt.solvers.backends.osqp", "import pinocchio as pin"),
        ("moc_opt.solvers.backends.osqp", "def f():\n    from moc_opt.robots.loader import load_data"),
        ("moc_opt.control.controller", "from moc_opt.solvers.exact.solver import Exact"),
        ("moc_opt.control.controller", "from moc_opt import solvers"),
        ("moc_opt.control.controller", "import moc_opt.sim.plant"),
        ("moc_opt.sim.plant", "from moc_opt.control import Controller"),
        ("moc_opt.sim.plant", "import moc_opt.solvers"),
        ("moc_opt.sim.plant", "from moc_opt.model.robot_model import RobotModel"),
        ("moc_opt.sim.plant", "import pinocchio"),
        ("moc_opt.trace.metrics", "from moc_opt.qp.problem import compute_residuals"),
        ("moc_opt.report.tables", "from moc_opt.scenario import Scenario"),
        ("moc_opt.model.robot_model", "import importlib\nimportlib.import_module('moc_opt.scenario')"),
        ("moc_opt.scenario", "from benchmarks.common import output"),
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
        ("benchmarks.common.cli", "from benchmarks.sweeps.store import Store"),
        ("benchmarks.solver_study.study", "from benchmarks import latency"),
        ("benchmarks.sweeps.plan", "def f():\n    from benchmarks.solver_study.cases import trials"),
        ("benchmarks.sweeps.plan", "from benchmarks import sweep"),
        ("benchmarks.solvers", "from benchmarks import sweep"),
        ("benchmarks.solvers", "from benchmarks.maintenance import readme"),
        ("benchmarks.common.crew", "from tests.problems import unit"),
    ],
)
def test_a_breach_in_benchmarks_is_seen(module, source):
    assert len(benchmark_breaches(source, module)) == 1


@pytest.mark.parametrize(
    ("module", "source"),
    [
        (
            "moc_opt.qp.problem",
            "import numpy as np\nfrom moc_opt.errors import SubproblemError\nimport itertools",
        ),
        (
            "moc_opt.control.controller",
            "from moc_opt.solvers.base import Solver\nfrom moc_opt.control import tick",
        ),
        ("moc_opt.solvers.exact.solver", "from moc_opt.solvers.base import Status\nfrom .polytope import project"),
        ("moc_opt.scenario", "from moc_opt import solvers\nfrom moc_opt.sim.plant import Plant"),
        ("moc_opt.trace.trace", "KEY = 'moc_opt.meta'"),
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
    "pandas",
    "xarray",
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
        ("import moc_opt.trace.metrics", HEAVY),
        ("import moc_opt.robots", ("mujoco", "pinocchio", "casadi", "numba")),
        (
            "import moc_opt as mo; mo.solvers.create('exact')",
            ("mujoco", "pinocchio", "casadi", "osqp", "proxsuite"),
        ),
        ("import moc_opt.model.robot_model", ("mujoco", "osqp", "proxsuite", "qpsolvers", "pyarrow")),
        ("import moc_opt.sim", ("pinocchio", "casadi", "osqp", "proxsuite", "qpsolvers")),
    ],
)
def test_a_room_loads_only_what_it_needs(statement, forbidden):
    found = run_python(f"import sys\n{statement}\nprint([m for m in {forbidden!r} if m in sys.modules])")
    assert found.returncode == 0, found.stderr
    assert found.stdout.strip() == "[]"

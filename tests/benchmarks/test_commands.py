"""The commands: ``python -m benchmarks.NAME`` calls each, and those of users stand without those of the maintainers."""

import ast
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

import benchmarks

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "benchmarks"
USERS = (
    "solvers", "paper", "speed", "faults", "plan", "plant", "sweep", "testsets", "export", "robots", "realtime",
)  # fmt: skip
MAINTAINERS = ("readme", "pictures", "errata", "tune", "coverage", "feedforward")


def has_main(file):
    return any(isinstance(node, ast.FunctionDef) and node.name == "main" for node in ast.parse(file.read_text()).body)


def test_the_commands_are_these():
    for folder, names in ((FOLDER, USERS), (FOLDER / "maintenance", MAINTAINERS)):
        assert {file.stem for file in folder.glob("*.py") if has_main(file)} == set(names)
        for name in names:
            spec = find_spec(f"benchmarks.{name}")
            assert spec is not None
            assert Path(spec.origin) == folder / f"{name}.py"


@pytest.mark.parametrize("name", ["readme", "export"])
def test_a_command_runs_as_a_module(name):
    command = [sys.executable, "-m", f"benchmarks.{name}", "--help"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert f"python -m benchmarks.{name}" in done.stdout


def imported(file):
    """Modules that a file imports, as they are named in it."""
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def test_nothing_that_users_run_imports_what_maintainers_run():
    inside = {"maintenance", *(path.stem for path in (FOLDER / "maintenance").iterdir())} - {"__init__", "__pycache__"}
    for file in FOLDER.rglob("*.py"):
        names = {name.split(".")[1] for name in imported(file) if name.startswith("benchmarks.")}
        if "maintenance" in file.relative_to(FOLDER).parts:
            assert not names & (inside - {"maintenance"}), f"{file}: name the folder, or there are two of the module"
        else:
            assert not names & inside, file


def test_what_maintainers_run_is_found_by_one_path_more():
    assert list(benchmarks.__path__) == [str(FOLDER), str(FOLDER / "maintenance")]

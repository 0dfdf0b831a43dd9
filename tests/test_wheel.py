"""What pip installs is whole: the wheel, in an environment with its own requirements and no other package.

Nothing is fetched: the wheel is built without isolation, and the packages that it requires, and those that they
require, are linked in from this environment. Extras, tests and the checkout are out of sight.
"""

import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PATIENCE_S = 300


def call(*command, **more):
    found = subprocess.run(command, capture_output=True, text=True, check=False, timeout=PATIENCE_S, **more)
    assert found.returncode == 0, f"{command}\n{found.stdout[-2000:]}\n{found.stderr[-2000:]}"
    return found.stdout


def required(lines):
    """Names of what is required without an extra."""
    return {re.match(r"[\w.-]+", line)[0] for line in lines or () if "extra ==" not in line}


def closure(names):
    """Every distribution here that these need, themselves included."""
    found, waiting = {}, set(names)
    while waiting:
        name = waiting.pop()
        try:
            one = distribution(name)
        except PackageNotFoundError:
            continue  # of another platform or Python; a missing one shows when the wheel runs
        if one.metadata["Name"] not in found:
            found[one.metadata["Name"]] = one
            waiting |= required(one.requires)
    return found


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """The folder of programs of an environment in which the wheel is installed."""
    source, built, home = (tmp_path_factory.mktemp(name) for name in ("source", "built", "home"))
    for name in ("moc_opt", "benchmarks", "packaging"):
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    call(sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", built, source)
    (wheel,) = built.glob("*.whl")
    call(sys.executable, "-m", "venv", "--without-pip", home / "env")
    python = home / "env" / "bin" / "python"
    call(sys.executable, "-m", "pip", "--python", python, "install", "--no-deps", "--no-index", wheel)
    site = Path(sysconfig.get_path("purelib", vars={"base": str(home / "env")}))
    (info,) = site.glob("moc_opt-*.dist-info")
    for one in closure(required(Distribution.at(info).requires)).values():
        for top in {file.parts[0] for file in one.files} - {".."}:
            if not (site / top).exists():
                (site / top).symlink_to(one.locate_file(top))
    return python.parent


def test_the_wheel_runs_from_an_empty_folder_with_its_requirements_alone(installed, tmp_path):
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    place = {"cwd": tmp_path, "env": environment}
    command = str(installed / "moc-opt")
    assert re.fullmatch(r"moc-opt \d+\.\d+\.\d+\n", call(command, "--version", **place))

    solvers = json.loads(call(command, "solvers", "--list", "--json", **place))
    assert solvers["exact"]["here"] == "yes"
    assert "not installed" in solvers["daqp"]["here"], "an extra is in sight: this is no bare installation"

    run = json.loads(call(command, "run", "--trace", "a.parquet", "--report", "a.html", "--json", **place))
    assert run["ended"] == "completed"
    assert run["verified_solved"] == run["claimed_solved"] > 4000
    assert run["mu_gain_percent"] > 5.0
    call(command, "replay", "a.parquet", **place)
    call(command, "export-c", "--out", "c", **place)
    assert {"a.parquet", "a.html", "replay.html", "c"} <= {file.name for file in tmp_path.iterdir()}

    program = "import moc_opt, benchmarks; print(moc_opt.__file__, benchmarks.__file__)"
    where = call(installed / "python", "-c", program, **place)
    assert str(ROOT) not in where
    call(command, "solvers", "--quick", "--only", "exact", "--parts", "testsets", "--sets", "random", **place)
    summary = json.loads((tmp_path / "results" / "solvers" / "summary.json").read_text(encoding="utf-8"))
    (found,) = (of for name, of in summary["testset random"].items() if name.startswith("exact"))
    assert found["claimed_solved"] > 0

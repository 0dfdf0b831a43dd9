"""The source archive and the wheel are complete. A stand-in for `ziglang` calls the system's compiler."""

import contextlib
import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
from functools import partial
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path
from zipfile import ZipFile

import pytest

ROOT = Path(__file__).resolve().parent.parent
COMPILER = shutil.which("cc")
STAND_IN = """import os, sys
open({log!r}, "a").write(" ".join(sys.argv[1:]) + "\\n")
at = sys.argv.index("-target")
os.environ["PATH"] = {path!r}
os.execv({compiler!r}, ["cc", *sys.argv[2:at], *sys.argv[at + 2:], "-O0"])
"""


def call(*command, **options):
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300, **options)
    assert done.returncode == 0, f"{command}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"
    return done.stdout


def closure(lines):
    """Return every installed distribution that these requirements need."""
    found, waiting = {}, list(lines or ())
    while waiting:
        line = waiting.pop()
        name = re.match(r"[\w.-]+", line)[0]
        if "extra ==" not in line and name not in found:
            with contextlib.suppress(PackageNotFoundError):  # another platform's requirement
                found[name] = distribution(name)
                waiting += found[name].requires or ()
    return found.values()


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """Build the wheel without a compiler on the path, so that the build uses `ziglang`."""
    if COMPILER is None:
        pytest.skip("no C compiler on the path")
    source, built, tools, path = (tmp_path_factory.mktemp(name) for name in ("source", "built", "tools", "path"))
    hooks = os.environ | {"PYTHONPATH": str(source / "packaging")}
    for name in ("moc_opt", "benchmarks", "packaging"):
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__", "*.so"))
    for name in ("pyproject.toml", "setup.py", "MANIFEST.in", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    call(sys.executable, "-c", "import backend, sys; backend.build_sdist(sys.argv[1])", built, cwd=source, env=hooks)
    (tools / "ziglang").mkdir()
    stand_in = STAND_IN.format(log=str(tools / "log"), path=os.environ["PATH"], compiler=COMPILER)
    (tools / "ziglang" / "__main__.py").write_text(stand_in, encoding="utf-8")
    bare = {name: value for name, value in os.environ.items() if name != "CC"}
    bare |= {"PATH": str(path), "PYTHONPATH": str(tools)}
    (archive,) = built.glob("*.tar.gz")
    pip = (sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation", "--no-index")
    call(*pip, "--wheel-dir", built, archive, env=bare)
    assert (tools / "log").read_text(encoding="utf-8").count("-target ") > 10
    return next(built.glob("*.whl"))


@pytest.fixture(scope="module")
def run(wheel, tmp_path_factory):
    home = tmp_path_factory.mktemp("home")
    call(sys.executable, "-m", "venv", "--without-pip", home / "env")
    tools = home / "env" / "bin"
    call(sys.executable, "-m", "pip", "--python", tools / "python", "install", "--no-deps", "--no-index", wheel)
    site = Path(sysconfig.get_path("purelib", vars={"base": str(home / "env")}))
    (info,) = site.glob("moc_opt-*.dist-info")
    for one in closure(Distribution.at(info).requires):
        for top in {file.parts[0] for file in one.files} - {".."}:
            if not (site / top).exists():
                (site / top).symlink_to(one.locate_file(top))
    bare = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    bare["HOME"] = str(home / "home")
    return lambda *words, cwd: call(tools / "moc-opt", *words, cwd=cwd, env=bare)


def test_installed_wheel_runs(wheel, run, tmp_path):
    assert "-cp311-abi3-" in wheel.name
    tops = {name.partition("/")[0] for name in ZipFile(wheel).namelist()}
    assert {name for name in tops if not name.endswith(".dist-info")} == {"moc_opt"}
    here = partial(run, cwd=tmp_path)
    assert re.fullmatch(r"moc-opt \d+\.\d+\.\d+\n", here("--version"))
    solvers = json.loads(here("solvers", "--list", "--json"))
    assert solvers["exact"]["here"] == "yes"
    assert "not installed" in solvers["daqp"]["here"], "an optional package is installed"
    summary = json.loads(here("run", "--trace", "a.parquet", "--report", "a.html", "--json"))
    assert summary["ended"] == "completed"
    assert summary["verified_solved"] == summary["claimed_solved"] > 4000
    assert summary["mu_gain_percent"] > 5.0
    here("replay", "a.parquet")
    here("export-c", "--out", "c")
    assert {"a.parquet", "a.html", "replay.html", "c"} <= {file.name for file in tmp_path.iterdir()}
    here("solvers", "--quick", "--only", "exact", "--parts", "testsets", "--sets", "random")
    study = json.loads((tmp_path / "results" / "solvers" / "summary.json").read_text(encoding="utf-8"))
    assert study["testset random"]["exact@recommended"]["claimed_solved"] > 0


@pytest.fixture
def backend():
    spec = importlib.util.spec_from_file_location("backend", ROOT / "packaging" / "backend.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("hook", ["get_requires_for_build_wheel", "get_requires_for_build_editable"])
def test_ziglang_is_required_only_without_a_compiler(hook, backend, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)  # setuptools leaves files
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    assert any(name.startswith("ziglang") for name in getattr(backend, hook)())
    monkeypatch.setenv("CC", "icx")
    assert getattr(backend, hook)() == []
    monkeypatch.delenv("CC")
    compiler = tmp_path / sysconfig.get_config_var("CC").split()[0]
    compiler.write_text("#!/bin/sh\n", encoding="utf-8")
    compiler.chmod(0o755)
    assert getattr(backend, hook)() == []


def test_missing_headers_are_reported_with_a_remedy(backend, monkeypatch, tmp_path):
    monkeypatch.setattr(sysconfig, "get_path", lambda name: str(tmp_path))
    with pytest.raises(SystemExit, match=r"Python\.h.*python3-dev"):
        backend.get_requires_for_build_wheel()

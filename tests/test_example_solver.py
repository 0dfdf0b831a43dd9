"""Your solver in fifteen lines: installed into a fresh environment, it is compared with the rest."""

import json
import os
import shutil
import subprocess
import sysconfig
import venv
from pathlib import Path

import pytest

from moc_opt.solvers import available

ROOT = Path(__file__).resolve().parent.parent
EXAMPLE = ROOT / "examples" / "your_solver"


def call(*command, **options):
    """Run a program; its output, or the test's failure with it."""
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True, timeout=300, **options)
    return done.returncode, done.stdout + done.stderr, done.stdout


@pytest.fixture(scope="module")
def python(tmp_path_factory):
    """The interpreter of a new environment that sees this one's packages, with the example installed by pip."""
    root = tmp_path_factory.mktemp("fresh")
    venv.create(root / "env", with_pip=False, symlinks=os.name != "nt")
    binary = root / "env" / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    _, _, where = call(binary, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))")
    packages = sysconfig.get_path("purelib")
    (Path(where.strip()) / "outer.pth").write_text(f"{ROOT}\nimport site; site.addsitedir({packages!r})\n")
    for command in (["-m", "pip", "--version"], ["-c", "import setuptools"]):
        code, output, _ = call(binary, *command)
        if code:
            pytest.skip(f"this environment has nothing to install with: {output.splitlines()[-1]}")
    source = shutil.copytree(EXAMPLE, root / "your_solver")  # building leaves files beside the source
    code, output, _ = call(
        binary, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--no-index", source
    )
    if code:
        pytest.skip(f"pip cannot install here: {output[-300:]}")
    return binary


def test_it_is_found_by_its_entry_point(python, tmp_path):
    assert "slsqp" not in available(), "it is not known before"
    code, output, printed = call(
        python, "-c", "import moc_opt_slsqp as m, moc_opt as mo; print(m.__file__, mo.solvers.available()['slsqp'])",
        cwd=tmp_path,
    )  # fmt: skip
    assert code == 0, output
    assert printed.endswith(" None\n")
    assert str(EXAMPLE) not in printed  # the installed one


def test_it_passes_the_conformance_suite(python):
    suite = "tests/solvers/test_conformance.py"
    code, output, _ = call(python, "-m", "pytest", suite, "-k", "slsqp", "-p", "no:cacheprovider", cwd=ROOT)
    assert code == 0, output
    assert int(output.split(" passed")[0].split()[-1]) >= 8


def test_it_is_compared_with_the_rest(python, tmp_path):
    """The main job's own command, in the fresh environment."""
    (tmp_path / "small.toml").write_text(
        "[open_loop]\nticks = 20\ncold = 3\n[testsets]\nnames = ['circle']\nevery = 16\nrounds = 2\nseconds = 0.1\n"
        "[closed_loop]\ntasks = ['circle']\ntrials = 1\nothers = 1\nduration_s = 0.2\n[scenario]\nbound_samples = 2\n"
    )
    code, output, _ = call(
        python, "-m", "benchmarks.solvers", tmp_path / "small.toml", "--only", "exact", "slsqp",
        "--out", tmp_path / "out", "--parts", "testsets", "closed_loop", cwd=ROOT,
    )  # fmt: skip
    assert code == 0, output
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    mine, exact = (summary["testset circle"][f"{name}@recommended"] for name in ("slsqp", "exact"))
    assert mine["claimed_solved"] == mine["solves"] == exact["solves"]
    assert mine["verified_solved"] >= 0.9 * mine["solves"]
    assert mine["solve_p50_us"] > exact["solve_p50_us"]
    loop = summary["closed_loop"]
    assert loop["slsqp"]["whole"] == loop["slsqp"]["trials"] == 1
    assert loop["slsqp"]["mu_mean"] == pytest.approx(loop["exact"]["mu_mean"], rel=1e-3)
    assert "slsqp" in output

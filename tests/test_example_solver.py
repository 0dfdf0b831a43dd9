"""A user's solver passes the conformance suite."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from moc_opt.solvers import available

ROOT = Path(__file__).resolve().parent.parent


def python(*words, **options):
    return subprocess.run([sys.executable, *words], capture_output=True, text=True, timeout=300, **options)


def test_installed_solver_is_found_by_its_entry_point(tmp_path):
    site, bare = tmp_path / "site", ("--quiet", "--no-deps", "--no-build-isolation", "--no-index")
    source = shutil.copytree(ROOT / "examples/your_solver", tmp_path / "source")  # building leaves files
    installed = python("-m", "pip", "install", *bare, "--target", site, source)
    if installed.returncode:
        pytest.skip(f"pip cannot install here: {installed.stderr[-300:]}")
    assert "slsqp" not in available(), "slsqp must be unknown before its installation"
    path = {"cwd": ROOT, "env": os.environ | {"PYTHONPATH": f"{site}{os.pathsep}{ROOT}"}}
    asked = "import moc_opt_slsqp as m, moc_opt as mo; print(m.__file__, mo.solvers.available()['slsqp'])"
    found = python("-c", asked, **path)
    assert found.stdout == f"{site / 'moc_opt_slsqp.py'} None\n", found.stderr
    suite = "tests/solvers/test_conformance.py"
    ended = python("-m", "pytest", suite, "-k", "slsqp", "-p", "no:cacheprovider", **path)
    assert ended.returncode == 0, ended.stdout
    assert int(ended.stdout.split(" passed")[0].split()[-1]) >= 8

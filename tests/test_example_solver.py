"""Your solver in fifteen lines: installed into a fresh environment, it is found and conforms."""

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

"""Cached kernels are those of the sources as they are now."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import moc_opt
from moc_opt.numerics import cache

PACKAGE = Path(moc_opt.__file__).parent
ROOMS = ("numerics", "qp")

ANSWER = """
import numpy as np
from moc_opt.qp.equalities import assemble, assembled
from moc_opt.qp.problem import NullSpaceQP
J = np.arange(1.0, 22.0).reshape(3, 7) ** 1.5 % 1.0
u = np.array([0.6, 0.0, 0.8])
qp = NullSpaceQP(J, J - np.outer([-0.8, 0.0, 0.6], np.cos(np.arange(7.0))) - np.outer([0.0, 1.0, 0.0], np.arange(7.0)),
                 [1.0, 2.0, 3.0], [1.0, 2.0, 3.0], J[0], -np.ones(7), np.ones(7))
found = assembled(qp)
print(len(found.b), float(found.b[0]), float(found.P[0, 0]), sum(assemble.stats.cache_hits.values()))
"""


@pytest.fixture
def package(tmp_path):
    """A copy of the package's lower rooms, without anything compiled."""
    copy = tmp_path / "moc_opt"
    for name in ROOMS:
        shutil.copytree(PACKAGE / name, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("__init__.py", "errors.py"):
        shutil.copy(PACKAGE / name, copy / name)
    return copy


def answer(package):
    """Number of rows, first entry of b and of P, and how often the cache was read, by a new process."""
    run = subprocess.run(
        [sys.executable, "-c", ANSWER], cwd=package.parent,
        env={**os.environ, "PYTHONPATH": str(package.parent), "PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    rows, b, P, hits = run.stdout.split()
    return int(rows), float(b), float(P), int(hits)


def edit(file, old, new):
    """Change one place of a source."""
    text = file.read_text()
    assert text.count(old) == 1
    file.write_text(text.replace(old, new))


def test_an_edited_kernel_elsewhere_or_constant_is_compiled_anew(package):
    first = answer(package)
    assert first[:2] == (5, 1.0)
    assert first[3] == 0
    assert answer(package) == (*first[:3], 1), "nothing has changed: from the cache"
    # a function in another file, which the cached kernel calls
    edit(package / "qp" / "reduction.py", "b5[i] = 1.0, row[o + i]", "b5[i] = 1.0, 7.0 * row[o + i]")
    assert answer(package) == (5, 7.0, first[2], 0)
    # a constant that it froze, two imports away
    edit(package / "qp" / "residuals.py", "TIED = 1e-7\n", "TIED = np.nan\n")
    assert answer(package)[0] == 6


def test_the_key_is_of_what_a_file_imports_and_of_nothing_else(package, monkeypatch):
    monkeypatch.setattr(cache, "_PACKAGE", package)

    def keys():
        cache._read.cache_clear()
        cache.source_key.cache_clear()
        return {name: cache.source_key(package / name) for name in ("qp/equalities.py", "numerics/dense.py")}

    before = keys()
    with (package / "qp" / "layout.py").open("a") as file:  # imported as `from moc_opt.qp import layout, ...`
        file.write("\n")
    after = keys()
    assert after["qp/equalities.py"] != before["qp/equalities.py"]
    assert after["numerics/dense.py"] == before["numerics/dense.py"]
    cache._read.cache_clear()
    cache.source_key.cache_clear()


def test_every_kernel_of_the_package_is_cached_by_its_sources():
    for file in PACKAGE.rglob("*.py"):
        taken = re.findall(r"^\s*from numba import .*\bnjit\b|numba\.njit\(", file.read_text(), re.MULTILINE)
        assert not taken or file == PACKAGE / "numerics" / "cache.py", file

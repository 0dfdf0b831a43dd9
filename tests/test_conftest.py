"""The guard against kernels that are no longer in the source."""

import os

import pytest

from tests.conftest import stale_kernels


@pytest.fixture
def package(tmp_path):
    """Two kernels in two files, a module that one of them takes a constant from, and one that none reads."""
    texts = {
        "inner.py": "from numba import njit\n", "outer.py": "from numba import njit\nfrom moc_opt.inner import f\n"
        "from moc_opt.sub.constants import C\n", "sub/constants.py": "C = 1\n", "plain.py": "x = 1\n",
    }  # fmt: skip
    for name, text in texts.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
        os.utime(tmp_path / name, (100.0, 100.0))
    (tmp_path / "__pycache__").mkdir()
    for name in ("outer.f-1.py311.nbi", "outer.f-1.py311.1.nbc", "outer.cpython-311.pyc"):
        (tmp_path / "__pycache__" / name).write_text("")
        os.utime(tmp_path / "__pycache__" / name, (200.0, 200.0))
    return tmp_path


def test_nothing_is_stale_while_nothing_changes(package):
    assert stale_kernels(package) == []


@pytest.mark.parametrize("name", ["inner.py", "outer.py", "sub/constants.py"])
def test_what_a_kernel_may_come_from_makes_it_stale(name, package):
    os.utime(package / name, (300.0, 300.0))
    assert {path.suffix for path in stale_kernels(package)} == {".nbi", ".nbc"}


def test_what_no_kernel_reads_does_not(package):
    os.utime(package / "plain.py", (300.0, 300.0))
    assert stale_kernels(package) == []

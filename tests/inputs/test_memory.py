"""How much memory is free: of the machine, of the process's limits and of its control group."""

import subprocess
import sys
from pathlib import Path

import pytest

from moc_opt.inputs import memory

ROOT = Path(__file__).resolve().parents[2]


def test_a_limit_of_the_process_counts():
    code = (
        "import resource; from moc_opt.inputs.memory import available_bytes as a\n"
        "x = a(); resource.setrlimit(resource.RLIMIT_{}, (2**30, 2**30)); print(x, a())"
    )
    for limit in ("AS", "DATA"):
        done = subprocess.run(
            [sys.executable, "-c", code.format(limit)], cwd=ROOT, capture_output=True, text=True,
            check=True,
        )  # fmt: skip
        free, within = map(int, done.stdout.split())
        assert within < 2**30
        assert free > within > 0


@pytest.mark.parametrize(("limit", "free"), [("max", 2**33), ("4294967296", 2**31), ("1024", 0)])
def test_a_control_group_counts(limit, free, tmp_path, monkeypatch):
    (tmp_path / "memory.max").write_text(limit + "\n")
    (tmp_path / "memory.current").write_text(str(2**31))
    monkeypatch.setattr(memory, "_CGROUP", tmp_path)
    monkeypatch.setattr(memory, "_kilobytes", lambda path: {"MemAvailable": 2**33})
    assert memory.available_bytes() == free


def test_where_nothing_is_known_there_is_no_limit(tmp_path, monkeypatch):
    monkeypatch.setattr(memory, "_CGROUP", tmp_path / "none")
    monkeypatch.setattr(memory, "_kilobytes", lambda path: {})
    assert memory.available_bytes() == 2**62

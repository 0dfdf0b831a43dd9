"""The real command, killed: whatever dies and whenever, the final table has the same bytes."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

ROOT = Path(__file__).resolve().parents[3]
RUNS = 24
SWEEP = """
seeds = 3
solvers = ["dcac", "exact"]
[grid]
control.regularization = [1e-6, 1e-4]
[random]
samples = 2
[random.fields]
plant.mass_error = { low = 0.0, high = 0.3 }
[scenario]
duration_s = 2.0
judge = false
bound_samples = 0
"""


def begin(folder: Path, out: str, workers: int = 2) -> subprocess.Popen[str]:
    """The command, in a session of its own."""
    (folder / "sweep.toml").write_text(SWEEP)
    command = [
        sys.executable,
        "-m",
        "benchmarks.sweep",
        str(folder / "sweep.toml"),
        "--out",
        str(folder / out),
    ]
    return subprocess.Popen(
        [*command, "--workers", str(workers)], cwd=ROOT, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True,
    )  # fmt: skip


def finished(process: subprocess.Popen[str]) -> tuple[int, str]:
    """Wait for it."""
    out, err = process.communicate(timeout=600)
    return process.returncode, out + err


def family(pid: int) -> dict[int, str]:
    """Living processes of a session, with their command lines."""
    found = {}
    for entry in Path("/proc").iterdir():
        try:
            if entry.name.isdigit() and os.getsid(int(entry.name)) == pid:
                state = (entry / "stat").read_text().rpartition(")")[2].split()[0]
                if state != "Z":
                    found[int(entry.name)] = (entry / "cmdline").read_text().replace("\0", " ")
        except (OSError, ProcessLookupError):
            continue  # it ended while we looked
    return found


def done(folder: Path) -> int:
    """Runs that are finished."""
    return len(list((folder / "runs").glob("*.json"))) if folder.exists() else 0


def wait_for(process: subprocess.Popen[str], folder: Path, runs: int) -> bool:
    """Until so many runs are finished; False where the command ended before."""
    for _ in range(60_000):
        if process.poll() is not None:
            return False
        if done(folder) >= runs:
            return True
        time.sleep(0.01)
    raise AssertionError("the sweep does not get on")


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """rows.parquet of the sweep that nothing disturbs, on one worker."""
    folder = tmp_path_factory.mktemp("reference")
    code, said = finished(begin(folder, "out", workers=1))
    assert code == 0, said
    errors = pq.read_table(folder / "out" / "rows.parquet")["error"]
    assert (len(errors), errors.null_count) == (RUNS, RUNS)
    return (folder / "out" / "rows.parquet").read_bytes()


def test_killed_several_times_the_sweep_goes_on_to_the_same_bytes(reference: bytes, tmp_path: Path) -> None:
    rng, out, kills, before = np.random.default_rng(7), tmp_path / "out", 0, 0
    for _ in range(2):
        process = begin(tmp_path, "out")
        if not wait_for(process, out, before + int(rng.integers(1, 4))):
            break
        time.sleep(rng.uniform(0.0, 0.05))
        process.send_signal(signal.SIGKILL)
        process.wait()
        process.communicate()
        kills += 1
        for _ in range(6000):
            if not family(process.pid):
                break
            time.sleep(0.01)
        assert not family(process.pid), "workers outlive the command that was killed"
        assert done(out) >= before
        assert not (out / "rows.parquet").exists() or (out / "rows.parquet").read_bytes() == reference
        before = done(out)
    assert kills  # a machine that is too busy to be killed twice has been killed once
    code, said = finished(begin(tmp_path, "out"))
    assert code == 0, said
    assert f"going on: {before} of {RUNS} runs are finished" in said
    assert (out / "rows.parquet").read_bytes() == reference


def test_killed_workers_cost_nothing_but_time(reference: bytes, tmp_path: Path) -> None:
    process = begin(tmp_path, "out")
    for runs in (1, 6):
        assert wait_for(process, tmp_path / "out", runs)
        workers = [pid for pid, line in family(process.pid).items() if "spawn_main" in line]
        assert workers
        os.kill(workers[0], signal.SIGKILL)
    code, said = finished(process)
    assert code == 0, said
    assert (tmp_path / "out" / "rows.parquet").read_bytes() == reference


@pytest.mark.skipif(
    os.geteuid() != 0 or shutil.which("mount") is None, reason="only root may mount a small disk"
)
def test_a_full_disk_is_said_and_survived(reference: bytes, tmp_path: Path) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(disk)], check=False)
    if mounted.returncode:
        pytest.skip("no disk can be mounted here")
    try:
        code, said = finished(begin(tmp_path, "disk/out", workers=1))
        assert code == 2
        assert "StoreError" in said
        assert "No space left on device" in said
        assert "Traceback" not in said
        kept = done(disk / "out")
        assert 0 < kept < RUNS
        assert f"{kept} of {RUNS} runs are safe" in said
        assert not list(disk.rglob("*.parquet"))
        subprocess.run(["mount", "-o", "remount,size=32m", str(disk)], check=True)
        code, said = finished(begin(tmp_path, "disk/out", workers=1))
        assert code == 0, said
        assert f"going on: {kept} of {RUNS}" in said
        assert (disk / "out" / "rows.parquet").read_bytes() == reference
    finally:
        subprocess.run(["umount", str(disk)], check=False)

"""The engine of a sweep: errors are rows, dead workers cost only their run, defects stop it."""

from __future__ import annotations

import errno
import os
import time
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from benchmarks import sweep
from benchmarks.sweeps import engine
from benchmarks.sweeps.errors import WorkerError
from benchmarks.sweeps.local import LocalPool
from benchmarks.sweeps.plan import Plan
from tests.sweeps import Here, config, do, made_up


def moody(table: Any, limit_s: float) -> dict[str, Any]:
    """Dies for one scenario, always; has a bad day at another, once; the machine fails at a third, always."""
    place = (table["control"]["regularization"], table["plant"]["mass_error"], table["seed"])
    if place == (1e-6, 0.0, 0):
        raise ChildProcessError
    if place == (1e-5, 0.0, 0) and not Path(os.environ["MOODY"]).exists():
        Path(os.environ["MOODY"]).touch()
        raise MemoryError
    if place == (1e-4, 0.0, 0):
        raise OSError(errno.EIO, "Input/output error")
    return made_up(table, limit_s)


def test_a_run_that_kills_its_worker_is_given_up_and_tried_again_next_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MOODY", str(tmp_path / "moody"))
    plan = Plan(config())
    do(plan, tmp_path / "sweep", moody)
    errors = pq.read_table(tmp_path / "sweep" / "rows.parquet")["error"].to_pylist()
    assert errors[0].startswith("WorkerError: given up after 2 attempts: the worker died")
    assert "Input/output error" in errors[8]
    assert [i for i, error in enumerate(errors) if error and i not in (0, 8)] == [3, 7, 11]
    again: list[int] = []
    do(plan, tmp_path / "sweep", todo=lambda left: again.extend(left) or left)
    assert again == [0, 8]
    assert pq.read_table(tmp_path / "sweep" / "rows.parquet")["error"].to_pylist()[0] is None


def test_a_bad_disk_takes_no_worker_down() -> None:
    tables = [Plan(config()).scenario(i).model_dump(mode="json") for i in range(12)]
    pool, kept, bad = Here(), list[int](), iter([True])

    def work(table: Any, limit_s: float) -> dict[str, Any]:
        if next(bad, False):
            raise OSError(errno.EIO, "Input/output error")
        return made_up(table, limit_s)

    assert (
        engine.run_all(pool, range(12), tables.__getitem__, lambda i, _: kept.append(i), 1.0, work)
        == {}
    )
    assert sorted(kept) == list(range(12))


def test_workers_that_only_die_stop_the_sweep(tmp_path: Path) -> None:
    def die(table: Any, limit_s: float) -> dict[str, Any]:
        raise ChildProcessError("gone")

    with pytest.raises(WorkerError, match="died 11 times without a finished run"):
        do(Plan(config()), tmp_path, die)


def test_another_version_or_a_defect_of_a_worker_stops_the_sweep(tmp_path: Path) -> None:
    with pytest.raises(WorkerError, match="another moc_opt"):
        do(Plan(config()), tmp_path, lambda *job: {**made_up(*job), "version": "0.0.0"})
    with pytest.raises(WorkerError, match=r"cannot do run [01]: KeyError"):
        do(Plan(config()), tmp_path, lambda table, limit_s: table["nothing"])


def test_errors_of_a_run_are_its_row(monkeypatch: pytest.MonkeyPatch) -> None:
    table = Plan(config()).scenario(0).model_dump(mode="json")
    good = engine.execute(table, 60.0)
    assert good["error"] is None
    assert good["figures"]["tip_error_max_mm"] >= 0.0
    assert good["wall_s"] > 0.0
    bad = engine.execute({**table, "trocar": {**table["trocar"], "depth_m": 5.0}}, 60.0)
    assert bad["error"].startswith("ScenarioError: [trocar] depth_m = 5.0")
    assert bad["figures"] == {}
    monkeypatch.setattr(engine.scenario, "run", lambda scenario: 1 / 0)
    assert engine.execute(table, 60.0)["error"] == "unexpected ZeroDivisionError: division by zero"


def hangs_or_kills(table: Any, limit_s: float) -> dict[str, Any]:
    """In a worker: one run hangs, one is killed once from outside, one once meets a bad disk, the others work."""
    marker = Path(os.environ["MOODY"])
    if table["seed"] == 1 and not marker.exists():
        marker.touch()
        os.kill(os.getpid(), 9)
    if table["seed"] == 6 and not marker.with_suffix(".io").exists():
        marker.with_suffix(".io").touch()
        raise OSError(errno.EIO, "Input/output error")
    if table["seed"] == 2:
        engine.scenario.run = lambda scenario: time.sleep(60)
        return engine.execute(table, limit_s)
    return made_up({**table, "seed": 0}, limit_s)


class Impatient(LocalPool):
    """Gives up early: the test is to be short."""

    attempts = 2


def test_processes_that_hang_or_are_killed_cost_only_their_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MOODY", str(tmp_path / "moody"))
    asked = config(seeds=7, grid={"control.regularization": [1e-6]}, run_limit_s=2.0)
    lost = sweep.sweep(asked, tmp_path / "sweep", Impatient(2), hangs_or_kills)
    assert list(lost) == [2]
    errors = pq.read_table(tmp_path / "sweep" / "rows.parquet")["error"].to_pylist()
    assert [i for i, error in enumerate(errors) if error] == [2]
    assert "took more than 2 s" in errors[2]


def test_workers_are_counted() -> None:
    with pytest.raises(WorkerError, match="one or more"):
        LocalPool(0)
    assert (LocalPool(1).shared, LocalPool(2).shared) == (False, True)

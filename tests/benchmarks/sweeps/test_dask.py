"""The same sweep on Dask's workers: the same bytes, also when one of them is killed."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from benchmarks import sweep
from benchmarks.sweeps.dask import DaskPool
from benchmarks.sweeps.errors import WorkerError
from benchmarks.sweeps.local import LocalPool
from tests.sweeps import TINY, config

distributed = pytest.importorskip("distributed", reason="pip install 'moc-opt[cluster]'")


LONG = {**TINY, "duration_s": 2.0}  # runs that something can happen to before all of them are over


def loopback(folder: Path, **changes: Any) -> Any:
    """A scheduler and two workers that nobody outside this machine can reach, without pages."""
    options: dict[str, Any] = {
        "n_workers": 2, "threads_per_worker": 1, "processes": True, "host": "127.0.0.1", "silence_logs": 50,
        "dashboard_address": None, "worker_dashboard_address": None, "local_directory": str(folder),
        "scheduler_kwargs": {"dashboard": False, "dashboard_address": "127.0.0.1:0"},
    }  # fmt: skip
    return distributed.LocalCluster(**{**options, **changes})


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """Worker processes, each under a nanny that replaces it."""
    with loopback(tmp_path_factory.mktemp("dask")) as made:
        yield made


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """rows.parquet of the same sweep on one local process."""
    folder = tmp_path_factory.mktemp("reference")
    assert sweep.sweep(config(scenario=LONG), folder, LocalPool(1)) == {}
    return (folder / "rows.parquet").read_bytes()


def pids(cluster: Any) -> list[int]:
    """Of the workers."""
    with distributed.Client(cluster, set_as_default=False) as client:
        return list(client.run(os.getpid).values())


def test_one_flag_moves_the_sweep_to_a_cluster_where_a_worker_is_killed(
    cluster: Any, reference: bytes, tmp_path: Path, capsys: Any
) -> None:
    before, out = pids(cluster), tmp_path / "out"

    def kill() -> None:
        while not list(out.glob("runs/*.json")):
            time.sleep(0.01)
        os.kill(before[0], signal.SIGKILL)

    file = tmp_path / "sweep.toml"
    file.write_text(
        'seeds = 2\nsolvers = ["exact"]\n[grid]\ncontrol.regularization = [1e-6, 1e-5, 1e-4]\n'
        'plant.mass_error = [0.0, 0.1]\n'
        "[scenario]\nduration_s = 2.0\njudge = false\nbound_samples = 0\n"
    )
    killer = threading.Thread(target=kill, daemon=True)
    killer.start()
    code = sweep.main([str(file), "--out", str(out), "--scheduler", cluster.scheduler_address])
    killer.join(5.0)
    assert code == 0, capsys.readouterr().err
    assert not killer.is_alive()
    assert before[0] not in pids(cluster)
    assert (out / "rows.parquet").read_bytes() == reference
    assert pq.read_table(out / "clock.parquet")["timing_shared"].to_pylist() == [True] * 12


def test_a_scheduler_that_goes_away_is_said_and_the_sweep_goes_on_at_home(
    reference: bytes, tmp_path: Path
) -> None:
    made = loopback(tmp_path / "dask", n_workers=1, processes=False, protocol="tcp")
    out = tmp_path / "out"

    def leave() -> None:
        while not list(out.glob("runs/*.json")):
            time.sleep(0.01)
        made.close()

    leaver = threading.Thread(target=leave, daemon=True)
    leaver.start()
    with pytest.raises(WorkerError, match="went away"):
        sweep.sweep(config(scenario=LONG), out, DaskPool(made.scheduler_address))
    leaver.join(20.0)
    assert 0 < len(list(out.glob("runs/*.json"))) < 12
    assert sweep.sweep(config(scenario=LONG), out, LocalPool(1)) == {}
    assert (out / "rows.parquet").read_bytes() == reference


def test_nobody_at_the_address_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("benchmarks.sweeps.dask.CONNECT_S", 0.5)
    with pytest.raises(WorkerError, match=r"no Dask scheduler answers at tcp://127.0.0.1:9"):
        sweep.sweep(config(), tmp_path, DaskPool("tcp://127.0.0.1:9"))
    with pytest.raises(WorkerError, match="no Dask scheduler answers at nonsense://"):
        sweep.sweep(config(), tmp_path, DaskPool("nonsense://x"))


def test_too_few_workers_are_said(cluster: Any, tmp_path: Path) -> None:
    pool = DaskPool(cluster.scheduler_address, workers=9, patience_s=0.5)
    with pytest.raises(WorkerError, match="fewer than 9 workers"):
        sweep.sweep(config(), tmp_path, pool)


def test_without_dask_the_cure_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(WorkerError, match=r"pip install 'moc-opt\[cluster\]'"):
        DaskPool("tcp://127.0.0.1:8786")


def test_workers_without_this_package_are_told(
    cluster: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def lacking() -> str:
        raise ModuleNotFoundError("No module named 'benchmarks'")

    monkeypatch.setattr("benchmarks.sweeps.dask._version", lacking)
    with pytest.raises(WorkerError, match="install this checkout there too"):
        sweep.sweep(config(), tmp_path, DaskPool(cluster.scheduler_address))
    monkeypatch.setattr("benchmarks.sweeps.dask._version", lambda: "0.0.0")
    with pytest.raises(WorkerError, match=r"has moc_opt 0\.0\.0"):
        sweep.sweep(config(), tmp_path, DaskPool(cluster.scheduler_address))

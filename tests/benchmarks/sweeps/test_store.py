"""The folder of a sweep: killed, full, damaged or foreign, nothing is lost or taken for whole."""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from benchmarks.sweeps import store as sweep_store
from benchmarks.sweeps import table
from benchmarks.sweeps.errors import StoreError
from benchmarks.sweeps.plan import Plan
from benchmarks.sweeps.record import owner
from benchmarks.sweeps.store import Store
from tests.sweeps import GRID, config, do, made_up


@pytest.fixture
def small_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    """Shards of 3 runs and row groups of 5, so that 12 runs meet every border."""
    monkeypatch.setattr(sweep_store, "SHARD", 3)
    for module in (sweep_store, table):
        monkeypatch.setattr(module, "BLOCK", 5)


@pytest.fixture
def whole(small_pieces: None, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """rows.parquet of the sweep that nothing disturbs."""
    return do(Plan(config()), tmp_path_factory.mktemp("whole") / "sweep")[0]


def test_the_tables_hold_the_plan_and_the_figures(whole: bytes, tmp_path: Path) -> None:
    plan = Plan(config())
    do(plan, tmp_path)
    rows = pq.read_table(tmp_path / "rows.parquet")
    assert rows["index"].to_pylist() == list(range(12))
    assert rows["run"].to_pylist() == [plan.run_id(i) for i in range(12)]
    assert rows["control.regularization"].to_pylist()[::4] == GRID["control.regularization"]
    assert rows["mu_mean"].to_pylist()[:3] == [1e-6, 1.0 + 1e-6, 0.1 + 1e-6]
    assert rows["error"].to_pylist()[3] == "SolverError: made up"
    assert rows["mu_mean"].to_pylist()[3] is None
    assert rows["loss_max"].null_count == 12  # NaN is no figure
    assert not {"timing_shared", "wall_s", "tick_p50_us", "deadline_misses"} & set(rows.column_names)
    clock = pq.read_table(tmp_path / "clock.parquet")
    assert {"wall_s", "tick_p50_us", "deadline_misses"} <= set(clock.column_names)
    assert clock["timing_shared"].to_pylist() == [False] * 12


def test_the_order_of_the_runs_leaves_no_trace(whole: bytes, tmp_path: Path) -> None:
    for seed in range(3):
        shuffled = lambda left, seed=seed: np.random.default_rng(seed).permutation(left).tolist()  # noqa: E731
        assert do(Plan(config()), tmp_path / str(seed), todo=shuffled)[0] == whole


class Killed(BaseException):
    """The process was killed: from here on nothing it does reaches the disk."""


@pytest.fixture
def failing(
    monkeypatch: pytest.MonkeyPatch,
) -> Callable[[int, bool, Callable[[], BaseException], bool], None]:
    """Let the n-th step on the disk fail, before or after its effect, for once or for good."""
    replace, unlink = os.replace, Path.unlink

    def arm(n: int, after: bool, error: Callable[[], BaseException], for_good: bool) -> None:
        steps = iter(range(10**9))

        def wrapped(real: Callable[..., None]) -> Callable[..., None]:
            def step(*args: Any, **options: Any) -> None:
                now = next(steps)
                if now == n and after:
                    real(*args, **options)
                if now == n or (for_good and now > n):
                    raise error()
                real(*args, **options)

            return step

        monkeypatch.setattr(os, "replace", wrapped(replace))
        monkeypatch.setattr(Path, "unlink", wrapped(unlink))

    return arm


def test_killed_at_every_step_it_goes_on_to_the_same_bytes(
    whole: bytes, failing: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan, seen = Plan(config()).number_runs(), 0
    for n in range(200):
        for after in (False, True):
            folder = tmp_path / f"{n}{after}"
            failing(n, after, Killed, True)
            try:
                do(plan, folder)
            except Killed:
                seen += 1
                monkeypatch.undo()
                again: list[int] = []
                small(monkeypatch)
                bytes_, dropped = do(plan, folder, todo=lambda left, again=again: again.extend(left) or left)
                assert bytes_ == whole, (n, after)
                assert dropped == []
                assert len(again) <= 12
                assert not list(folder.rglob(".*.*.*")), "a torn file stays"
                continue
            monkeypatch.undo()
            small(monkeypatch)
            assert seen >= 2 * (1 + 12 + 4 + 12 + 2)
            return
    raise AssertionError("the sweep never ends")


def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """See small_pieces."""
    monkeypatch.setattr(sweep_store, "SHARD", 3)
    for module in (sweep_store, table):
        monkeypatch.setattr(module, "BLOCK", 5)


def test_full_disk_at_every_step_is_said_and_survived(
    whole: bytes, failing: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = Plan(config()).number_runs()
    full = lambda: OSError(errno.ENOSPC, "No space left on device")  # noqa: E731
    for n in range(0, 31, 3):
        folder = tmp_path / str(n)
        failing(n, False, full, False)
        with pytest.raises(
            StoreError, match=r"No space left.*of 12 runs are safe.*start the same command again"
        ):
            do(plan, folder)
        monkeypatch.undo()
        small(monkeypatch)
        assert do(plan, folder) == (whole, [])


def test_damaged_files_are_named_and_their_runs_done_again(whole: bytes, tmp_path: Path) -> None:
    plan = Plan(config())
    with Store(tmp_path, plan) as store:
        for i in range(8):  # two shards, two single files
            result = made_up(plan.scenario(i).model_dump(mode="json"), 1.0)
            store.add(
                i, {key: result[key] for key in ("error", "figures", "wall_s")} | {"timing_shared": False}
            )
    shard, *_ = sorted((tmp_path / "shards").iterdir())
    shard.write_bytes(shard.read_bytes()[:-40])
    one, two = sorted((tmp_path / "runs").iterdir())
    one.write_text(one.read_text().replace("timing", "tinimg"))
    two.write_bytes(b"")
    again: list[int] = []
    bytes_, dropped = do(plan, tmp_path, todo=lambda left: again.extend(left) or left)
    assert bytes_ == whole
    assert sorted(dropped) == sorted(map(str, (shard, one, two)))
    assert again == [0, 1, 2, 6, 7, 8, 9, 10, 11]


def test_a_folder_of_another_sweep_is_refused_and_left_alone(whole: bytes, tmp_path: Path) -> None:
    do(Plan(config()), tmp_path)
    other = Plan(config(grid={**GRID, "control.regularization": [1e-3]}, seeds=1))
    with pytest.raises(
        StoreError, match=r"another sweep: grid.control.regularization is \[0.001\] here and \[1e-06"
    ):
        Store(tmp_path, other).__enter__()
    assert (tmp_path / "rows.parquet").read_bytes() == whole
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    (foreign / "rows.parquet").write_bytes(b"mine")
    with pytest.raises(StoreError, match="no sweep's folder"):
        Store(foreign, other).__enter__()
    assert sorted(p.name for p in foreign.iterdir()) == [".lock", "rows.parquet"]


def test_results_of_other_code_are_not_continued(
    whole: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    do(Plan(config()), tmp_path)
    monkeypatch.setattr("benchmarks.sweeps.plan.code_version", lambda: "0.1.0+changed")
    with pytest.raises(StoreError, match=r"moc_opt is '0.1.0\+changed' here and '\d"):
        Store(tmp_path, Plan(config())).__enter__()


def test_one_sweep_at_a_time_owns_a_folder(tmp_path: Path) -> None:
    plan = Plan(config())
    with Store(tmp_path, plan), pytest.raises(StoreError, match="another sweep is writing"):
        Store(tmp_path, plan).__enter__()
    with Store(tmp_path, plan):
        pass


def test_a_folder_that_cannot_be_made_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(StoreError, match="Not a directory"):
        Store(tmp_path / "file" / "sweep", Plan(config())).__enter__()


def filled(folder: Path, plan: Plan, runs: int = 12) -> None:
    """The first runs of a sweep, made up: shards of 3, the rest single files."""
    with Store(folder, plan) as store:
        for i in range(runs):
            result = made_up(plan.scenario(i).model_dump(mode="json"), 1.0)
            store.add(
                i, {key: result[key] for key in ("error", "figures", "wall_s")} | {"timing_shared": False}
            )


@pytest.mark.parametrize("seed", range(40))
def test_whatever_is_damaged_is_set_aside_and_done_again(seed: int, whole: bytes, tmp_path: Path) -> None:
    """Any byte of any file, the plan's and the footers of the shards too: the same rows, without a hand."""
    rng, plan = np.random.default_rng(seed), Plan(config())
    filled(tmp_path, plan, 11)
    files = sorted(p for p in tmp_path.rglob("*") if p.is_file() and p.name != ".lock")
    spoilt = [files[i] for i in rng.choice(len(files), size=int(rng.integers(1, 4)), replace=False)]
    for path in spoilt:
        data = bytearray(path.read_bytes())
        place = int(rng.integers(len(data)))
        how = seed % 4
        if how == 0:
            data[place] ^= int(rng.integers(1, 256))
        elif how == 1:
            del data[place:]
        elif how == 2:
            data[place:place] = rng.bytes(5)
        else:
            data[-1 - place % 40] ^= 1  # of a footer
        path.write_bytes(data)
    bytes_, dropped = do(plan, tmp_path)
    assert bytes_ == whole
    assert sorted(dropped) == sorted(map(str, spoilt))
    assert len(list((tmp_path / "damaged").iterdir())) == len(spoilt)
    assert do(plan, tmp_path) == (whole, [])


@pytest.mark.parametrize("how", ["damaged", "gone", "altered", "a folder"])
def test_a_plan_that_is_lost_does_not_lock_out_finished_runs(how: str, whole: bytes, tmp_path: Path) -> None:
    plan, path = Plan(config()), tmp_path / "plan.json"
    filled(tmp_path, plan)
    if how == "altered":  # still JSON: one digit of a value
        path.write_text(path.read_text().replace("1e-06", "1e-05", 1))
    else:
        path.unlink()
    if how == "damaged":
        path.write_bytes(b'{"digest": Na')
    elif how == "a folder":
        path.mkdir()
    again: list[int] = []
    bytes_, _ = do(plan, tmp_path, todo=lambda left: again.extend(left) or left)
    assert (bytes_, again) == (whole, [])
    assert path.is_file()
    assert do(plan, tmp_path) == (whole, [])


def test_a_damaged_run_says_of_no_other_sweep(whole: bytes, tmp_path: Path) -> None:
    """Its digest was outside the checksum once: a flipped bit there, and no plan, locked the whole folder."""
    plan = Plan(config())
    filled(tmp_path, plan, 11)
    path = next(iter(sorted((tmp_path / "runs").iterdir())))
    data = path.read_bytes()
    for place in range(len(data)):
        path.write_bytes(data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :])
        assert owner(path) in (None, plan.digest)
    place = data.index(plan.digest.encode())
    path.write_bytes(data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :])
    (tmp_path / "plan.json").unlink()
    assert do(plan, tmp_path) == (whole, [str(path)])


def test_without_its_plan_a_folder_of_another_sweep_is_refused_all_the_same(whole: bytes, tmp_path: Path) -> None:
    filled(tmp_path, Plan(config()))
    before = sorted((tmp_path / "shards").iterdir())
    (tmp_path / "plan.json").unlink()
    with pytest.raises(StoreError, match="another sweep"):
        Store(tmp_path, Plan(config(seeds=1))).__enter__()
    assert sorted((tmp_path / "shards").iterdir()) == before


def test_a_shard_of_another_sweep_is_not_taken(whole: bytes, tmp_path: Path) -> None:
    """Whole by its own account, and even of the same runs: its figures are not this sweep's."""
    filled(tmp_path / "mine", Plan(config()))
    filled(tmp_path / "other", Plan(config(scenario={"duration_s": 0.06, "judge": False, "bound_samples": 0})))
    theirs = sorted((tmp_path / "other" / "shards").iterdir())[0]
    ours = sorted((tmp_path / "mine" / "shards").iterdir())[0]
    ours.unlink()
    (ours.parent / theirs.name).write_bytes(theirs.read_bytes())
    bytes_, dropped = do(Plan(config()), tmp_path / "mine")
    assert (bytes_, [Path(path).name for path in dropped]) == (whole, [theirs.name])


def test_a_shard_spoilt_while_the_sweep_runs_is_found(whole: bytes, tmp_path: Path) -> None:
    plan = Plan(config())
    filled(tmp_path, plan)
    with Store(tmp_path, plan) as store:
        assert store.verify() == 0
        shard = sorted((tmp_path / "shards").iterdir())[1]
        shard.write_bytes(shard.read_bytes()[:-1])
        assert store.verify() == 3
        assert np.flatnonzero(~store.done).tolist() == [3, 4, 5]
    assert do(plan, tmp_path)[0] == whole


def test_what_a_sweep_writes_is_json(whole: bytes, tmp_path: Path) -> None:
    def never(name: str) -> None:
        raise AssertionError(name)

    filled(tmp_path, Plan(config()), 2)  # whose figures hold NaN
    files = [*tmp_path.glob("runs/*.json"), tmp_path / "plan.json"]
    assert len(files) == 3
    for path in files:
        found = json.loads(path.read_text(), parse_constant=never)
        json.loads(found.get("record", "{}"), parse_constant=never)

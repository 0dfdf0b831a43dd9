"""What must be true of hostile files, extreme numbers and damaged folders; see `fuzz_case`."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common import store as part_store
from benchmarks.reliability.config import Config as FaultsConfig
from benchmarks.reliability.fuzz_case import ARM_TOML, Kind, Verdict, Wrong, folder, refused
from benchmarks.reliability.fuzz_checks import few_ticks
from benchmarks.reliability.fuzz_files import (
    SHAPES,
    Damage,
    HostileFile,
    damages,
    extreme_numbers,
    hostile_files,
)
from benchmarks.reliability.fuzz_traces import good_trace
from benchmarks.solver_study.config import Config as StudyConfig
from benchmarks.subproblems.testset import TestSet
from benchmarks.sweeps import store as sweep_store
from benchmarks.sweeps.config import Config as SweepConfig
from benchmarks.sweeps.plan import Plan
from moc_opt.commands.running import read_waypoints
from moc_opt.errors import MocOptError
from moc_opt.model.robot_model import load_robot
from moc_opt.scenario import Scenario, Setup
from moc_opt.tasks import Waypoints
from moc_opt.trace.trace import Trace
from moc_opt.trace.writer import TraceWriter, parts_of

NAMES = {"urdf": "arm.urdf", "testset": "file.npz", "plan": "plan.json", "robot": "arm.toml", "part": "key.npz"}


def _read_plan(path: Path) -> None:
    with sweep_store.Store(path.parent, small_plan()):
        pass


def _read_part(path: Path) -> None:
    if part_store.Store(path.parent).get("key") is not None:
        raise Wrong("a part that nobody wrote")


def _read_urdf(path: Path) -> None:
    path.with_suffix(".toml").write_text(ARM_TOML, encoding="utf-8")
    load_robot(path.with_suffix(".toml"))


def _read_waypoints(path: Path) -> None:
    Waypoints(read_waypoints(str(path)), (0.0, 0.0, 0.0), normal=(0.0, 0.0, 1.0), heading=(1.0, 0.0, 0.0))


READ: dict[str, Callable[[Path], Any]] = {
    "scenario": Scenario.load, "sweep": SweepConfig.load, "study": StudyConfig.load, "faults": FaultsConfig.load,
    "robot": load_robot, "urdf": _read_urdf, "trace": Trace.load, "plan": _read_plan, "part": _read_part,
    "replay_us": lambda path: Setup(Scenario(solver={"replay_us": str(path)})),
    "waypoints": _read_waypoints, "testset": lambda path: TestSet.load("file", path.parent),
}  # fmt: skip


def hostile_file(case: HostileFile) -> Verdict:
    """Check a file of any shape for any reader: read, or refused by its name."""
    with folder() as where:
        path = Path(where, NAMES.get(case.reader, "file"))
        SHAPES[case.shape](path, case)
        try:
            with contextlib.redirect_stderr(io.StringIO()):
                READ[case.reader](path)
        except MocOptError as error:
            if len(str(error)) > 2000:
                raise Wrong(f"a message of {len(str(error))} characters") from error
            return refused(error)
    return "accepted"


def extreme_number(case: tuple[str, tuple[tuple[tuple[str, ...], Any], ...]]) -> Verdict:
    """Check numbers at the ends of their range: refused by the field's name before any work, or the run is sound."""
    kind, wanted = case
    table: dict[str, Any] = {}
    for path, value in wanted:
        inner = table
        for name in path[:-1]:
            inner = inner.setdefault(name, {})
        inner[path[-1]] = value
    try:
        if kind == "sweep":
            Plan(SweepConfig(**table))
            return "accepted"
        made = Scenario(**table)
    except MocOptError as error:
        return refused(error, any(name in str(error) for path, _ in wanted for name in path))
    return few_ticks(made)


@cache
def small_plan() -> Plan:
    """Plan eight runs that are not done in earnest."""
    scenario = {"duration_s": 0.05, "judge": False, "bound_samples": 0}
    return Plan(SweepConfig(grid={"control.regularization": [1e-6, 1e-5]}, seeds=4, scenario=scenario)).number_runs()


def _made_up(i: int) -> dict[str, Any]:
    figures = {"mu_mean": 0.1 * i, "loss_max": float("nan")}
    return {"ended": "completed", "error": None, "figures": figures, "timing_shared": False, "wall_s": 1.0}


def _do(folder: Path) -> tuple[bytes, list[str]]:
    """Make up all runs that are not done yet; the final rows, and what was set aside."""
    with sweep_store.Store(folder, small_plan()) as store:
        for i in np.flatnonzero(~store.done).tolist():
            store.add(i, _made_up(i))
        store.finish({})
        return (folder / "rows.parquet").read_bytes(), store.dropped


@contextmanager
def _small_shards() -> Iterator[None]:
    before, sweep_store.SHARD = sweep_store.SHARD, 3
    try:
        yield
    finally:
        sweep_store.SHARD = before


def sweep_folder(case: Sequence[Damage]) -> Verdict:
    """Check that a sweep whose files are corrupted goes on to the same rows, by itself."""
    with folder() as where, _small_shards():
        whole, _ = _do(where / "whole")
        with sweep_store.Store(where / "corrupted", small_plan()) as store:
            for i in range(7):
                store.add(i, _made_up(i))
        _corrupt(where / "corrupted", case)
        rows, _ = _do(where / "corrupted")
        if rows != whole:
            raise Wrong("other rows than those of the sweep that nothing disturbed")
    return "accepted"


def study_folder(case: Sequence[Damage]) -> Verdict:
    """Check that a part of the study that is corrupted is none; one that is returned is what was kept."""
    values = {"a": 1.5, "b": [1, 2], "c": None}
    arrays = {"x": np.arange(40.0).reshape(8, 5), "t": np.array(["a", "bc"])}
    with folder() as where:
        store = part_store.Store(where)
        for key in ("one", "two"):
            store.put(key, part_store.Part(values, arrays))
        before = {path.name: path.read_bytes() for path in where.iterdir()}
        _corrupt(where, case)
        sound = {file for file, data in before.items() if _holds(where / file, data)}
        with contextlib.redirect_stderr(io.StringIO()):
            found = {key: part_store.Store(where).get(key) for key in ("one", "two")}
    for key, part in found.items():
        if (part is not None) != (f"{key}.npz" in sound):
            raise Wrong(f"{key} is {'taken' if part else 'refused'}, and it is {'not ' if part else ''}what was kept")
        if part is not None and not (
            part.values == values and all(np.array_equal(part.arrays.get(n, ()), array) for n, array in arrays.items())
        ):
            raise Wrong("another part than the one that was kept")
    return "accepted" if sound else "refused"


def _holds(path: Path, data: bytes) -> bool:
    return path.is_file() and path.read_bytes() == data


def trace_folder(case: Sequence[Damage]) -> Verdict:
    """Check what a killed run left, corrupted: its rows, or a refusal; and another run of that name can write."""
    trace = good_trace()[0]
    with folder() as where:
        target = where / "run.parquet"
        with TraceWriter(target, {"period_s": 0.002}) as writer:
            for first in range(0, 20, 5):
                writer.write(first, {n: array[first : first + 5] for n, array in trace.columns.items()})
        _corrupt(parts_of(target), case)
        verdict: Verdict = "accepted"
        try:
            found = Trace.load(target)
            if not set(found.t_s.tolist()) <= set(trace.t_s.tolist()):
                raise Wrong("rows that nobody wrote")
        except MocOptError:
            verdict = "refused"
        with TraceWriter(target, {}) as writer:
            writer.write(0, dict(trace.columns))
            writer.finish({"ended": "completed"})
        if Trace.load(target).q_rad.tobytes() != trace.q_rad.tobytes():
            raise Wrong("the next run's rows are not what it wrote")
    return verdict


def _corrupt(folder: Path, damages: Sequence[Damage]) -> None:
    """Damage files, whichever are there."""
    for damage in damages:
        files = sorted(path for path in folder.rglob("*") if path.is_file() and path.name != ".lock")
        if not files:
            return
        path = files[damage.file % len(files)]
        data = bytearray(path.read_bytes())
        place = round(damage.where * max(len(data) - 1, 0))
        if damage.how == "flip":
            data[place : place + len(damage.bytes_)] = damage.bytes_
        elif damage.how == "cut":
            del data[place:]
        elif damage.how == "insert":
            data[place:place] = damage.bytes_
        elif damage.how == "empty":
            data.clear()
        elif damage.how == "replace":
            data[:] = damage.bytes_
        path.unlink()
        if damage.how == "folder":
            path.mkdir()
        elif damage.how != "delete":
            path.write_bytes(data)


KINDS = {
    "hostile_file": Kind(hostile_file, hostile_files()), "extreme_number": Kind(extreme_number, extreme_numbers()),
    "sweep_folder": Kind(sweep_folder, damages), "study_folder": Kind(study_folder, damages),
    "trace_folder": Kind(trace_folder, damages),
}  # fmt: skip

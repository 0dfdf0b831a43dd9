"""A finished sweep in numbers, read in batches: memory stays the same however many rows there are.

Quantiles come from a histogram with logarithmic buckets, as in DDSketch (Masson, Rim and Lee, PVLDB 12, 2019): each
is within ``ACCURACY`` of a value of the data, relative, whatever the distribution and the order of the rows.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from benchmarks.sweeps.errors import StoreError, SweepError
from benchmarks.sweeps.table import PLAN_KEY
from moc_opt.errors import UnknownNameError
from moc_opt.numerics.arrays import Array
from moc_opt.trace.ending import Ending

BATCH = 8192
BUFFER = 1 << 16  # bytes of a column read at a time
MAX_GROUPS = 200
ACCURACY = 0.01
QUANTILES = {"p05": 0.05, "p50": 0.50, "p95": 0.95}
SHARED = "timing_shared"
KEYS = ("index", "run", "solver", "seed", "ended", "error", SHARED)
ENDINGS = (Ending.STOPPED.value, Ending.OSCILLATED.value)

_GAMMA = (1.0 + ACCURACY) / (1.0 - ACCURACY)
_SMALLEST, _LARGEST = 1e-15, 1e9  # magnitudes between which a quantile is told apart from 0 and infinity
_HALF = math.ceil(math.log(_LARGEST / _SMALLEST) / math.log(_GAMMA)) + 1
BUCKETS = 2 * _HALF + 1  # negative, zero, positive


def summarise(
    folder: Path, by: Sequence[str] = ("solver",), table: str = "rows", alone: bool = False
) -> dict[str, dict[str, Any]]:
    """Count runs, failures, and for each metric {count, mean, min, max, p05, p50, p95}, in groups.

    Runs that were stopped are counted, and enter no metric: theirs are figures of a part.

    Args:
        by: columns whose values make the groups.
        table: "rows" or "clock".
        alone: only runs whose times were taken with no other run on the machine.

    Returns:
        "value, value" of the columns ``by`` -> {"runs": .., "failed": .., "stopped": .., "oscillated": ..,
        metric: {..}}, in order of appearance.

    Raises:
        StoreError: the sweep is not finished, or its table is damaged.
        UnknownNameError: no such column.
        SweepError: more than MAX_GROUPS groups.
    """
    path = folder / f"{table}.parquet"
    if not path.exists():
        raise StoreError(f"{path}: no such file; a sweep that is not finished has none, start it again")
    try:
        with _opened(path) as data:
            names = data.schema_arrow.names
            for name in by:
                if name not in names:
                    raise UnknownNameError("column", name, names)
            metrics = figure_columns(data.schema_arrow, by)
            groups = Groups(metrics)
            beside = [name for name in ("ended", "error", SHARED) if name in names and name not in by]
            for batch in _batches(data, [*by, *beside, *metrics]):
                groups.add(batch.filter(pc.invert(batch.column(SHARED))) if alone else batch, by)
    except (OSError, pa.ArrowException) as error:
        raise StoreError(f"{path}: damaged, or not of a sweep: {error}") from error
    return groups.summary()


def errors(folder: Path, most: int = 20) -> dict[str, dict[str, int]]:
    """Return the errors of a finished sweep and how many runs each ended, the commonest first.

    Args:
        most: so many errors; of a sweep whose messages all differ only the first 1000 are told apart.
    """
    counted: Counter[str] = Counter()
    with _opened(folder / "rows.parquet") as data:
        for batch in _batches(data, ["error"]):
            for text in batch.column("error").drop_null().to_pylist():
                counted[text if text in counted or len(counted) < 1000 else "others"] += 1
    return {text: {"runs": runs} for text, runs in counted.most_common(most)}


def figure_columns(schema: pa.Schema, but: Sequence[str] = ()) -> list[str]:
    """Return the metrics among the columns: numbers that are neither a key nor a swept field."""
    if PLAN_KEY not in (schema.metadata or {}):
        raise StoreError("a Parquet file, but not of a sweep")
    names = schema.names
    first = names.index("error") if "error" in names else names.index(SHARED)
    return [name for name in names[first + 1 :] if name not in but and name not in KEYS]


def _opened(path: Path) -> pq.ParquetFile:
    return pq.ParquetFile(path, buffer_size=BUFFER, pre_buffer=False)


def _batches(data: pq.ParquetFile, columns: list[str]) -> Iterator[pa.RecordBatch]:
    # In this thread and one at a time: a scanner reads ahead in others, as far as the machine lets it.
    yield from data.iter_batches(batch_size=BATCH, columns=columns, use_threads=False)


class Groups:
    """Running figures of every metric in every group."""

    def __init__(self, metrics: list[str]) -> None:
        self.metrics, m = metrics, len(metrics)
        self._place: dict[tuple[Any, ...], int] = {}
        self._runs, self._failed, self._ended = np.zeros(0), np.zeros(0), np.zeros((0, len(ENDINGS)))
        self._count, self._total, self._min, self._max = (np.zeros((0, m)) for _ in range(4))
        self._histogram: NDArray[np.int32] = np.zeros((0, m, BUCKETS), dtype=np.int32)

    def add(self, batch: pa.RecordBatch, by: Sequence[str]) -> None:
        """Take in some rows.

        Raises:
            SweepError: they make too many groups.
        """
        keys = list(zip(*(batch.column(name).to_pylist() for name in by), strict=True))
        place = np.array([self._place.setdefault(key, len(self._place)) for key in keys], dtype=np.int64)
        self._grow()
        np.add.at(self._runs, place, 1.0)
        if "error" in batch.schema.names:
            failed = batch.column("error").is_valid().to_numpy(zero_copy_only=False)
            np.add.at(self._failed, place, failed.astype(np.float64))
        stopped = np.zeros(len(place), dtype=np.bool_)
        if "ended" in batch.schema.names:
            for e, ending in enumerate(ENDINGS):
                begins = pc.fill_null(pc.starts_with(batch.column("ended"), ending), False)
                is_so = begins.to_numpy(zero_copy_only=False)
                np.add.at(self._ended[:, e], place[is_so], 1.0)
                stopped |= is_so & (ending == "stopped")
        for m, name in enumerate(self.metrics):
            values = batch.column(name).to_numpy(zero_copy_only=False).astype(np.float64)
            there = np.isfinite(values) & ~stopped
            values, where = values[there], place[there]
            np.add.at(self._count[:, m], where, 1.0)
            np.add.at(self._total[:, m], where, values)
            np.minimum.at(self._min[:, m], where, values)
            np.maximum.at(self._max[:, m], where, values)
            np.add.at(self._histogram[:, m], (where, bucket(values)), 1)

    def summary(self) -> dict[str, dict[str, Any]]:
        """See :func:`summarise`; metrics that a group does not have are left out."""
        found: dict[str, dict[str, Any]] = {}
        for key, g in self._place.items():
            figures: dict[str, Any] = {"runs": int(self._runs[g]), "failed": int(self._failed[g])}
            figures |= {ending: int(self._ended[g, e]) for e, ending in enumerate(ENDINGS)}
            for m, name in enumerate(self.metrics):
                count = self._count[g, m]
                if count == 0.0:
                    continue
                low, high = float(self._min[g, m]), float(self._max[g, m])
                figures[name] = {
                    "count": int(count), "mean": float(self._total[g, m] / count), "min": low, "max": high,
                    **{q: min(max(quantile(self._histogram[g, m], p), low), high) for q, p in QUANTILES.items()},
                }  # fmt: skip
            found[", ".join(map(str, key))] = figures
        return found

    def _grow(self) -> None:
        more = len(self._place) - len(self._runs)
        if len(self._place) > MAX_GROUPS:
            raise SweepError(f"more than {MAX_GROUPS} groups: summarise by columns with fewer values")
        if more:
            for name in ("_runs", "_failed", "_ended", "_count", "_total", "_min", "_max", "_histogram"):
                array, fill = getattr(self, name), {"_min": np.inf, "_max": -np.inf}.get(name, 0)
                grown = np.full((more, *array.shape[1:]), fill, dtype=array.dtype)
                setattr(self, name, np.concatenate([array, grown]))


def bucket(values: Array) -> NDArray[np.int64]:
    """Return the bucket of each value, 0 .. BUCKETS - 1, in the order of the values."""
    size = np.clip(np.abs(values), _SMALLEST, _LARGEST)
    step = np.ceil(np.log(size / _SMALLEST) / math.log(_GAMMA)).astype(np.int64)
    return _HALF + np.where(values == 0.0, 0, np.sign(values).astype(np.int64) * np.clip(step, 1, _HALF))


def quantile(histogram: NDArray[np.int32], p: float) -> float:
    """Return the value below which a fraction ``p`` lies, to ACCURACY."""
    counts = np.cumsum(histogram, dtype=np.int64)
    place = int(np.searchsorted(counts, p * (int(counts[-1]) - 1), side="right")) - _HALF
    if place == 0:
        return 0.0
    # The middle, in relative terms, of (gamma^(k-1), gamma^k].
    return math.copysign(_SMALLEST * _GAMMA ** abs(place) * 2.0 / (1.0 + _GAMMA), place)

"""Traces that are sound files of foreign contents: the pages and tables made of them show it, or it is refused."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator
from functools import cache
from typing import Any

import hypothesis.strategies as st
import numpy as np
from numpy.typing import NDArray

from benchmarks.reliability.fuzz_case import Kind, Verdict, Wrong, folder, refused
from benchmarks.reliability.fuzz_inputs import junk
from moc_opt.errors import MocOptError
from moc_opt.report.run_table import part, refusals, run_json, run_table, warnings
from moc_opt.report.runs import load_runs
from moc_opt.scenario import Scenario, run
from moc_opt.trace.metrics import summarize
from moc_opt.trace.trace import Trace

Columns = dict[str, NDArray[Any]]
Place = tuple[str | int, ...]

_MARK = "\x1b[2J<script>alert(1)</script>\u202e"
_ENTRIES = st.one_of(
    junk, st.sampled_from([_MARK, "a" * 100_000, [0] * 10_000, 1e308, 1e-320, 2**62, "/etc/passwd", [[]], {"": {}}])
)
_NUMBERS = st.sampled_from([0.0, np.nan, np.inf, -np.inf, 1e308, -1e308, 5e-324, 1e-320])


@cache
def _sound() -> tuple[Columns, dict[str, Any], list[Place]]:
    """Return a run's columns and meta, refusals, warnings and restarts among it, and every place in the latter."""
    trace = run(Scenario(duration_s=0.04, bound_samples=2, faults={"solver": "raise", "solver_share": 0.5}))
    meta = json.loads(json.dumps(dict(trace.meta)))
    meta["warnings"] = [{"of": "the RCM error", "unit": "m", "level": 6e-3, "first_s": 0.1, "largest": 8e-3}]
    meta["restarts"] = [{"at_s": 0.1, "reason": "it hung"}]
    return dict(trace.columns), meta, [place for place in _places(meta) if place]


def _places(value: Any, before: Place = ()) -> Iterator[Place]:
    yield before
    pairs = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, entry in pairs:
        yield from _places(entry, (*before, key))


@st.composite
def _corrupted(draw: st.DrawFn) -> list[tuple[str, Any, Any]]:
    """Draw what is changed: ("meta", place, value or None to leave it out) or ("column", name, how)."""
    columns, _, places = _sound()
    meta = st.tuples(st.just("meta"), st.sampled_from(places), st.one_of(st.none(), _ENTRIES))
    how = st.one_of(st.sampled_from(["gone", "backwards", "text", "one", "nothing"]), _NUMBERS, st.tuples(_NUMBERS))
    column = st.tuples(st.just("column"), st.sampled_from(sorted(columns)), how)
    return draw(st.lists(st.one_of(meta, column), min_size=1, max_size=3))


def _trace(case: list[tuple[str, Any, Any]]) -> Trace:
    columns, meta, _ = _sound()
    columns, meta = dict(columns), copy.deepcopy(meta)
    for kind, where, value in case:
        if kind == "column":
            _change(columns, where, value)
            continue
        table: Any = meta
        try:
            for key in where[:-1]:
                table = table[key]
            if value is None:
                del table[where[-1]]
            else:
                table[where[-1]] = value
        except (KeyError, IndexError, TypeError):
            continue  # what it lay in was changed before
    return Trace(columns, meta)


def _change(columns: Columns, name: str, how: Any) -> None:
    if name not in columns:
        return
    column = np.array(columns[name])
    if how == "gone":
        del columns[name]
    elif how == "backwards":
        columns[name] = column[::-1]
    elif how == "text":
        columns[name] = np.full(len(column), _MARK)
    elif how in ("one", "nothing"):
        columns |= {key: values[: how == "one"] for key, values in columns.items()}
    elif column.dtype.kind == "f":
        column[slice(1, 2) if isinstance(how, tuple) else slice(None)] = how[0] if isinstance(how, tuple) else how
        columns[name] = column


def foreign_trace(case: list[tuple[str, Any, Any]]) -> Verdict:
    """Check a file: its metrics, its table, its sentences and its JSON; or one error, short and without control marks.

    Raises:
        Wrong: a text of the file steers the terminal or the page.
    """
    with folder() as where:
        try:
            _trace(case).save(where / "trace.parquet")
            with np.errstate(all="ignore"):
                traces, _ = load_runs([where / "trace.parquet"])
                (trace,) = traces.values()
                metrics = summarize(trace)
                table = run_table("run", trace, metrics)
                shown = [part(trace), *refusals(trace), *warnings(trace), table.to_text()]
                json.dumps(run_json(trace, metrics))
        except MocOptError as error:
            if len(str(error)) > 2000:
                raise Wrong(f"a message of {len(str(error))} characters") from error
            return refused(error)
    if any("\x1b" in line or "\u202e" in line for line in shown[-1:]):
        raise Wrong("what is printed steers the terminal")
    return "accepted"


KINDS = {"foreign_trace": Kind(foreign_trace, _corrupted())}

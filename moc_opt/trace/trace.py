"""The trace (data) of a run, with one row per control tick."""

from __future__ import annotations

import difflib
import importlib
import os
from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moc_opt.arrays import read_only
from moc_opt.errors import TraceError, is_number, shown
from moc_opt.inputs.files import to_json
from moc_opt.trace import file
from moc_opt.trace.columns import COLUMNS, Column, column
from moc_opt.trace.meta import Ending, plain

if TYPE_CHECKING:  # for code completion
    from pandas import DataFrame
    from plotly.graph_objects import Figure
    from xarray import Dataset


class MissingDataError(TraceError, AttributeError):
    """A trace has no ticks, or lacks a column or an entry of meta."""


class Trace:
    """A run: `columns` with one row per control tick, and `meta` with the run's settings and ending.

    `trace.q_rad` is `trace.columns["q_rad"]`; `len(trace)` is the number of ticks. Columns other than those of
    `Trace.COLUMNS` are allowed. Arrays are read-only.

    Example:
        >>> trace = mo.run(mo.Scenario(duration_s=0.1, bound_samples=0))
        >>> len(trace), trace.q_rad.shape, trace.meta["ended"]
        (50, (50, 7), 'completed')
        >>> trace.head(2).with_meta(operator="A. B.").save("run.parquet")
        >>> mo.Trace.load("run.parquet").meta["operator"]
        'A. B.'
        >>> faster = trace.with_columns(speed_rad_per_s=abs(trace.v_rad_per_s).max(axis=1)).between(0.01, 0.03)
        >>> int(faster.select(faster.speed_rad_per_s > 0.0).tick[0]), faster.to_xarray().tip_m.dims
        (5, ('t_s', 'axis'))
    """

    COLUMNS: ClassVar[Mapping[str, Column]] = COLUMNS

    columns: Mapping[str, NDArray[Any]]
    meta: Mapping[str, Any]

    __slots__ = ("columns", "meta")

    def __init__(self, columns: Mapping[str, ArrayLike], meta: Mapping[str, Any] | None = None) -> None:
        """Check the columns and meta, and make them read-only.

        Args:
            columns: by name, (N,) or (N, k) floats, integers or flags, or (N,) texts. N is the same for all.
            meta: by name, JSON values with finite numbers.

        Raises:
            TraceError: a column has a wrong shape, type or number of rows, or meta is wrong.
        """
        for argument, given in (("columns", columns), ("meta", {} if meta is None else meta)):
            if not isinstance(given, Mapping):
                raise TraceError(f"{argument} = {shown(given)}: give a mapping, such as {{'t_s': [0.0, 0.002]}}")
        checked = {_name(name): column(name, value) for name, value in columns.items()}
        first = next(iter(checked), "")
        for name, array in checked.items():
            if len(array) != len(checked[first]):
                rows = f"{len(array)} rows, but {first!r} has {len(checked[first])}"
                raise TraceError(f"column {name!r} has {rows}: give one row per tick")
        object.__setattr__(self, "columns", MappingProxyType(checked))
        object.__setattr__(self, "meta", MappingProxyType(plain(meta or {})))

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()), ()))

    def __getattr__(self, name: str) -> NDArray[Any]:
        if name.startswith("__") or name in Trace.__slots__:
            raise AttributeError(name)
        try:
            return self.columns[name]
        except KeyError:
            near = difflib.get_close_matches(name, self.columns, n=3) or sorted(self.columns)
            raise MissingDataError(f"the trace has no column {name!r}; it has {', '.join(near)}") from None

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"a trace is frozen: use with_columns({name}=...) to get a new one")

    def __reduce__(self) -> tuple[type[Trace], tuple[dict[str, NDArray[Any]], dict[str, Any]]]:
        return Trace, (dict(self.columns), dict(self.meta))

    def __repr__(self) -> str:
        known = about(self)
        facts, faults = [f"{known.pop('ticks')} ticks", *known.values()], table(self.meta, "faults")
        if faults:
            facts.append(f"{sum(of['count'] for of in faults.values())} answers replaced ({', '.join(faults)})")
        return f"Trace({', '.join(facts)}: {', '.join(self.columns)})"

    def __dir__(self) -> Iterable[str]:
        return [*super().__dir__(), *self.columns]

    def with_columns(self, **arrays: ArrayLike) -> Trace:
        """Return a new trace with columns added or replaced. Raise what the constructor raises."""
        return Trace({**self.columns, **arrays}, self.meta)

    def select(self, ticks: ArrayLike) -> Trace:
        """Return the trace of the ticks whose flag in ``ticks`` (N,) is True.

        Its column `tick` has the ticks' indices in the run. If a tick is left out, ``meta["run_ended"]`` has the run's
        ending. Raise a TraceError if ``ticks`` has another shape or type.
        """
        mask = np.asarray(ticks)
        if mask.dtype != np.bool_ or mask.shape != (len(self),):
            raise TraceError(f"ticks is {mask.dtype} of shape {mask.shape}: give {len(self)} flags")
        columns = {"tick": np.arange(len(self)), **self.columns}
        found = {name: read_only(array[mask]) for name, array in columns.items()}
        return self._of(MappingProxyType(found), self.meta)._as_part_of(self)

    def between(self, start_s: float, stop_s: float) -> Trace:
        """Return the ticks with start_s <= t_s < stop_s. Raise a TraceError if there are none."""
        if not (is_number(start_s) and is_number(stop_s)):
            given = f"start_s = {shown(start_s)}, stop_s = {shown(stop_s)}"
            raise TraceError(f"between({given}): give times in seconds, inf for no limit")
        time = np.asarray(self.t_s)
        inside = (time >= start_s) & (time < stop_s)
        if not inside.any():
            there = f"runs from {time[0]:g} to {time[-1]:g} s" if len(time) else "is empty"
            raise TraceError(f"between({start_s!r}, {stop_s!r}): no tick lies there; the trace {there}")
        return self.select(inside)

    def plot(
        self, columns: Sequence[str] | None = None, *, name: str | None = None, beside: Trace | None = None
    ) -> Figure:
        """Draw columns of the run over time in a plotly figure.

        Args:
            columns: each gets its own panel. By default the manipulability mu, the tip's error, the error of the
                remote centre of motion (RCM), and the trocar's force.
            name: this run's name in the legend. By default the name of its solver.
            beside: a second run to draw.

        Raises:
            MocOptError: an argument is wrong.
        """
        from moc_opt.figures import time_series

        if beside is not None and not isinstance(beside, Trace):
            raise TraceError(f"plot: beside = {shown(beside)}: give a Trace, such as load_trace(path)")
        if not isinstance(name, str | None):
            raise TraceError(f"plot: name = {shown(name)}: give a text")
        own = name or about(self).get("solver", "run")
        if beside is None:
            return time_series({own: self}, columns)
        other = about(beside).get("solver", own)
        return time_series({"baseline" if other == own else other: beside, own: self}, columns)

    def to_pandas(self) -> DataFrame:
        """Return a pandas.DataFrame with one row per tick, indexed by `t_s`. The frame's `attrs` are `meta`.

        A vector becomes several columns, such as `tip_m_x` or `q_rad_0`. Raise a TraceError if pandas is missing.
        """
        pandas = _package("pandas")
        columns: dict[str, NDArray[Any]] = {}
        for name, array in self.columns.items():
            if array.ndim == 2:
                columns |= {f"{name}_{part}": array[:, k] for k, part in enumerate(_parts(name, array.shape[1]))}
            elif name != "t_s":
                columns[name] = array
        t = self.columns.get("t_s")
        index = pandas.RangeIndex(len(self), name="row") if t is None else pandas.Index(t, name="t_s")
        made = pandas.DataFrame(columns, index=index)
        made.attrs = dict(self.meta)
        return made

    def to_xarray(self) -> Dataset:
        """Return an xarray.Dataset over `t_s`, `joint` and `axis`. Raise a TraceError if xarray is missing."""
        xarray = _package("xarray")
        variables: dict[str, Any] = {}
        coordinates: dict[str, Any] = {}
        for name, array in self.columns.items():
            known = COLUMNS.get(name, Column("", "", ""))
            words = {"units": known.unit, "long_name": known.meaning} if name in COLUMNS else {}
            dimensions = ["t_s" if "t_s" in self.columns else "row"]
            if array.ndim == 2:
                dimensions.append({"(N, n)": "joint", "(N, 3)": "axis"}.get(known.shape, f"{name}_entry"))
                coordinates.setdefault(dimensions[1], list(_parts(name, array.shape[1])))
            variables[name] = (dimensions, array, words)
        if "t_s" in variables:
            coordinates["t_s"] = variables.pop("t_s")
        # NetCDF attributes are texts and numbers, so nested values become JSON texts.
        attributes = {
            key: value if isinstance(value, str | int | float) else to_json(value, indent=None)
            for key, value in self.meta.items()
        }
        return xarray.Dataset(variables, coordinates, attributes)

    def head(self, ticks: int) -> Trace:
        """Return the trace of the first ``ticks`` ticks, or of all if there are fewer."""
        if isinstance(ticks, bool) or not isinstance(ticks, int | np.integer) or ticks < 0:
            raise TraceError(f"head: ticks = {shown(ticks)}: give an integer of 0 or more")
        columns = MappingProxyType({name: array[:ticks] for name, array in self.columns.items()})
        return self._of(columns, self.meta)._as_part_of(self)

    def _as_part_of(self, run: Trace) -> Trace:
        if len(self) == len(run):
            return self
        told: dict[str, Any] = {"ticks": len(self)} if "ticks" in self.meta else {}
        if "ended" in self.meta:
            told["run_ended"] = self.meta.get("run_ended", self.meta["ended"])
            t = np.asarray(self.columns.get("t_s", ()), dtype=np.float64)
            timed = t.size and np.isfinite([t[0], t[-1]]).all()
            extent = f"{t[0]:.3f} to {t[-1]:.3f} s" if timed else f"{len(self)} ticks"
            told["ended"] = f"{Ending.PART.value}: {extent} of a run, which ended: {told['run_ended']}"
        return self.with_meta(**told)

    def with_meta(self, **values: Any) -> Trace:
        """Return a trace with entries of meta added or replaced. Raise what the constructor raises."""
        return self._of(self.columns, MappingProxyType(plain({**self.meta, **values})))

    @classmethod
    def _of(cls, columns: Mapping[str, NDArray[Any]], meta: Mapping[str, Any]) -> Trace:
        made = object.__new__(cls)
        object.__setattr__(made, "columns", columns)
        object.__setattr__(made, "meta", meta)
        return made

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a Parquet file. Raise a TraceError if the file cannot be written."""
        file.write(path, self.columns, self.meta)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Trace:
        """Read a file that `save` wrote. Raise a TraceError if the file is missing, damaged or no trace."""
        return cls(*file.read(path))


def _name(name: str) -> str:
    if not isinstance(name, str) or not name.isidentifier() or name[0] == "_" or hasattr(Trace, name):
        raise TraceError(f"column {name!r}: give a Python identifier that is no attribute of Trace")
    return name


def load_trace(path: str | os.PathLike[str]) -> Trace:
    """Read the file of a trace; see `Trace.load`."""
    return Trace.load(path)


def table(of: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Return the table ``name`` of meta; an empty table if there is none."""
    found = of.get(name)
    return found if isinstance(found, dict) else {}


def about(trace: Trace) -> dict[str, str]:
    """Return a run's main facts as texts, by name. With law "dcac", which has no solver, "solver" is "dcac"."""
    meta, scenario = trace.meta, table(trace.meta, "scenario")
    name = meta.get("solver", table(scenario, "solver").get("name"))  # meta has "solver" if `run` got a solver object
    law = "dcac" if table(scenario, "control").get("law") == "dcac" else name
    known = {"scenario": scenario.get("name"), "robot": meta.get("robot"), "solver": law, "ended": meta.get("ended")}
    length = {"ticks": str(len(trace))}
    if isinstance(period := meta.get("period_s"), float):
        length["duration"] = f"{len(trace) * period:.3f} s"
    return {**length, **{name: str(value) for name, value in known.items() if value}}


def _parts(name: str, width: int) -> Sequence[Any]:
    known = COLUMNS.get(name)
    return ("x", "y", "z") if known is not None and known.shape == "(N, 3)" else np.arange(width).tolist()


def _package(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise TraceError(f"{name} is not installed: pip install '.[dataframes]' in the clone") from error

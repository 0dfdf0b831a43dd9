"""What a run leaves behind: one row per control tick, saved as Parquet."""

from __future__ import annotations

import difflib
import json
import os
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moc_opt.errors import TraceError
from moc_opt.trace import parquet as trace_file
from moc_opt.trace import writer as trace_writer

_TYPES = {"f": (4, 8), "i": (1, 2, 4, 8), "u": (1, 2, 4, 8), "b": (1,)}


class MissingDataError(TraceError, AttributeError):
    """A trace lacks what was asked of it: a column, an entry of meta, a second tick."""


class Column(NamedTuple):
    """The documentation of one column."""

    unit: str
    shape: str
    meaning: str
    kind: str = "number"


class Trace:
    """A run: `columns`, one row per tick, and `meta`, how the run came about.

    `trace.q_rad` is `trace.columns["q_rad"]`; `len(trace)` is the number of ticks. No column is obligatory,
    and a trace may hold others than those of `Trace.COLUMNS`; those named there must have the shape given
    there (N ticks, n joints). Arrays are read-only. Nested values of `meta` are plain JSON; leave them alone.
    """

    COLUMNS: ClassVar[Mapping[str, Column]] = MappingProxyType(
        {
            "t_s": Column("s", "(N,)", "time at the start of the tick"),
            "q_rad": Column("rad", "(N, n)", "true joint positions"),
            "v_rad_per_s": Column("rad/s", "(N, n)", "true joint velocities"),
            "tau_Nm": Column("Nm", "(N, n)", "joint torques sent to the arm, within the guard's limits"),
            "limited": Column("1", "(N,)", "joints at which the guard changed the torque that was asked for"),
            "tip_m": Column("m", "(N, 3)", "true tip X"),
            "tip_ref_m": Column("m", "(N, 3)", "tip reference X_d"),
            "wrist_m": Column("m", "(N, 3)", "true wrist centre N"),
            "trocar_m": Column("m", "(N, 3)", "true trocar P_t"),
            "mu": Column("m^3", "(N,)", "manipulability sqrt(det(J_T J_T^T))"),
            "tip_error_m": Column("m", "(N,)", "|X_d - X|: absolute, in the base frame"),
            "tip_error_registered_m": Column("m", "(N,)", "the same in the frame registered by touch at the start"),
            "tip_error_model_m": Column("m", "(N,)", "the same by the robot's own kinematics, sensor noise aside"),
            "rcm_error_m": Column("m", "(N,)", "distance of the shaft's line from the trocar"),
            "rcm_error_registered_m": Column(
                "m", "(N,)", "the same from the trocar as registered by touch: less the registration's error"
            ),
            "rcm_error_model_m": Column("m", "(N,)", "the latter by the robot's own kinematics, sensor noise aside"),
            "trocar_force_N": Column("N", "(N, 3)", "true force of the trocar on the shaft, world axes"),
            "x_rad_per_s": Column("rad/s", "(N, n)", "the subproblem's answer; NaN where there was none"),
            "status": Column("", "(N,)", "status the solver claimed; 'none' without a third level", "text"),
            "applied_x_rad_per_s": Column(
                "rad/s", "(N, n)", "what the third level followed: the answer, or its stand-in"
            ),
            "fault": Column(
                "",
                "(N,)",
                "why the answer was refused, as a control.supervisor.Fault; 'stopped': braking, no solver was asked",
                "text",
            ),
            "injected": Column("", "(N,)", "the answer of this tick was spoilt on purpose", "flag"),
            "solve_us": Column("us", "(N,)", "time of the solver; NaN where there was no subproblem"),
            "tick_us": Column("us", "(N,)", "time of the whole tick, state to torque"),
            "tick": Column("1", "(N,)", "number of the tick; without it the rows are consecutive"),
            "travelling": Column("", "(N,)", "the elbow is still on its way to its optimum", "flag"),
            "verified": Column("", "(N,)", "the answer was judged optimal", "flag"),
            "primal": Column("rad/s, m/s", "(N,)", "max(|A x - b|_inf, box violation); NaN: no subproblem"),
            "natural": Column("rad/s", "(N,)", "natural residual; NaN: no subproblem"),
            "loss": Column("1", "(N,)", "share of the cost's range, 0 optimum, 1 worst; NaN: no subproblem"),
            "mu_bound": Column("m^3", "(N,)", "largest mu on the feasible self-motion; NaN: not scanned"),
        }
    )
    """Name -> unit, shape and meaning of every column that the package itself writes or reads."""

    columns: Mapping[str, NDArray[Any]]
    meta: Mapping[str, Any]

    __slots__ = ("columns", "meta")

    def __init__(self, columns: Mapping[str, ArrayLike], meta: Mapping[str, Any] | None = None) -> None:
        """Check and freeze.

        Args:
            columns: name -> (N,) or (N, k) floats, integers, flags, or (N,) texts; the same N for all.
            meta: name -> JSON value, finite numbers only; kept as JSON would give it back (tuples as lists).

        Raises:
            TraceError: a column (named) has another shape, type or number of rows; meta is not JSON.
        """
        checked = {name: _column(name, value) for name, value in columns.items()}
        rows = {name: len(array) for name, array in checked.items()}
        for name, count in rows.items():
            first = next(iter(rows))
            if count != rows[first]:
                raise TraceError(
                    f"column {name!r} has {count} rows where {first!r} has {rows[first]}: "
                    f"give one row per tick"
                )
        object.__setattr__(self, "columns", MappingProxyType(checked))
        object.__setattr__(self, "meta", MappingProxyType(_plain(meta or {})))

    def __len__(self) -> int:
        """Number of ticks."""
        if isinstance(self.columns, trace_file.Stored):
            return self.columns.rows
        return len(next(iter(self.columns.values()), ()))

    def __getattr__(self, name: str) -> NDArray[Any]:
        """Return a column; MissingDataError (an AttributeError) names the nearest ones."""
        if name.startswith("__") or name in Trace.__slots__:
            raise AttributeError(name)
        try:
            return self.columns[name]
        except KeyError:
            near = difflib.get_close_matches(name, self.columns, n=3) or sorted(self.columns)
            raise MissingDataError(f"the trace has no column {name!r}; it has {', '.join(near)}") from None

    def __setattr__(self, name: str, value: object) -> None:
        """Refuse: a trace is frozen."""
        raise AttributeError(f"a trace is frozen: use with_columns({name}=...) to get a new one")

    def __reduce__(self) -> tuple[type[Trace], tuple[dict[str, NDArray[Any]], dict[str, Any]]]:
        """Pickle through the constructor: the read-only views themselves cannot be."""
        return Trace, (dict(self.columns), dict(self.meta))

    def __repr__(self) -> str:
        return f"Trace({len(self)} ticks: {', '.join(self.columns)})"

    def with_columns(self, **arrays: ArrayLike) -> Trace:
        """Return a new trace with columns added or replaced.

        Raises:
            TraceError: as for the constructor.
        """
        return Trace({**self.columns, **arrays}, self.meta)

    def select(self, ticks: ArrayLike) -> Trace:
        """Return the trace of some of the ticks; its column `tick` keeps their numbers.

        Args:
            ticks: (N,) flags.

        Raises:
            TraceError: `ticks` is not one flag per tick.
        """
        mask = np.asarray(ticks)
        if mask.dtype != np.bool_ or mask.shape != (len(self),):
            raise TraceError(f"ticks is {mask.dtype} of shape {mask.shape}: give {len(self)} flags")
        columns = {"tick": np.arange(len(self)), **self.columns}
        return Trace({name: array[mask] for name, array in columns.items()}, self.meta)

    def head(self, ticks: int) -> Trace:
        """Return the trace of the first ticks."""
        columns: Mapping[str, NDArray[Any]]
        if isinstance(self.columns, trace_file.Stored):
            columns = self.columns.head(ticks)
        else:
            columns = MappingProxyType({name: array[:ticks] for name, array in self.columns.items()})
        return self._of(columns, self.meta)

    def with_meta(self, **values: Any) -> Trace:
        """Return the same columns with entries of meta added or replaced.

        Raises:
            TraceError: a value is not JSON.
        """
        return self._of(self.columns, MappingProxyType(_plain({**self.meta, **values})))

    @classmethod
    def of_files(cls, columns: trace_file.Stored, meta: Mapping[str, Any]) -> Trace:
        """Return a trace whose columns stay in their files; meta, and errors, as for the constructor."""
        for name, dtype in columns.types.items():
            _check_column(name, dtype, columns.shape(name))
        return cls._of(columns, MappingProxyType(_plain(meta)))

    @classmethod
    def _of(cls, columns: Mapping[str, NDArray[Any]], meta: Mapping[str, Any]) -> Trace:
        """Of columns and meta that were checked before."""
        made = object.__new__(cls)
        object.__setattr__(made, "columns", columns)
        object.__setattr__(made, "meta", meta)
        return made

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a Parquet file, all or nothing: an older file of that name stays until the new one is there.

        Numbers of shape (N, k) become fixed-size lists, texts are dictionary-encoded, meta is JSON in the
        schema's metadata under "moc_opt.meta".

        Raises:
            TraceError: the file cannot be written.
        """
        trace_file.write(path, self.columns, self.meta)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Trace:
        """Read what `save` wrote, the same to the last bit.

        Raises:
            TraceError: the file is missing, damaged, no trace, or too large for the memory: see `open`.
        """
        whole, meta = trace_writer.found(path)
        return cls(*trace_file.read(path)) if meta is None else cls(dict(whole), meta)

    @classmethod
    def open(cls, path: str | os.PathLike[str]) -> Trace:
        """Read what `save` wrote, column by column: each is read from the file whenever it is asked for.

        Of a run whose process was killed the rows that had been written are found beside the file's name, and
        ``meta["ended"]`` says so.

        Raises:
            TraceError: as for `load`; a damaged column may show only when it is asked for.
        """
        columns, meta = trace_writer.found(path)
        return cls.of_files(columns, columns.meta if meta is None else meta)


def _column(name: str, value: ArrayLike) -> NDArray[Any]:
    """Return one column as a read-only array of its own, or say what is wrong with it."""
    try:
        array = np.asarray(value)
    except ValueError as error:
        raise TraceError(f"column {name!r} has rows of different lengths: give an array") from error
    if array.dtype == object and all(isinstance(entry, str) for entry in array.flat):
        array = array.astype(np.str_)
    _check_column(name, array.dtype, array.shape)
    # Only an array that nobody else can write through may be kept without a copy.
    native = array.dtype.newbyteorder("=")
    if array.flags.writeable or not array.flags.owndata or array.dtype != native:
        array = np.array(array, dtype=native, order="C")
    array.setflags(write=False)
    return array


def _check_column(name: str, dtype: np.dtype[Any], shape: tuple[int, ...]) -> None:
    """Say what is wrong with a column's name, type or shape."""
    if not isinstance(name, str) or not name.isidentifier() or name[0] == "_" or hasattr(Trace, name):
        raise TraceError(f"column {name!r}: give a name that can follow 'trace.' and is not taken there")
    kind = dtype.kind
    if kind != "U" and dtype.itemsize not in _TYPES.get(kind, ()):
        raise TraceError(f"column {name!r} has type {dtype}: give floats, integers, flags or texts")
    if len(shape) not in ((1,) if kind == "U" else (1, 2)) or shape[1:] == (0,):
        raise TraceError(f"column {name!r} has shape {shape}: give (N,) or, for numbers, (N, k)")
    known = Trace.COLUMNS.get(name)
    if known is not None:
        wanted = {"text": "U", "flag": "b"}.get(known.kind, "fiu")
        width = known.shape.removeprefix("(N,").strip(" )")
        fits = len(shape) == 1 if not width else len(shape) == 2 and width in ("n", str(shape[1]))
        if kind not in wanted or not fits:
            raise TraceError(
                f"column {name!r} is {dtype} of shape {shape}: give {known.kind}s of shape {known.shape}"
            )


def _plain(meta: Mapping[str, Any]) -> dict[str, Any]:
    """Return meta as JSON gives it back."""
    for name, value in meta.items():
        if not isinstance(name, str):
            raise TraceError(f"meta key {name!r} is not a text: give names as texts")
        try:
            json.dumps(value, allow_nan=False)
        except (TypeError, ValueError, RecursionError) as error:
            raise TraceError(
                f"meta[{name!r}] cannot be written as JSON ({error}): "
                f"give texts, finite numbers, flags, None, and lists and dicts of them"
            ) from error
    plain: dict[str, Any] = json.loads(json.dumps(dict(meta), allow_nan=False))
    return plain

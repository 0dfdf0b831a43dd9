"""A trace as others read it: a pandas table, an xarray dataset, a figure, a few lines in a notebook.

pandas, xarray and the figures are imported when they are asked for, never before.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from moc_opt.errors import TraceError
from moc_opt.inputs.files import to_json
from moc_opt.inputs.notebook import table_html
from moc_opt.trace.columns import COLUMNS

if TYPE_CHECKING:
    from moc_opt.trace.trace import Trace

AXES = ("x", "y", "z")


def table(of: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Return a table of the meta; an empty one where a foreign file has something else in its place."""
    found = of.get(name)
    return found if isinstance(found, dict) else {}


def about(trace: Trace) -> dict[str, str]:
    """Return the main facts of a run, name -> text; entries that `meta` lacks are left out."""
    meta = trace.meta
    scenario = table(meta, "scenario")
    control, solver = table(scenario, "control"), table(scenario, "solver")
    law = "dcac" if control.get("law") == "dcac" else solver.get("name")
    known = {"scenario": scenario.get("name"), "robot": meta.get("robot"), "solver": law, "ended": meta.get("ended")}
    length = {"ticks": str(len(trace))}
    if isinstance(period := meta.get("period_s"), float):
        length["duration"] = f"{len(trace) * period:.3f} s"
    return {**length, **{name: str(value) for name, value in known.items() if value}}


def html(trace: Trace) -> str:
    """Write the run's summary and its columns with their units."""
    units = [f"{name} [{COLUMNS[name].unit}]" if name in COLUMNS else name for name in trace.columns]
    return table_html("Trace", {**about(trace), "columns": ", ".join(units)})


def frame(trace: Trace) -> Any:
    """See `Trace.to_pandas`."""
    pandas = _package("pandas")
    columns: dict[str, NDArray[Any]] = {}
    for name, array in trace.columns.items():
        if name == "t_s":
            continue
        if array.ndim == 1:
            columns[name] = array
        else:
            columns |= {f"{name}_{part}": array[:, k] for k, part in enumerate(_parts(name, array.shape[1]))}
    index = pandas.Index(trace.t_s, name="t_s") if "t_s" in trace.columns else pandas.RangeIndex(len(trace), name="row")
    made = pandas.DataFrame(columns, index=index)
    made.attrs = dict(trace.meta)
    return made


def dataset(trace: Trace) -> Any:
    """See `Trace.to_xarray`."""
    xarray = _package("xarray")
    rows = "t_s" if "t_s" in trace.columns else "row"
    variables: dict[str, Any] = {}
    coordinates: dict[str, Any] = {}
    for name, array in trace.columns.items():
        known = COLUMNS.get(name)
        words = {} if known is None else {"units": known.unit, "long_name": known.meaning}
        if name == "t_s":
            coordinates[name] = ("t_s", array, words)
            continue
        dimensions = [rows]
        if array.ndim == 2:
            parts = _parts(name, array.shape[1])
            shape = "" if known is None else known.shape
            second = {"(N, n)": "joint", "(N, 3)": "axis"}.get(shape, f"{name}_entry")
            dimensions.append(second)
            coordinates.setdefault(second, list(parts))
        variables[name] = (dimensions, array, words)
    # Attributes of a NetCDF file are texts and numbers: what is nested goes as JSON.
    plain = {
        key: value if isinstance(value, str | int | float) else to_json(value, indent=None)
        for key, value in trace.meta.items()
    }
    return xarray.Dataset(variables, coordinates, plain)


def figure(runs: Mapping[str, Trace], columns: Sequence[str] | None) -> Any:
    """See `Trace.plot`; the figure is the one of the reports."""
    from moc_opt.figures import time_series

    return time_series(runs, columns)


def _parts(name: str, width: int) -> Sequence[Any]:
    """Return the names of a vector's entries: axes where the column's are, else numbers from 0, as the array's own."""
    known = COLUMNS.get(name)
    return AXES if known is not None and known.shape == "(N, 3)" else np.arange(width).tolist()


def _package(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise TraceError(f"{name} is not installed: pip install 'moc-opt[dataframes]'") from error

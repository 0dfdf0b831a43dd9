"""The fields that a sweep may vary: those of a scenario by dotted path, over lists and random ranges."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, ClassVar, Literal, get_args, get_origin

import numpy as np
from pydantic import BaseModel, Field

from moc_opt.errors import MocOptError, UnknownNameError, shown
from moc_opt.inputs.settings import Settings
from moc_opt.scenario import Scenario


class SweepError(MocOptError, ValueError):
    """The configuration of a sweep cannot be used."""


ELSEWHERE = {"seed": "seeds", "solver.name": "solvers"}


class Range(Settings):
    """A range to draw from, uniformly on its scale; ``integer`` draws whole numbers, both ends included."""

    KIND: ClassVar[str] = "range:"
    ERROR: ClassVar[type[MocOptError]] = SweepError
    low: float = Field(ge=-1e15, le=1e15)
    high: float = Field(ge=-1e15, le=1e15)
    scale: Literal["linear", "log", "integer"] = "linear"


class Choice(Settings):
    """Values to draw from, each as likely as the others."""

    KIND: ClassVar[str] = "choice:"
    choice: list[Any] = Field(min_length=1)


def paths(model: type[BaseModel] = Scenario, prefix: str = "") -> Iterator[tuple[str, bool]]:
    """Return every field of a scenario, tables opened: its dotted path, and whether it takes names of its own."""
    for name, info in model.model_fields.items():
        kinds = [info.annotation, *get_args(info.annotation)]
        tables = [kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel)]
        for table in tables:
            yield from paths(table, f"{prefix}{name}.")
        if not tables:
            yield f"{prefix}{name}", any(get_origin(kind) in (dict, Mapping) for kind in kinds)


def check_path(path: str) -> None:
    """Check that a path is that of a field which a sweep may vary.

    Raises:
        UnknownNameError: there is no such field; the message lists the nearest ones.
        SweepError: solver and seed, which have places of their own in the configuration.
    """
    if path in ELSEWHERE:
        raise SweepError(f"{path!r} cannot be swept as a field: give {ELSEWHERE[path]!r} in the configuration")
    known = dict(paths())
    table, _, key = path.rpartition(".")
    if path not in known and not (key and known.get(table, False)):
        raise UnknownNameError("scenario field", path, [*known, *(f"{p}.NAME" for p in known if known[p])])


def flatten(table: Mapping[str, Any], is_leaf: Callable[[Any], bool], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Flatten what TOML reads: ``control.c0 = ...`` is a table in a table, ``"control.c0" = ...`` one name."""
    for name, value in table.items():
        if isinstance(value, Mapping) and not is_leaf(value):
            yield from flatten(value, is_leaf, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def grid_axes(table: Mapping[str, Any]) -> dict[str, list[Any]]:
    """Map path to its values, all checked.

    Raises:
        UnknownNameError: no such field.
        SweepError: not a list of different values, or a field given twice.
    """
    axes: dict[str, list[Any]] = {}
    for path, values in flatten(table, lambda value: False):
        check_path(path)
        if path in axes:
            raise SweepError(f"[grid] {path} is given twice: keep one list")
        if not isinstance(values, list) or not values:
            raise SweepError(f"[grid] {path} = {values!r}: give a list of values")
        _all_different(f"[grid] {path}", values)
        axes[path] = values
    return axes


def random_draws(table: Mapping[str, Any], samples: int, seed: int) -> dict[str, list[Any]]:
    """Map path to ``samples`` values drawn by ``seed``.

    Each field has a stream of its own, named by its path as written: another field changes nothing in it, and more
    samples only lengthen it.

    Raises:
        UnknownNameError: no such field, or a key that no range has.
        SweepError: a range without width, or a logarithmic one that reaches zero.
    """
    draws: dict[str, list[Any]] = {}
    for path, entry in flatten(table, lambda value: bool({"low", "high", "choice"} & value.keys())):
        check_path(path)
        if path in draws:
            raise SweepError(f"[random.fields] {path} is given twice: keep one range")
        words = np.frombuffer(hashlib.sha256(path.encode()).digest(), dtype=np.uint32)
        rng = np.random.default_rng([seed, *words.tolist()])
        draws[path] = draw(path, entry, samples, rng)
    return draws


def draw(path: str, entry: Any, samples: int, rng: np.random.Generator) -> list[Any]:
    """Draw the values of one field; see :func:`random_draws`."""
    if not isinstance(entry, Mapping):
        raise SweepError(f"[random.fields] {path} = {entry!r}: give {{low = .., high = ..}} or {{choice = [..]}}")
    uniform = rng.random(samples)
    if "choice" in entry:
        options = Choice(**entry).choice
        _all_different(f"[random.fields] {path}", options)
        return [options[int(u * len(options))] for u in uniform]
    try:
        known = Range(**entry)
    except SweepError as error:
        raise SweepError(f"[random.fields] {path}: {error}") from error
    low, high = known.low, known.high
    if not low < high:
        raise SweepError(f"[random.fields] {path}: low = {low:g} is not below high = {high:g}")
    if known.scale == "log":
        if low <= 0.0:
            raise SweepError(f"[random.fields] {path}: low = {low:g}: a logarithmic range begins above 0")
        exponents = math.log(low) + uniform * (math.log(high) - math.log(low))
        return [min(max(math.exp(e), low), high) for e in exponents]
    if known.scale == "integer":
        first, count = math.ceil(low), math.floor(high) - math.ceil(low) + 1
        if count < 1:
            raise SweepError(f"[random.fields] {path}: no whole number lies from {low:g} to {high:g}")
        return [first + int(u * count) for u in uniform]
    return [float(low + u * (high - low)) for u in uniform]


def with_value(table: dict[str, Any], path: str, value: Any) -> None:
    """Set a field of a scenario's table, in place."""
    *outer, last = path.split(".")
    for name in outer:
        if not isinstance(table.get(name), dict):
            table[name] = {}  # an optional table that was left out
        table = table[name]
    table[last] = value


def _all_different(where: str, values: Sequence[Any]) -> None:
    seen: set[tuple[type, Any]] = set()
    for value in values:
        key = (type(value), repr(value) if isinstance(value, list | dict) else value)
        if key in seen:
            raise SweepError(f"{where}: {shown(value)} is given twice: keep one, each value is one run")
        seen.add(key)

"""Tables of settings, as frozen pydantic models."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any, ClassVar, Self

import numpy as np
import pydantic

from moc_opt.errors import MocOptError, ScenarioError, UnknownNameError, is_number, shown
from moc_opt.inputs import names

_ALTERNATIVE = re.compile(r"constrained-|literal\[|tuple\[|(float|str)$")  # pydantic's names of types in a union
LARGEST_INTEGER = 2**63 - 1
SMALLEST, LARGEST = 1e-30, 1e30  # bounds on |x| for each number x except 0
MOST = 10_000_000  # bound on |k| for each integer k except seeds
LONGEST_S = 1e6  # bound on each time [s]

Name = Annotated[str, pydantic.AfterValidator(names.checked)]
"""A name that follows `moc_opt.inputs.names.RULE`."""
Level = Annotated[
    Annotated[float, pydantic.Field(gt=0.0)] | None,
    pydantic.BeforeValidator(lambda value: None if value == math.inf else value),
]
"""A limit above zero; None (in TOML ``inf``) means no limit."""


class Settings(pydantic.BaseModel):
    """Base of every table of settings. ``KIND`` is the table's name in messages.

    Raises:
        UnknownNameError: a field does not exist.
        MocOptError: a value is wrong. The error's class is ``ERROR``.
    """

    model_config = pydantic.ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True)

    KIND: ClassVar[str] = "setting"
    ERROR: ClassVar[type[MocOptError]] = ScenarioError
    MORE_KEYS: ClassVar[tuple[str, ...]] = ()  #: Keys that a file may have besides the fields.

    @pydantic.field_validator("*", mode="wrap")
    @classmethod
    def _as_written(
        cls, given: Any, validate: pydantic.ValidatorFunctionWrapHandler, info: pydantic.ValidationInfo
    ) -> Any:
        value, name = validate(given), info.field_name or ""
        most = LARGEST_INTEGER if name in ("seed", "seeds") else MOST
        for where, written, read in _leaves(given, value):
            if cure := _fault(written, read, most):
                raise ValueError(f"{where} = {shown(written)}: {cure}" if where else cure)
        is_time = name == "seconds" or (name.endswith("_s") and "_per_" not in name)
        if is_time and isinstance(value, float) and value > LONGEST_S:
            raise ValueError(f"give {LONGEST_S:g} s at most")
        return value

    def __init__(self, **values: Any) -> None:
        for name in values:
            if name not in type(self).model_fields:
                raise UnknownNameError(f"{self.KIND.rstrip(':')} key", name, self.keys(values))
        try:
            super().__init__(**values)
        except pydantic.ValidationError as error:
            faults: dict[tuple[Any, ...], list[Any]] = {}
            for item in error.errors():
                where = tuple(key for key in item["loc"] if not _ALTERNATIVE.match(str(key)))
                faults.setdefault(where, []).append({**item, "loc": where})
            raise self.ERROR("; ".join(_explained(items, self.KIND) for items in faults.values())) from error

    def change(self, **changes: Any) -> Self:
        """Copy with some fields changed.

        A mapping for a table changes only the keys that it lists. With the key ``preset``, it replaces the table.

        Raises:
            UnknownNameError, MocOptError: as for the constructor.
        """
        values = {
            name: getattr(self, name) for name, field in type(self).model_fields.items()
            if name in self.model_fields_set or getattr(self, name) != field.default
        }  # fmt: skip
        for name, new in changes.items():
            old, values[name] = getattr(self, name, None), new
            if isinstance(old, Settings) and isinstance(new, Mapping) and "preset" not in new:
                values[name] = old.change(**new)
        return type(self)(**values)

    @classmethod
    def keys(cls, values: Mapping[str, Any]) -> list[str]:
        """List the keys that a table with these values may have."""
        return [*cls.model_fields, *cls.MORE_KEYS]

    @classmethod
    def meaning(cls, key: str) -> str:
        """Return the meaning of a key."""
        return " ".join((cls.model_fields[key].description or "").split())


def _leaves(given: Any, value: Any, where: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Yield place, written value and validated value of every entry."""
    if not isinstance(value, Mapping | list | tuple):
        yield where, given, value
        return
    for key, one in value.items() if isinstance(value, Mapping) else enumerate(value):
        try:
            written = given[key]
        except (LookupError, TypeError):  # a validator has changed the structure
            written = one
        yield from _leaves(written, one, f"{where}[{key!s:.80}]")


def _fault(written: Any, read: Any, most: int) -> str:
    """Return the cure, or "" for a right value. Pydantic accepts some wrong values, such as a number in quotes."""
    is_flag = isinstance(written, bool | np.bool_)
    if isinstance(read, bool):
        return "" if is_flag else "give true or false, without quotes"
    if isinstance(read, str) and not isinstance(written, str):
        return "give a text"
    if is_number(read) and (is_flag or isinstance(written, str | bytes)):
        return "give a number" if is_flag else "a number has no quotes: drop them"
    if isinstance(read, int) and not -most <= read <= most:
        return f"give an integer of at most {most} in absolute value"
    if isinstance(read, float) and read != 0.0 and not SMALLEST <= abs(read) <= LARGEST:
        return f"give 0, or a size from {SMALLEST:g} to {LARGEST:g}"
    return ""


def _explained(items: Sequence[Mapping[str, Any]], kind: str) -> str:
    item = items[0]
    field = repr(".".join(f"{key!s:.80}" for key in item["loc"]))[1:-1]  # with escapes
    message = ", or ".join(one["msg"].removeprefix("Value error, ") for one in items)
    message = message.replace(", or Input should be", ", or")
    message = message.replace("a valid tuple", "a list").replace("a valid dictionary", "a table")
    if "_than" in item["type"] and (unit := re.search(r"(?<!_per)_(m|s|rad|N|kg|us|Hz)$", field)):
        message += f" [{unit[1]}]"
    if isinstance(item.get("ctx", {}).get("error"), MocOptError):  # from an inner table
        return message if not field or message.startswith(f"[{field}]") else f"{kind} {field}: {message}"
    if item["type"] == "missing" and isinstance(item["loc"][-1], int):
        return f"{kind} {field.rpartition('.')[0]} has too few entries: {shown(item['input'])}"
    if item["type"] == "missing":
        return f"{kind} {field} is missing: add it"
    if item["type"] == "model_type":
        table = f"{kind[:-1]}.{field}]" if kind.startswith("[") else f"[{field}]"
        message = f"must be a table: in a file write {table} with its keys below it, in Python give a dict"
    shown_field = f"{field} = {shown(item['input'])}: {message[0].lower()}" if field else message[0]
    return f"{kind} {shown_field}{message[1:]}"

"""Write tables as TOML: what `moc_opt.inputs.files.read_toml` reads again, to the last bit."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any

_BARE = re.compile(r"[A-Za-z0-9_-]+")


def to_toml(table: Mapping[str, Any]) -> str:
    """Write a table of texts, numbers, flags, lists and tables.

    Raises:
        TypeError: a value that TOML cannot hold, None among them; the message names its key.
    """
    return "\n".join(_lines(table, ())).lstrip("\n") + "\n"


def _lines(table: Mapping[str, Any], above: tuple[str, ...]) -> list[str]:
    values = {key: value for key, value in table.items() if not isinstance(value, Mapping)}
    lines = [f"{_key(key)} = {_value(value, '.'.join((*above, key)))}" for key, value in values.items()]
    for key, value in table.items():
        if isinstance(value, Mapping):
            inside = _lines(value, (*above, key))
            # A table of tables alone needs no heading of its own.
            heading = [] if inside and inside[0].startswith("\n") else [f"\n[{'.'.join(map(_key, (*above, key)))}]"]
            lines += heading + inside
    return lines


def _key(key: str) -> str:
    return key if _BARE.fullmatch(key) else _text(key)


def _text(text: str) -> str:
    # JSON's escapes are TOML's, but for DEL, and for characters beyond 16 bits, which stay as they are.
    return json.dumps(text, ensure_ascii=False, allow_nan=False).replace("\x7f", "\\u007f")


def _value(value: Any, where: str) -> str:
    if hasattr(value, "tolist"):  # numpy's numbers and arrays
        value = value.tolist()
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, list | tuple):
        return f"[{', '.join(_value(entry, where) for entry in value)}]"
    if isinstance(value, Mapping):  # in a list
        return f"{{{', '.join(f'{_key(key)} = {_value(entry, where)}' for key, entry in value.items())}}}"
    raise TypeError(f"{where} = {value!r:.200} has no form in TOML: give a text, number, flag, list or table")

"""moc-opt keys: every key of a scenario with its type, unit, default and meaning, read off the schema."""

from __future__ import annotations

import argparse
import json
import re
import types
import typing
from collections.abc import Iterator
from typing import Any, Literal, NamedTuple, get_args, get_origin

from moc_opt.commands.running import print_tables
from moc_opt.errors import UnknownNameError
from moc_opt.inputs.settings import Settings
from moc_opt.report.tables import Column, Table
from moc_opt.scenario.config import PRESETS, Scenario

_UNIT = r"(?:N?m|Ns?|rad|s|us|Hz|kg|deg|MB)"
_SUFFIX = re.compile(rf"_((?:{_UNIT}_)*{_UNIT}[2]?(?:_per_{_UNIT}2?)*|per_{_UNIT}2?)$")
_HEAD = """# The keys of a scenario

Made by `moc-opt keys --markdown` from the schema that checks every file: edit the schema, not this page. A key that is
left out has its default. The levels of RCM error and forces in `[guard]` may be `inf`: no limit.
"""


_ABSENT = "left out"


class Key(NamedTuple):
    """One key of a table."""

    name: str
    kind: str
    unit: str
    default: str
    meaning: str


def print_keys(given: argparse.Namespace) -> int:
    """Print the keys of every table, or of one; returns 0."""
    found = {name or "scenario": (about, keys) for name, about, keys in tables()}
    if given.table is not None and given.table not in found:
        raise UnknownNameError("table of a scenario", given.table, found)
    if given.markdown:
        print(markdown(given.table), end="")
        return 0
    columns = [Column("key", "key"), Column("meaning", "meaning")]
    for name in found if given.table is None else [given.table]:
        title = "At the top of the file" if name == "scenario" else f"[{name}]"
        print_tables([Table(title, columns, [_on_a_screen(key) for key in found[name][1]])])
    return 0


def _on_a_screen(key: Key) -> dict[str, str]:
    unit = "" if not key.unit or f"[{key.unit}]" in key.meaning else f" [{key.unit}]"
    default = f": {_ABSENT}" if key.default == _ABSENT else f" = {key.default}"
    return {"key": f"{key.name}{default}", "meaning": f"{key.meaning}{unit} ({key.kind})".strip()}


def tables(kind: type[Settings] = Scenario, path: str = "") -> Iterator[tuple[str, str, list[Key]]]:
    """Yield every table: its name (empty: the top of the file), its first line of documentation, its keys."""
    inner: list[tuple[str, type[Settings]]] = []
    keys = []
    if path in PRESETS:
        meaning = "a named set of values of this table; the other keys override it"
        keys.append(Key("preset", " | ".join(map(repr, PRESETS[path])), "", _ABSENT, meaning))
    for name, field in kind.model_fields.items():
        hint = field.annotation
        if isinstance(hint, type) and issubclass(hint, Settings):
            inner.append((f"{path}.{name}".lstrip("."), hint))
            continue
        default = field.get_default(call_default_factory=True)
        meaning = " ".join((field.description or "").split())
        kind_of = _type(hint)
        in_unit = unit(name, meaning) if "number" in kind_of or "integer" in kind_of else ""
        keys.append(Key(name, kind_of, in_unit, _value(default), meaning))
    yield path, (kind.__doc__ or "").strip().partition("\n")[0], keys
    for below, hint in inner:
        yield from tables(hint, below)


def unit(name: str, meaning: str = "") -> str:
    """Read the unit off the [brackets] of a key's meaning, or off its name ("_m_per_s": m/s); "" where it has none."""
    written, found = re.search(r"\[([^\]]+)\]", meaning), _SUFFIX.search(name)
    if written is not None or found is None:
        return "" if written is None else written[1]
    top, *below = re.split(r"(?:^|_)per_", found[1])
    over = [re.sub(r"2$", "^2", part.replace("_", " ")) for part in below]
    # Ns is written as one word in some names.
    return "/".join([(top or "1").replace("_", " ").replace("Ns", "N s"), *over])


def markdown(only: str | None = None) -> str:
    """Write docs/scenario.md, or its part on one table."""
    parts = [_HEAD] if only is None else []
    for name, about, keys in tables():
        if only not in (None, name or "scenario"):
            continue
        parts.append(f"\n## {f'`[{name}]`' if name else 'At the top of the file'}\n\n{about}\n")
        parts.append("\n| key | type | unit | default | meaning |\n|---|---|---|---|---|\n")
        for key in keys:
            default = key.default if key.default == _ABSENT else f"`{key.default}`"
            cells = (f"`{key.name}`", key.kind, key.unit, default, key.meaning)
            parts.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |\n")
    return "".join(parts).lstrip("\n")


_WORDS = {int: "integer", float: "number", str: "text", bool: "flag", type(None): "", Any: "value"}


def _type(hint: Any) -> str:
    """Write a type in the words of a TOML file."""
    if hint in _WORDS:
        return _WORDS[hint]
    origin, inside = get_origin(hint), get_args(hint)
    if origin is typing.Annotated:
        return _type(inside[0])
    if origin is Literal:
        return " | ".join(repr(value) for value in inside)
    if origin in (typing.Union, types.UnionType):
        return " | ".join(dict.fromkeys(text for part in inside if (text := _type(part))))
    if origin is tuple:
        one = re.sub(r"^list", "lists", _type(inside[0])) if get_origin(inside[0]) is tuple else f"{_type(inside[0])}s"
        return f"list of {one}" if inside[-1] is Ellipsis else f"list of {len(inside)} {one}"
    if origin is dict:
        return f"table of {_type(inside[1])}s"
    return str(getattr(hint, "__name__", hint))


def _value(value: Any) -> str:
    """Write a default as in a TOML file, which has no None."""
    return _ABSENT if value is None else json.dumps(value).replace("Infinity", "inf")

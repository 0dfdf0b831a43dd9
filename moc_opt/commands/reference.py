"""moc-opt keys: every key of a scenario, read from the schema."""

from __future__ import annotations

import argparse
import json
import re
import types
import typing
from collections.abc import Iterator
from typing import Any, Literal, get_args, get_origin

from rich.padding import Padding

from moc_opt.errors import UnknownNameError
from moc_opt.inputs.files import to_toml
from moc_opt.inputs.settings import Settings
from moc_opt.report.console import console
from moc_opt.scenario.config import PRESETS, Scenario, without_none

TOP, ABSENT = "scenario", "left out"
HEAD = """# The keys of a scenario

A scenario is a TOML file. A key that is left out takes its default. The following is a whole scenario:

    [task]
    path = "spiral"

    [control]
    preset = "tuned"

A number's unit is at the end of the key, or in brackets in the meaning. For example, `_m_per_s` is m/s, and `_ticks` is
in control periods. In `[guard]`, `inf` switches off a limit of RCM error or force. Relative paths start at the file's
folder. `moc-opt keys --markdown` writes this page. [method.md](method.md) explains the control law and its terms.
"""
WORDS = {int: "integer", float: "number", str: "text", bool: "flag", type(None): "", Any: "value"}
PAGE = re.compile(r"docs/(\w+\.md)")

Key = tuple[str, str, str, str]  # name, type, default and meaning


def print_keys(given: argparse.Namespace) -> int:
    """Print the keys of all tables, or of the given table."""
    names = [name or TOP for name, _, _ in tables()]
    if given.table is not None and given.table not in names:
        raise UnknownNameError("table of a scenario", given.table, names)
    if given.markdown:
        print(markdown(given.table), end="")
        return 0
    screen = console()
    for name, about, keys in tables():
        if given.table in (None, name or TOP):
            screen.print(f"\n[{name}]" if name else "At the top of the file", about, sep="\n", markup=False)
            for key, kind_of, default, meaning in keys:
                screen.print(f"  {key} = {default}  ({kind_of})", Padding(meaning, (0, 0, 0, 6)), markup=False)
    return 0


def tables(kind: type[Settings] = Scenario, path: str = "") -> Iterator[tuple[str, str, list[Key]]]:
    """Yield every table as (name, description, keys). The keys at the top of the file come first, without a name."""
    inner: list[tuple[str, type[Settings]]] = []
    keys: list[Key] = []
    if path in PRESETS:
        sets = {name: without_none(make().model_dump(exclude_defaults=True)) for name, make in PRESETS[path].items()}
        lines = {name: ", ".join(to_toml(values).splitlines()) for name, values in sets.items()}
        told = "; ".join(f"{name!r}: {text or 'the defaults'}" for name, text in lines.items())
        meaning = f"set of values. Keys in the file override it. {told}"
        keys.append(("preset", " | ".join(map(repr, PRESETS[path])), ABSENT, meaning))
    for name, field in kind.model_fields.items():
        hint = field.annotation
        if isinstance(hint, type) and issubclass(hint, Settings):
            inner.append((f"{path}.{name}".lstrip("."), hint))
            continue
        value = field.get_default(call_default_factory=True)
        default = ABSENT if value is None else json.dumps(value).replace("Infinity", "inf")
        keys.append((name, _type(hint), default, kind.meaning(name)))
    yield path, (kind.__doc__ or "").strip().partition("\n")[0], keys
    for below, hint in inner:
        yield from tables(hint, below)


def markdown(only: str | None = None) -> str:
    """Return the text of docs/scenario.md. If ``only`` names a table, return the section about that table."""
    parts = [HEAD] if only is None else []
    for name, about, keys in tables():
        if only not in (None, name or TOP):
            continue
        parts.append(f"\n## {f'`[{name}]`' if name else 'At the top of the file'}\n\n{about}\n")
        parts.append("\n| key | type | default | meaning |\n|---|---|---|---|\n")
        for key, kind_of, default, meaning in keys:
            cells = (f"`{key}`", kind_of, default if default == ABSENT else f"`{default}`", meaning)
            parts.append("| " + " | ".join(PAGE.sub(r"[\1](\1)", cell).replace("|", "\\|") for cell in cells) + " |\n")
    return "".join(parts).lstrip("\n")


def _type(hint: Any) -> str:
    if hint in WORDS:
        return WORDS[hint]
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

"""Files: read (TOML, JSON, numpy's arrays) only where they are regular and of a reasonable size, and written whole.

Bounds on what a small file can cause, for every reader: a pipe or a device that never ends, a text of gigabytes,
keys and lists nested without end, numbers of thousands of digits.
"""

from __future__ import annotations

import contextlib
import io
import json
import math
import os
import re
import secrets
import stat
import tomllib
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from moc_opt.errors import MocOptError, describe, shown

MOST_TEXT = 4 * 2**20
"""Bytes of a text file (TOML, URDF, JSON)."""
MOST_DATA = 4 * 2**30
"""Bytes of a file of numbers (Parquet, .npy)."""
DEEPEST = 64
"""Tables or lists inside one another."""
LARGEST_INTEGER = 2**63 - 1
SMALLEST, LARGEST = 1e-30, 1e30
"""A setting's number is 0, or its size lies between these: beyond them products of a few overflow or vanish."""

# A key of more parts than any table has: the parser's time grows with the square of their number.
_PART = r"(?:[\w-]++|\"[^\"\n]*+\"|'[^'\n]*+')"
_DOTTED = re.compile(rf"(?<![\w-]){_PART}(?:[ \t]*+\.[ \t]*+{_PART}){{{DEEPEST}}}")

_BARE = re.compile(r"[A-Za-z0-9_-]+")  # a key of TOML without quotes

Path_ = str | os.PathLike[str]
Wrong = type[MocOptError]


def as_path(path: object, what: str, error: Wrong) -> Path:
    """Return a path as such.

    Args:
        path: from a caller.
        what, error: as `check_regular`.
    """
    if isinstance(path, str) or (isinstance(path, os.PathLike) and isinstance(os.fspath(path), str)):
        return Path(path)
    raise error(f"{what} {shown(path)} is no path: give the name of a file as text, or a pathlib.Path")


def check_regular(path: Path_, what: str, error: Wrong, most: int = MOST_DATA) -> int:
    """Check that a path names a regular file of a reasonable size, and return its bytes.

    Args:
        path: the file; links are followed.
        what: the kind of file, for messages.
    """
    try:
        found = os.stat(path)
    except FileNotFoundError as reason:
        raise error(f"{what} {_named(path)}: no such file; check the path") from reason
    except (OSError, ValueError) as reason:  # a ValueError: a NUL in the path
        raise error(f"{what} {_named(path)} cannot be read ({reason}); check the path") from reason
    if not stat.S_ISREG(found.st_mode):
        raise error(f"{what} {_named(path)} is no regular file (a folder, pipe or device): give a file")
    if found.st_size > most:
        raise error(f"{what} {_named(path)} has {found.st_size} bytes: {most} at most are read")
    return found.st_size


def check_replaceable(path: Path_, what: str, error: Wrong) -> None:
    """Check that a file may be put here: nothing is there yet, or a regular file.

    A rename puts the new file in the place of a pipe or a device too, /dev/null among them.

    Args:
        path, what, error: as `check_regular`.
    """
    try:
        mode = os.stat(path).st_mode
    except (OSError, ValueError):
        return  # nothing there; other errors of the name are found where it is written
    if not stat.S_ISREG(mode):
        raise error(f"{what} {_named(path)} cannot be written: a folder, pipe or device is there; give another name")


def write_whole(path: Path_, data: bytes) -> None:
    """Write a file, all or nothing: an older one of that name stays until the new one is on the disk.

    A link of that name is replaced, not followed.

    Raises:
        OSError: it cannot be written.
    """
    target = Path(path)
    # In the same folder, because only there is a rename atomic.
    unfinished = target.with_name(f".{target.name}.{secrets.token_hex(6)}.tmp")
    try:
        with open(unfinished, "xb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(unfinished, target)
    except BaseException:
        with contextlib.suppress(OSError):
            unfinished.unlink()
        raise


def read_bytes(path: Path_, what: str, error: Wrong, most: int = MOST_TEXT) -> bytes:
    """Read a regular file of at most ``most`` bytes; arguments as `check_regular`."""
    size = check_regular(path, what, error, most)
    try:
        with open(path, "rb", opener=_without_waiting) as file:
            data = file.read(size or MOST_TEXT + 1)  # the kernel's files have no bytes by their own account
    except OSError as reason:
        raise error(f"{what} {_named(path)} cannot be read ({reason}); check the path") from reason
    except MemoryError as reason:
        raise error(f"{what} {_named(path)} does not fit into the memory") from reason
    if data is None:  # /proc/kmsg, until the kernel has something to say
        raise error(f"{what} {_named(path)} has nothing to read now: give the path of a file on a disk")
    if len(data) > most:
        raise error(f"{what} {_named(path)} has more than {most} bytes: no more are read")
    return data


def _without_waiting(path: str, flags: int) -> int:
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def read_text(path: Path_, what: str, error: Wrong, most: int = MOST_TEXT) -> str:
    """Read a text file in UTF-8; arguments as `check_regular`."""
    try:
        return read_bytes(path, what, error, most).decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as reason:
        raise error(f"{what} {_named(path)} cannot be read: not UTF-8 ({reason}); save it as such") from reason


def read_toml(path: Path_, what: str, error: Wrong) -> dict[str, Any]:
    """Read a TOML file; arguments as `check_regular`."""
    text, where = read_text(path, what, error), f"{what} {_named(path)}"
    if _DOTTED.search(text):
        raise error(f"{where}: a key of more than {DEEPEST} dotted parts: no table here is nested so deep")
    try:
        table = tomllib.loads(text)
    except RecursionError as reason:
        raise error(f"{where}: tables or lists in it are nested too deep") from reason
    except ValueError as reason:  # not only the parser's own: an integer of thousands of digits
        raise error(f"{where} is not TOML: {reason}") from reason
    check_values(table, where, error)
    return table


def read_json(path: Path_, what: str, error: Wrong, most: int = MOST_TEXT) -> Any:
    """Read a JSON file; arguments as `check_regular`."""
    return parse_json(read_text(path, what, error, most), f"{what} {_named(path)}", error)


def parse_json(text: str | bytes, where: str, error: Wrong) -> Any:
    """Return the value of a JSON text; NaN and infinity are no JSON."""
    try:
        value = json.loads(text, parse_constant=_no_constant)
    except RecursionError as reason:
        raise error(f"{where}: nested too deep") from reason
    except ValueError as reason:
        raise error(f"{where} is not JSON: {reason}") from reason
    check_values(value, where, error)
    return value


def check_values(value: Any, where: str, error: Wrong) -> None:
    """Check that nothing is nested deeper than `DEEPEST`, and that integers fit into 64 bits."""
    for path, depth, entry in entries(value):
        if depth > DEEPEST:
            raise error(f"{where}: {path[:80]}... is nested too deep, {DEEPEST} levels are the most")
        if isinstance(entry, int) and not -LARGEST_INTEGER <= entry <= LARGEST_INTEGER:
            raise error(f"{where}: {path} = {shown(entry)}: an integer has 64 bits")


def wrong_size(value: Any, most: int = LARGEST_INTEGER) -> str:
    """Return which number inside has no usable size, or what is nested too deep; empty if nothing is.

    Args:
        value: of a setting; numbers in lists and tables count.
    """
    for path, depth, entry in entries(value):
        if depth > DEEPEST:
            return f"nested deeper than {DEEPEST} levels"
        where = f"{path} = {shown(entry)}: " if path else ""
        if isinstance(entry, int) and not -most <= entry <= most:
            return f"{where}give an integer of at most {most}"
        if isinstance(entry, float) and entry != 0.0 and not SMALLEST <= abs(entry) <= LARGEST:
            return f"{where}give 0, or a size from {SMALLEST:g} to {LARGEST:g}"
    return ""


def entries(value: Any) -> Iterator[tuple[str, int, Any]]:
    """Yield every value inside: its path, its depth, itself; with an explicit stack, for any depth."""
    stack: list[tuple[str, int, Any]] = [("", 0, value)]
    while stack:
        path, depth, entry = stack.pop()
        yield path, depth, entry
        if depth > DEEPEST:
            continue
        if isinstance(entry, Mapping):
            stack += [(f"{path}.{key!s:.80}" if path else f"{key!s:.80}", depth + 1, v) for key, v in entry.items()]
        elif isinstance(entry, list | tuple):
            stack += [(f"{path}[{i}]", depth + 1, v) for i, v in enumerate(entry)]


def _no_constant(name: str) -> float:
    raise ValueError(f"{name} is no JSON")


def _named(path: Path_) -> str:
    return repr(os.fspath(path))


def read_arrays(path: Path_, what: str, error: Wrong, most: int = 2**27) -> dict[str, Any]:
    """Read the arrays of a .npz file, or that of a .npy file under the name "", as numpy arrays.

    Args:
        path, what, error: as `check_regular`.
        most: bytes of the file, and of all its arrays together.
    """
    import numpy as np

    data, where = read_bytes(path, what, error, most), f"{what} {_named(path)}"
    try:
        if not data.startswith(b"PK"):
            return {"": np.load(io.BytesIO(data), allow_pickle=False)}
        with zipfile.ZipFile(io.BytesIO(data)) as inside:
            if sum(one.file_size for one in inside.infolist()) > most:
                raise ValueError(f"more than {most} bytes of arrays")
        with np.load(io.BytesIO(data), allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except Exception as reason:  # whatever a damaged archive makes its readers say
        raise error(f"{where} is damaged or no file of arrays: {describe(reason)}") from reason


def plain(value: Any) -> Any:
    """Return the same with nothing but JSON's own types; numpy's numbers as numbers, NaN and infinity as None."""
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def to_json(value: Any, *, indent: int | None = 2, sort_keys: bool = False) -> str:
    """Write as JSON that any reader takes: a number that is not finite becomes null.

    Raises:
        TypeError: a value that JSON cannot hold.
    """
    return json.dumps(plain(value), indent=indent, sort_keys=sort_keys, allow_nan=False)


def file_in(folder: Path, name: str) -> Path:
    """Return a free name in a folder, made if need be: ``name``, or with a number before it."""
    folder.mkdir(parents=True, exist_ok=True)
    free, number = folder / name, 0
    while free.exists() or free.is_symlink():
        number += 1
        free = folder / f"{number}-{name}"
    return free


def to_toml(table: Mapping[str, Any]) -> str:
    """Write a table of texts, numbers, flags, lists and tables as TOML: `read_toml` reads the same, to the last bit.

    Raises:
        TypeError: a value that TOML cannot hold, None among them; the message names its key.
    """
    return "\n".join(_toml_lines(table, ())).lstrip("\n") + "\n"


def _toml_lines(table: Mapping[str, Any], above: tuple[str, ...]) -> list[str]:
    values = {key: value for key, value in table.items() if not isinstance(value, Mapping)}
    lines = [f"{_toml_key(key)} = {_toml_value(value, '.'.join((*above, key)))}" for key, value in values.items()]
    for key, value in table.items():
        if isinstance(value, Mapping):
            inside = _toml_lines(value, (*above, key))
            # A table of tables alone needs no heading of its own.
            if not (inside and inside[0].startswith("\n")):
                lines.append(f"\n[{'.'.join(map(_toml_key, (*above, key)))}]")
            lines += inside
    return lines


def _toml_key(key: str) -> str:
    return key if _BARE.fullmatch(key) else _toml_text(key)


def _toml_text(text: str) -> str:
    # JSON's escapes are TOML's, but for DEL, and for characters beyond 16 bits, which stay as they are.
    return json.dumps(text, ensure_ascii=False, allow_nan=False).replace("\x7f", "\\u007f")


def _toml_value(value: Any, where: str) -> str:
    if hasattr(value, "tolist"):  # numpy's numbers and arrays
        value = value.tolist()
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return _toml_text(value)
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, list | tuple):
        return f"[{', '.join(_toml_value(entry, where) for entry in value)}]"
    if isinstance(value, Mapping):  # in a list
        return f"{{{', '.join(f'{_toml_key(key)} = {_toml_value(entry, where)}' for key, entry in value.items())}}}"
    raise TypeError(f"{where} = {value!r:.200} has no form in TOML: give a text, number, flag, list or table")

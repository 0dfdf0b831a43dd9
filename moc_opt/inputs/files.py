"""Read files up to a maximum size, and write files completely or not at all.

On failure, a function raises its argument ``error``. The message begins with the argument ``what``, the kind of file.
"""

from __future__ import annotations

import contextlib
import errno
import io
import json
import math
import os
import re
import secrets
import stat
import tempfile
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from moc_opt.errors import MocOptError, shown

MOST_TEXT = 4 * 2**20  #: Largest text file [bytes].
MOST_ARRAYS = 2**27  #: Largest .npy or .npz file [bytes].
MOST_DATA = 4 * 2**30  #: Largest Parquet file [bytes].

Path_ = str | os.PathLike[str]
Wrong = type[MocOptError]


def as_path(path: object, what: str, error: Wrong) -> Path:
    """Return ``path`` as a Path. Raise ``error`` if it is no path."""
    if isinstance(path, str) or (isinstance(path, os.PathLike) and isinstance(os.fspath(path), str)):
        return Path(path)
    raise error(f"{what} {shown(path)} is no path: give the name of a file as text, or a pathlib.Path")


def read_bytes(path: Path_, what: str, error: Wrong, most: int = MOST_TEXT) -> bytes:
    """Read a regular file of at most ``most`` bytes."""
    try:
        found = os.stat(path)
        if not stat.S_ISREG(found.st_mode):
            why = " is no regular file (a folder, pipe or device): give a file"
        elif found.st_size > most:
            why = f" has {found.st_size} bytes: give a file of at most {most} bytes"
        else:
            return Path(path).read_bytes()
    except FileNotFoundError:
        why = ": no such file; check the path"
    except (OSError, ValueError) as reason:  # ValueError: the name has a NUL
        why = f" cannot be read ({reason}); check the path"
    raise error(f"{what} {os.fspath(path)!r}{why}")


def read_text(path: Path_, what: str, error: Wrong) -> str:
    """Read a text file in UTF-8."""
    try:
        return read_bytes(path, what, error).decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as reason:
        raise error(f"{what} {os.fspath(path)!r} is not a text in UTF-8 ({reason}); save it in UTF-8") from reason


def read_toml(path: Path_, what: str, error: Wrong) -> dict[str, Any]:
    """Read a TOML file."""
    text = read_text(path, what, error)
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as reason:  # ValueError: also raised for thousands of digits
        raise error(f"{what} {os.fspath(path)!r} is not TOML: {reason}") from reason


def read_arrays(path: Path_, what: str, error: Wrong) -> dict[str, Any]:
    """Read the arrays of a .npz file by name. The array of a .npy file has the name ""."""
    import numpy as np

    data = read_bytes(path, what, error, MOST_ARRAYS)
    try:
        found = np.load(io.BytesIO(data), allow_pickle=False)
        return {"": found} if isinstance(found, np.ndarray) else dict(found)
    except Exception as reason:  # a damaged file may raise anything
        why = f"{what} {os.fspath(path)!r} is damaged, or is not a file of arrays ({type(reason).__name__})"
        raise error(f"{why}: write it with numpy.save") from reason


def decimal(text: str) -> float:
    """Read a decimal number. Other texts give NaN."""
    return float(text) if re.fullmatch(r"[+-]?(\d+(\.\d*)?|\.\d+)(e[+-]?\d+)?", text, re.ASCII | re.I) else math.nan


def check_replaceable(path: Path_, what: str, error: Wrong) -> Path:
    """Check that a file can be written at this path."""
    target = as_path(path, what, error)
    with _writing(target, what, error):
        with contextlib.suppress(FileNotFoundError):
            if not stat.S_ISREG(os.stat(target).st_mode):
                raise OSError("a folder, pipe or device is there")
        folder = next(folder for folder in (*target.absolute().parents, target) if folder.exists())
        with tempfile.TemporaryFile(dir=folder):  # try it: permission bits do not show that root cannot write to /proc
            pass
    return target


def write_whole(path: Path_, data: bytes | str, what: str = "file", error: Wrong = MocOptError) -> Path:
    """Write bytes, or a text in UTF-8, completely or not at all. A missing folder is made. A link is replaced."""
    target = check_replaceable(path, what, error)
    # In the same folder, because a rename is atomic only within one file system.
    unfinished = target.with_name(f".{target.name[:40]}.{secrets.token_hex(8)}.tmp")
    with _writing(target, what, error):
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            with open(unfinished, "xb") as file:  # "x" follows no link
                file.write(data.encode() if isinstance(data, str) else data)
                file.flush()
                os.fsync(file.fileno())
            os.replace(unfinished, target)
        finally:
            with contextlib.suppress(OSError, ValueError):
                unfinished.unlink()
    return target


@contextlib.contextmanager
def _writing(target: Path, what: str, error: Wrong) -> Iterator[None]:
    try:
        yield
    except (OSError, ValueError) as reason:  # ValueError: the name has a NUL
        why = getattr(reason, "strerror", None) or str(reason)
        full = getattr(reason, "errno", None) in (errno.ENOSPC, errno.EDQUOT)
        cure = "make room on the disk" if full else "choose a folder that you may write to"
        raise error(
            f"{what} {str(target)!r} cannot be written in the folder {str(target.absolute().parent)!r} ({why}): {cure}"
        ) from reason


def plain(value: Any) -> Any:
    """Convert a value to JSON's types. NaN and infinity become None."""
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
    """Return a value as strict JSON, with NaN and infinity as null. Raise a TypeError if this fails."""
    return json.dumps(plain(value), indent=indent, sort_keys=sort_keys, allow_nan=False)


def to_toml(table: Mapping[str, Any]) -> str:
    """Return a table as TOML. Raises a TypeError for a value that TOML cannot hold, such as None."""
    tables = {key: value for key, value in table.items() if isinstance(value, Mapping)}
    lines = _toml_entries({key: value for key, value in table.items() if key not in tables}, "")
    for name, inner in tables.items():
        lines += [f"\n[{_toml_key(name)}]", *_toml_entries(inner, f"{name}.")]
    return "\n".join(lines).lstrip("\n") + "\n"


def _toml_entries(table: Mapping[str, Any], above: str) -> list[str]:
    return [f"{_toml_key(key)} = {_toml_value(value, f'{above}{key}')}" for key, value in table.items()]


def _toml_key(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else _toml_value(key, key)


def _toml_value(value: Any, where: str) -> str:
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, float):
        return repr(value)
    if isinstance(value, str | int):  # bool is an int; TOML takes JSON's escapes, but no bare DEL
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, list | tuple):
        return f"[{', '.join(_toml_value(entry, where) for entry in value)}]"
    if isinstance(value, Mapping):
        return f"{{{', '.join(_toml_entries(value, f'{where}.'))}}}"
    raise TypeError(f"{where} = {value!r:.200} has no form in TOML: give a text, number, flag, list or table")

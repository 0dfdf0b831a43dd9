"""Finished parts of a benchmark in a folder: a second run goes on where the first one stopped.

A part is a few arrays and some plain values in one .npz file, named by a digest of everything that decides what is
in it: what was asked for, the data, the versions of the libraries and the source of this package.
"""

from __future__ import annotations

import functools
import hashlib
import importlib.metadata
import io
import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.common.output import PACKAGES, write_atomically
from moc_opt.errors import MocOptError
from moc_opt.inputs.files import file_in, parse_json, read_arrays, read_bytes, to_json

ROOT = Path(__file__).resolve().parents[2]
META = "_meta"
MOST_BYTES = 2**27


class Part(NamedTuple):
    """What was found out: plain values and arrays by name."""

    values: dict[str, Any]
    arrays: dict[str, NDArray[Any]]


class Store:
    """Parts in ``folder``; None keeps nothing.

    Args:
        sources: files of benchmarks/, without ending, that a part depends on beside the package itself.
    """

    def __init__(self, folder: Path | None, sources: tuple[str, ...] = ()) -> None:
        self.folder, self._sources = folder, sources
        self._before = set() if folder is None else {path.name for path in folder.glob("*.npz")}
        self.reused = 0  # parts of an earlier run

    def key(self, **what: Any) -> str:
        """Return the digest of a description in plain values; arrays in it count with their bytes."""
        text = json.dumps(_plain(what), sort_keys=True, allow_nan=False)
        return hashlib.sha256(f"{text}\n{circumstances(self._sources)}".encode()).hexdigest()[:24]

    def get(self, key: str) -> Part | None:
        """Return the part, or None; a damaged one is set aside with a line on stderr."""
        path = self._path(key)
        if path is None or not path.exists():
            return None
        try:
            values, arrays = _opened(path)
        except MocOptError as error:
            aside = file_in(path.parent / "damaged", path.name)
            path.rename(aside)
            print(f"{error}; set aside as {aside}, and done again", file=sys.stderr)
            return None
        self.reused += path.name in self._before
        return Part(values, arrays)

    def put(self, key: str, part: Part) -> Part:
        """Keep it; returns what ``get`` will return."""
        path = self._path(key)
        if path is not None:
            buffer = io.BytesIO()
            meta = np.array(to_json(part.values, indent=None))
            np.savez(buffer, **{META: meta}, **part.arrays)  # type: ignore[arg-type]
            data = buffer.getvalue()
            write_atomically(path, data + hashlib.sha256(data).digest())
        return part

    def _path(self, key: str) -> Path | None:
        return None if self.folder is None else self.folder / f"{key}.npz"


def _opened(path: Path) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return the values and arrays of a part.

    Raises:
        MocOptError: damaged, or not written by ``put``.
    """
    what = "kept part"
    # The digest behind the archive also covers what the archive's own checksums leave out: names and types.
    data = read_bytes(path, what, MocOptError, MOST_BYTES)
    if hashlib.sha256(data[:-32]).digest() != data[-32:]:
        raise MocOptError(f"{what} {path} is damaged")
    arrays = read_arrays(path, what, MocOptError, MOST_BYTES)
    meta = arrays.pop(META, None)
    values = parse_json(str(meta), f"{what} {path}", MocOptError)
    if not isinstance(values, dict):
        raise MocOptError(f"{what} {path} has no values")
    return values, arrays


@functools.cache
def circumstances(sources: tuple[str, ...] = ()) -> str:
    """Return the versions of the libraries, and a digest of the package's sources and of these of benchmarks/."""
    versions = []
    for name in PACKAGES:
        try:
            versions.append(f"{name}={importlib.metadata.version(name)}")
        except importlib.metadata.PackageNotFoundError:
            continue
    digest = hashlib.sha256()
    files = [*sorted((ROOT / "moc_opt").rglob("*.py")), *sorted((ROOT / "moc_opt" / "robots").glob("*.[tu]*"))]
    files += [ROOT / "benchmarks" / f"{name}.py" for name in sources]
    for file in files:
        if not {"report", "figures"} & set(file.parts):
            digest.update(file.read_bytes())
    return f"{' '.join(versions)} {digest.hexdigest()}"


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(name): _plain(entry) for name, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, np.ndarray):
        return hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()
    return value

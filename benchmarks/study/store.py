"""Finished parts of the study in its folder: a second run goes on where the first one stopped.

A part is a few arrays and some plain values in one .npz file, named by a digest of everything that decides what is
in it: what was asked for, the data, the versions of the libraries and the source of this package.
"""

from __future__ import annotations

import functools
import hashlib
import importlib.metadata
import io
import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.output import PACKAGES, plain, write_atomically

ROOT = Path(__file__).resolve().parents[2]
# What decides a part's content, beside the package itself; reports and figures do not.
SOURCES = (
    "timing", "arms", "study/closed_loop", "study/open_loop", "study/answers", "study/loop", "study/growth",
    "study/worker",
)  # fmt: skip
META = "_meta"


class Part(NamedTuple):
    """What was found out: plain values and arrays by name."""

    values: dict[str, Any]
    arrays: dict[str, NDArray[Any]]


class Store:
    """Parts in ``folder``; None keeps nothing."""

    def __init__(self, folder: Path | None) -> None:
        self.folder = folder
        self._before = set() if folder is None else {path.name for path in folder.glob("*.npz")}
        self.reused = 0  # parts of an earlier run

    def key(self, **what: Any) -> str:
        """Digest of a description in plain values; arrays in it count with their bytes."""
        text = json.dumps(_plain(what), sort_keys=True)
        return hashlib.sha256(f"{text}\n{circumstances()}".encode()).hexdigest()[:24]

    def get(self, key: str) -> Part | None:
        """The part, or None where there is none; a damaged one counts as none."""
        path = self._path(key)
        if path is None or not path.exists():
            return None
        try:
            with np.load(path, allow_pickle=False) as file:
                arrays = {name: file[name] for name in file.files}
            values = json.loads(str(arrays.pop(META)[()]))
        except (OSError, ValueError, KeyError, zipfile.BadZipFile):
            path.unlink(missing_ok=True)
            return None
        self.reused += path.name in self._before
        return Part(values, arrays)

    def put(self, key: str, part: Part) -> Part:
        """Keep it; returns what ``get`` will return."""
        path = self._path(key)
        if path is not None:
            buffer = io.BytesIO()
            meta = np.array(json.dumps(plain(part.values)))
            np.savez_compressed(buffer, **{META: meta}, **part.arrays)  # type: ignore[arg-type]
            write_atomically(path, buffer.getvalue())
        return part

    def _path(self, key: str) -> Path | None:
        return None if self.folder is None else self.folder / f"{key}.npz"


@functools.cache
def circumstances() -> str:
    """Versions of the libraries, and a digest of the sources that a part depends on."""
    versions = []
    for name in PACKAGES:
        try:
            versions.append(f"{name}={importlib.metadata.version(name)}")
        except importlib.metadata.PackageNotFoundError:
            continue
    digest = hashlib.sha256()
    files = [
        *sorted((ROOT / "moc_opt").rglob("*.py")),
        *sorted((ROOT / "moc_opt" / "robots").glob("*.[tu]*")),
    ]
    files += [ROOT / "benchmarks" / f"{name}.py" for name in SOURCES]
    for file in files:
        if "report" not in file.parts and file.exists():
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

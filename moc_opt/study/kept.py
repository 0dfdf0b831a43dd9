"""A store of finished jobs, from which a stopped study continues.

A result is reused if the job, the files that its settings name, the packages' versions, the robots' files and the
imported sources are unchanged.
"""

from __future__ import annotations

import dataclasses
import hashlib
import importlib.metadata
import os
import pickle
import sqlite3
import sys
import sysconfig
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from functools import cache, lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import diskcache
import numpy as np
from pydantic import BaseModel

from moc_opt import core
from moc_opt.errors import StudyError
from moc_opt.inputs.files import read_toml, to_json
from moc_opt.inputs.plugins import plugins
from moc_opt.solvers import registry
from moc_opt.tasks import paths
from moc_opt.trace import metrics

PACKAGES = (
    "moc-opt", "numpy", "scipy", "pin", "mujoco", "casadi", "osqp", "proxsuite", "qpsolvers", "daqp", "piqp",
    "quadprog", "clarabel", "scs", "highspy", "polars", "pydantic", "tsid", "pin-pink", "mink",
)  # fmt: skip
SHOWS = ("report", "figures", "commands", "live")  # subpackages without influence on results
HOME = Path(core.__file__).parents[1]


class _Entry(NamedTuple):
    result: Any
    sources: tuple[str, ...]
    digest: str


class Kept:
    """Finished jobs in ``folder``. Raise a StudyError if the folder cannot be used."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.reused = folder, 0
        try:
            self._cache: Any = diskcache.Cache(folder, eviction_policy="none")
        except (OSError, sqlite3.Error) as error:
            cure = "remove it, or give another --out" if folder.exists() else "give another --out"
            raise StudyError(f"{folder} cannot keep finished jobs ({error}): {cure}") from error

    def get(self, key: str) -> tuple[Any] | None:
        """Return (result,), or None if there is no valid result."""
        try:
            entry = self._cache.get(key)
        except Exception as error:  # noqa: BLE001 - unpickling may raise anything
            print(f"{self.folder}: a finished job cannot be read ({error}) and is run again", file=sys.stderr)
            return None
        if not isinstance(entry, _Entry) or digest_of(entry.sources) != entry.digest:
            return None
        self.reused += 1
        return (entry.result,)

    def put(self, key: str, result: Any, sources: tuple[str, ...]) -> None:
        """Store a result. Raise a StudyError if this fails."""
        try:
            self._cache[key] = _Entry(result, sources, digest_of(sources))
        except (OSError, sqlite3.Error) as error:
            raise StudyError(f"{self.folder}: a finished job cannot be kept: {error}; earlier jobs remain") from error


def key_of(work: Callable[..., Any], arguments: Iterable[Any]) -> str:
    """Return the digest of a job."""
    code = getattr(work, "__code__", None)  # on a cluster, `loaded_sources` can lack the file that defines `work`
    own = "" if code is None else _file_digest(code.co_filename)
    given = [one if isinstance(one, str) else _plain(one) for one in arguments]  # a text may name the job's output
    asked = [work.__module__, work.__qualname__, own, given, versions()]
    return hashlib.sha256(to_json(asked, indent=None, sort_keys=True).encode()).hexdigest()


def loaded_sources() -> tuple[str, ...]:
    """Return the imported files and plug-ins, except those of Python, of other packages and of `SHOWS`."""
    return _sources(tuple(sys.modules))


@lru_cache(maxsize=1)
def _sources(modules: tuple[str, ...]) -> tuple[str, ...]:
    groups = (registry.GROUP, paths.GROUP, metrics.GROUP)
    packages = {
        point.module.partition(".")[0] for group in groups for points in plugins(group).values() for point in points
    }
    installed = {Path(sysconfig.get_path(kind)) for kind in ("stdlib", "platstdlib", "purelib", "platlib")}
    shows = {HOME / room for room in SHOWS}
    found = set[str]()
    for name in modules:
        if path := getattr(sys.modules.get(name), "__file__", None):
            file, plugin = Path(path), name.partition(".")[0] in packages
            rooms = {*file.parents}
            if not shows & rooms and (plugin or HOME in rooms or not installed & rooms):
                found.add(str(file.relative_to(HOME.parent) if HOME.parent in rooms else file))
    return tuple(sorted(found))


def digest_of(sources: tuple[str, ...]) -> str:
    """Return a digest of these files and the robots' files."""
    digest = hashlib.sha256()
    for file in (*sources, *robot_files()):
        digest.update(f"{file} {_file_digest(file)}\n".encode())
    return digest.hexdigest()


@cache
def robot_files() -> tuple[str, ...]:
    """Return the arms' URDF and TOML files."""
    return tuple(sorted(str(file.relative_to(HOME.parent)) for file in (HOME / "robots").rglob("*.[tu]*")))


@cache
def versions() -> dict[str, str | None]:
    """Return each package's version, or None if it is not installed."""
    found: dict[str, str | None] = dict.fromkeys(PACKAGES)
    for name in PACKAGES:
        with suppress(importlib.metadata.PackageNotFoundError):
            found[name] = importlib.metadata.version(name)
    return found


@cache
def _file_digest(file: str, changed: tuple[int, int] = (0, 0)) -> str:
    """Return a file's digest, or "gone". Read it again only if ``changed``, its time and size, differs."""
    try:
        with open(HOME.parent / file, "rb") as read:
            return hashlib.file_digest(read, "sha256").hexdigest()
    except OSError:
        return "gone"


def _named(value: Any, folder: str = "") -> dict[str, str]:
    """Return the digests of the files that the texts of JSON data name, and of those that a robot's TOML names."""
    if isinstance(value, str):
        file = os.path.join(folder, value)
        if not os.path.isfile(file):
            return {}
        at = os.stat(file)
        found = {file: _file_digest(os.path.abspath(file), (at.st_mtime_ns, at.st_size))}
        stem, kind = os.path.splitext(file)
        if kind.lower() == ".urdf" and not folder:
            found |= _named(f"{stem}.toml")
        elif kind.lower() == ".toml" and not folder:
            with suppress(StudyError):  # the job reports the error
                found |= _named(read_toml(file, "robot file", StudyError), os.path.dirname(file) or ".")
        return found
    entries = value.values() if isinstance(value, dict) else value if isinstance(value, list | tuple) else ()
    return {file: digest for entry in entries for file, digest in _named(entry, folder).items()}


def _plain(value: Any) -> Any:
    """Return a job's argument as JSON data."""
    if isinstance(value, str):
        return [value, _named(value)]
    if value is None or isinstance(value, bool | int | float | Path):
        return repr(value)
    if isinstance(value, BaseModel):
        return [type(value).__qualname__, _plain(value.model_dump(mode="json"))]
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {field.name: _plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
        return [type(value).__qualname__, fields]
    if isinstance(value, Mapping):
        return {str(name): _plain(entry) for name, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, np.ndarray):
        return [str(value.dtype), value.shape, hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()]
    if isinstance(value, partial):
        return ["partial", _plain(value.func), _plain(value.args), _plain(value.keywords)]
    if callable(value):
        return f"{value.__module__}.{value.__qualname__}"
    return hashlib.sha256(pickle.dumps(value)).hexdigest()

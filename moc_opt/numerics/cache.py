"""Compile kernels with a cache that is keyed by their sources.

numba keys the cached machine code of a kernel by the file that it stands in, and misses an edit of a kernel in another
file that it calls, or of a constant that it froze. Here the key is a hash over that file and every module of this
package that it imports, directly or through others: a stale cache is compiled anew, and never runs.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numba
from numba.core.caching import InTreeCacheLocator, UserProvidedCacheLocator, UserWideCacheLocator

_PACKAGE = Path(__file__).resolve().parent.parent
_IMPORT = re.compile(rf"^\s*(?:from|import) +{_PACKAGE.name}([.\w]*)(?: +import +(\([\w\s,]*|[\w ,]*))?", re.MULTILINE)


@cache
def _read(file: Path) -> tuple[bytes, frozenset[Path]]:
    """Hash one file of the package, and list the files of it that its imports name."""
    text, found = file.read_bytes(), set()
    for module, names in _IMPORT.findall(text.decode()):
        place = _PACKAGE.joinpath(*filter(None, module.split(".")))
        if place.is_dir():
            inside = [place / name.split()[0] for name in names.strip("(").split(",") if name.strip()]
            found |= {path for each in inside for path in (each.with_suffix(".py"), each / "__init__.py")}
        found |= {place.with_suffix(".py"), place / "__init__.py"}
    return hashlib.sha256(text).digest(), frozenset(path for path in found if path.is_file())


@cache
def source_key(file: Path) -> str:
    """Hash the sources that kernels in ``file`` may be compiled from: it, and all that it imports of its package."""
    seen, waiting = set(), {file.resolve()}
    while waiting:
        here = waiting.pop()
        seen.add(here)
        waiting |= _read(here)[1] - seen
    return hashlib.sha256(b"".join(_read(path)[0] for path in sorted(seen))).hexdigest()


class _Keyed:
    """Stamps cached code with `source_key` where numba's own locators take one file's time and size."""

    _py_file: str

    def get_source_stamp(self) -> str:
        """Return what the cached code must have been made from."""
        return source_key(Path(self._py_file))


class UserProvided(_Keyed, UserProvidedCacheLocator):  # type: ignore[misc]
    """In the folder that NUMBA_CACHE_DIR names."""


class InTree(_Keyed, InTreeCacheLocator):  # type: ignore[misc]
    """In the __pycache__ beside the source."""


class UserWide(_Keyed, UserWideCacheLocator):  # type: ignore[misc]
    """In the user's own cache folder, where that beside the source cannot be written."""


_LOCATORS = ",".join(f"{__name__}.{kind.__name__}" for kind in (UserProvided, InTree, UserWide))


def njit(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """Compile a function as `numba.njit` does, with the cache of this module where ``cache`` is set."""
    if function is None:
        return lambda function: njit(function, **options)
    before = numba.config.CACHE_LOCATOR_CLASSES
    try:
        numba.config.CACHE_LOCATOR_CLASSES = before or _LOCATORS
        return numba.njit(**options)(function)
    finally:
        numba.config.CACHE_LOCATOR_CLASSES = before

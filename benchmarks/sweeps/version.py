"""Which code a run is done with: results of two are not one sweep, even where the version is the same."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path

import moc_opt

SUFFIXES = (".py", ".toml", ".urdf")
SPARED = ("report", "__main__.py")  # what is shown of a run changes nothing in it


@cache
def code_version() -> str:
    """Return the version of moc_opt and a hash of its source and data, as they were when first asked for."""
    root = Path(moc_opt.__file__).parent
    found = hashlib.sha256()
    for path in sorted(root.rglob("*")):
        inside = path.relative_to(root)
        if path.suffix in SUFFIXES and inside.parts[0] not in SPARED:
            found.update(f"{inside.as_posix()}\0".encode() + path.read_bytes() + b"\0")
    return f"{moc_opt.__version__}+{found.hexdigest()[:12]}"

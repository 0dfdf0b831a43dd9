"""The pieces of a sweep's folder: one finished run, sealed with a checksum, and which runs a shard holds."""

from __future__ import annotations

import json
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.sweeps.errors import StoreError
from benchmarks.sweeps.plan import Plan
from benchmarks.sweeps.table import read_shard, shard_plan
from moc_opt.inputs.files import parse_json, read_json, to_json


def sealed(record: Mapping[str, Any], digest: str) -> tuple[bytes, dict[str, Any]]:
    """Make a run's file for the sweep of that digest, and the record as it will be read."""
    text = to_json(record, indent=None, sort_keys=True)
    whole = {"crc": _checksum(digest, text), "plan": digest, "record": text}
    return to_json(whole, indent=None).encode(), json.loads(text)


def opened(path: Path, digest: str) -> dict[str, Any] | None:
    """Return the record in a file, or None where that is damaged, or of another sweep than that of the digest."""
    try:
        whole = _unsealed(path)
        record = parse_json(whole["record"], str(path), StoreError)
    except StoreError:
        return None
    is_record = isinstance(record, dict) and type(record.get("index")) is int
    return record if is_record and whole["plan"] == digest else None


def _unsealed(path: Path) -> dict[str, str]:
    """Return what a run's file holds: texts ``record`` and ``plan``; StoreError where it is damaged."""
    whole = read_json(path, "run of a sweep", StoreError)
    kinds = {"crc": int, "plan": str, "record": str}
    if not isinstance(whole, dict) or any(type(whole.get(name)) is not kind for name, kind in kinds.items()):
        raise StoreError(f"{path} is no run of a sweep")
    if _checksum(whole["plan"], whole["record"]) != whole["crc"]:
        raise StoreError(f"{path} is damaged")
    return whole


def _checksum(digest: str, text: str) -> int:
    # Of both: a run whose digest alone is damaged would count as one of another sweep, and lock its folder.
    return zlib.crc32(f"{digest} {text}".encode("utf-8", "surrogatepass"))


def shard_indices(path: Path, plan: Plan) -> NDArray[np.int64] | None:
    """Return which runs of the plan a shard holds; None where it is damaged, or no shard of it."""
    try:
        found: NDArray[np.int64] = read_shard(path, plan.digest).column("index").to_numpy()
    except (StoreError, KeyError):
        return None  # the caller sets it aside, and says so
    fits = found.size and found.min() >= 0 and found.max() < len(plan) and len(np.unique(found)) == found.size
    return found if fits else None


def owner(path: Path) -> str | None:
    """Return the digest of the sweep that a run or shard belongs to; None where it is damaged."""
    try:
        return _unsealed(path)["plan"] if path.suffix == ".json" else shard_plan(path)
    except StoreError:
        return None

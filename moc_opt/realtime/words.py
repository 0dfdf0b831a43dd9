"""The controller's counts of a run, sent at its end for the meta of the trace, which the plant writes."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from moc_opt.errors import TraceError, printable
from moc_opt.inputs.files import parse_json, to_json
from moc_opt.realtime.key import WireError
from moc_opt.realtime.packets import WORDS_BYTES
from moc_opt.trace.meta import check_entry

_ENTRIES = ("faults", "restarts", "warnings")


def last_words(controller: object, warnings: list[dict[str, Any]]) -> bytes:
    """Return as JSON what a controller counts, where it does, and the warnings of its safety filter."""
    counted = {name: getattr(controller, name) for name in ("faults", "restarts") if hasattr(controller, name)}
    text = to_json(counted | {"warnings": warnings}, indent=None).encode()
    if len(text) > WORDS_BYTES:  # without the texts of refused answers
        faults = {name: {**fault, "first": ""} for name, fault in counted.get("faults", {}).items()}
        text = to_json({"faults": faults, "warnings": warnings}, indent=None).encode()
    return text


def read_words(words: bytes) -> dict[str, Any]:
    """Return the entries of meta in the last words of a controller; those that are empty or none are left out."""
    try:
        text = printable(words.decode(errors="replace"))
        found = parse_json(text, "last words of the controller", WireError) if text else {}
    except WireError:
        return {}  # of a controller that is not ours; the run is over, and its trace complete without
    told = {}
    for name in _ENTRIES if isinstance(found, dict) else ():
        value = found.get(name)
        if value or (name == "faults" and value is not None):
            with suppress(TraceError):  # as above
                check_entry(name, value)
                told[name] = value
    return told

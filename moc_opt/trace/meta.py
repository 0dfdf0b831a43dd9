"""The required types of a trace's meta: pages and tables use its entries, and a trace may come from anywhere."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

from moc_opt.errors import TraceError, shown

_NUMBER, _OR_NONE = (int, float), type(None)

# A type, or several; a table of what its entries must be where they are there; a list of what each entry must be; a
# table whose only key is "*": of what each entry must be.
FORMS: Mapping[str, Any] = {
    "ended": str, "robot": str, "mu_bound_method": str, "earlier_run": str,
    "ticks": int, "ticks_planned": int, "period_s": _NUMBER, "stopped_at_s": _NUMBER,
    "faults": {"*": {"count!": int, "first_at_s!": _NUMBER, "first!": str}},
    "restarts": [{"at_s!": _NUMBER, "reason!": str}],
    "warnings": [{"of!": str, "unit!": str, "level!": _NUMBER, "first_s!": _NUMBER, "largest!": _NUMBER}],
    "scenario": {
        "robot": {"name": str, "tool_length_m": (*_NUMBER, _OR_NONE), "tool_mass_kg": (*_NUMBER, _OR_NONE)},
        "control": {"law": str, "third_level": str},
    },
    "best_courses": {
        "absent": str,
        "end": {
            "mu!": _NUMBER, "top_mu!": _NUMBER, "top_swivel_deg!": _NUMBER, "at_limit!": bool, "best_mu!": _NUMBER,
            "best_swivel_deg!": _NUMBER,
        },
    },
}  # fmt: skip
"""Entry -> its form. A name that ends in "!" must be there, and a table that has such names has no others."""


def plain(meta: Mapping[str, Any]) -> dict[str, Any]:
    """Return meta as JSON gives it back.

    Raises:
        TraceError: it is not JSON, or an entry is not what its reader takes it for.
    """
    for name, value in meta.items():
        if not isinstance(name, str):
            raise TraceError(f"meta key {name!r} is not a text: give names as texts")
        try:
            json.dumps(value, allow_nan=False)
        except (TypeError, ValueError, RecursionError) as error:
            raise TraceError(
                f"meta[{name!r}] cannot be written as JSON ({error}): "
                f"give texts, finite numbers, flags, None, and lists and dicts of them"
            ) from error
        check_entry(name, value)
    found: dict[str, Any] = json.loads(json.dumps(dict(meta), allow_nan=False))
    return found


def check_entry(name: str, value: Any) -> None:
    """Check one entry; those that the package does not know may hold anything.

    Raises:
        TraceError: it is not what its reader takes it for.
    """
    if name in FORMS and (wrong := _misfit(value, FORMS[name], f"meta[{name!r}]")):
        raise TraceError(wrong)


def _misfit(value: Any, form: Any, where: str) -> str:
    """Say what has not this form; "" where all has."""
    if isinstance(form, list):
        pairs = [(f"{where}[{i}]", each, form[0]) for i, each in enumerate(value)] if isinstance(value, list) else None
    elif isinstance(form, Mapping):
        pairs = _entries(value, form, where) if isinstance(value, Mapping) else None
    elif not isinstance(value, form) or (isinstance(value, bool) and form is not bool):
        pairs = None
    else:
        pairs = [] if not isinstance(value, float) or math.isfinite(value) else None
    if pairs is None:
        return f"{where} = {shown(value)}: give {_words(form)}"
    return next((wrong for place, entry, of in pairs if (wrong := _misfit(entry, of, place))), "")


def _entries(value: Mapping[str, Any], form: Mapping[str, Any], where: str) -> list[tuple[str, Any, Any]] | None:
    if "*" in form:
        return [(f"{where}[{key!r:.80}]", entry, form["*"]) for key, entry in value.items()]
    needed = {key[:-1] for key in form if key.endswith("!")}
    if needed and set(value) != needed:
        return None
    named = {key.rstrip("!"): of for key, of in form.items()}
    return [(f"{where}[{key!r}]", value[key], of) for key, of in named.items() if key in value]


def _words(form: Any) -> str:
    if isinstance(form, list):
        return "a list"
    if isinstance(form, Mapping):
        names = [key.rstrip("!") for key in form if key != "*"]
        return f"a table with {', '.join(names)}" if names else "a table"
    kinds = form if isinstance(form, tuple) else (form,)
    said = {int: "an integer", float: "a finite number", str: "a text", bool: "true or false", _OR_NONE: "null"}
    return " or ".join(said[kind] for kind in kinds)

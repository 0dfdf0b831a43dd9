"""The meta of a trace: entries and their types.

- ``ended``: the ending and its reason
- ``warnings``: quantities above a warning level of the safety filter
- ``faults``: refused or missing answers of the solver
- ``restarts``: restarts of an isolated solver's process
- ``robot_data``: an arm that is not in the package
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from enum import StrEnum
from typing import Any

from pydantic import FiniteFloat, TypeAdapter, ValidationError
from typing_extensions import TypedDict  # pydantic needs it before Python 3.12

from moc_opt.errors import TraceError, shown


class Ending(StrEnum):
    """How a run ends. ``meta["ended"]`` begins with one of these words."""

    COMPLETED = "completed"
    OSCILLATED = "oscillated"
    STOPPED = "stopped"
    RAN_AWAY = "ran away"
    FAILED = "failed"
    PART = "part"  #: The trace has only some of the run's ticks.

    @classmethod
    def of(cls, ended: str) -> Ending:
        """Return the ending from the text of ``meta["ended"]``; FAILED if the text is unknown."""
        return next((ending for ending in cls if ended.startswith(ending.value)), cls.FAILED)

    @property
    def whole(self) -> bool:
        """Whether the task was done."""
        return self in (Ending.COMPLETED, Ending.OSCILLATED)


# ruff: noqa: UP013  (one line per type reads better than one class)
_FAULT = TypedDict("_FAULT", {"count": int, "first_at_s": FiniteFloat, "first": str})
_RESTART = TypedDict("_RESTART", {"at_s": FiniteFloat, "reason": str})
_WARNING = TypedDict(
    "_WARNING", {"of": str, "unit": str, "level": FiniteFloat, "first_s": FiniteFloat, "largest": FiniteFloat}
)
_END = TypedDict("_END", {
    "mu": FiniteFloat, "top_mu": FiniteFloat, "top_swivel_deg": FiniteFloat, "at_limit": bool,
    "best_mu": FiniteFloat, "best_swivel_deg": FiniteFloat,
})  # fmt: skip
_ROBOT = TypedDict(
    "_ROBOT", {"name": str, "tool_length_m": FiniteFloat | None, "tool_mass_kg": FiniteFloat | None}, total=False
)
_CONTROL = TypedDict("_CONTROL", {"law": str, "third_level": str}, total=False)
_SCENARIO = TypedDict("_SCENARIO", {"robot": _ROBOT, "control": _CONTROL}, total=False)
_COURSES = TypedDict("_COURSES", {"absent": str, "end": _END | None}, total=False)
FORMS: Mapping[str, TypeAdapter[Any]] = {
    name: TypeAdapter(form)
    for name, form in {
        "ended": str, "robot": str, "mu_bound_method": str, "ticks": int, "ticks_planned": int,
        "period_s": FiniteFloat, "stopped_at_s": FiniteFloat, "faults": dict[str, _FAULT],
        "restarts": list[_RESTART], "warnings": list[_WARNING], "scenario": _SCENARIO, "best_courses": _COURSES,
    }.items()
}  # fmt: skip
ANYTHING = TypeAdapter(Any)


def plain(meta: Mapping[str, Any]) -> dict[str, Any]:
    """Return meta with the types of JSON.

    Raises:
        TraceError: meta is not JSON, or an entry has another type than in `FORMS`.
    """
    found = {}
    for name, value in meta.items():
        if not isinstance(name, str):
            raise TraceError(f"meta key {name!r} is not a text: give names as texts")
        try:
            found[name] = json.loads(json.dumps(value, allow_nan=False))
        except (TypeError, ValueError, RecursionError) as error:
            raise TraceError(
                f"meta[{name!r}] cannot be written as JSON ({error}): "
                f"give texts, finite numbers, flags, None, and lists and dicts of them"
            ) from error
        try:
            FORMS.get(name, ANYTHING).validate_python(found[name], strict=True)
        except ValidationError as error:
            wrong = error.errors()[0]
            where = "".join(f"[{key!r:.80}]" for key in (name, *wrong["loc"]))
            raise TraceError(f"meta{where} = {shown(wrong['input'])}: {wrong['msg'].lower()}") from error
    return found

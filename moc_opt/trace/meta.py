"""The meta of a trace: how the run ended, and the type of each entry that pages and tables read.

A simulated run has

- ``ended``: the ending, and its reason; ``stopped_at_s`` [s]; ``ticks`` of ``ticks_planned``, and ``period_s``;
- ``warnings``: what exceeded a warning level of the safety filter, and ``faults``: the refused answers of the third
  level, label -> count, first_at_s, first (in words);
- ``restarts``: when (at_s) the process of an isolated solver was replaced, and why (reason);
- ``scenario``, ``robot`` (and ``robot_data`` of an arm that is not of the package), ``start_q_rad``, ``deadline_us``.

A trace may come from anywhere, so the types are checked where one is made.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from enum import StrEnum
from typing import Any

from pydantic import FiniteFloat, TypeAdapter, ValidationError
from typing_extensions import TypedDict  # of pydantic, which takes that of typing from Python 3.12 on only

from moc_opt.errors import TraceError, shown


class Ending(StrEnum):
    """The ways in which a run ends: the first word of ``meta["ended"]``; the reason follows it ("stopped: the tip")."""

    COMPLETED = "completed"
    OSCILLATED = "oscillated"
    STOPPED = "stopped"
    RAN_AWAY = "ran away"
    FAILED = "failed"
    PART = "part"  #: Some of the ticks of a run; the text after it is the run's ending.

    @classmethod
    def of(cls, ended: str) -> Ending:
        """Read the ending from the text of ``meta["ended"]``; a text that begins with none of the words is FAILED."""
        return next((ending for ending in cls if ended.startswith(ending.value)), cls.FAILED)

    @property
    def whole(self) -> bool:
        """Whether the task was driven to its end: only then do the run's figures enter a mean.

        A run that oscillated was, and is counted beside the means.
        """
        return self in (Ending.COMPLETED, Ending.OSCILLATED)


# ruff: noqa: UP013  (a form a line reads better than a class each)
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
"""Entry -> what it must be; a table may have further keys."""
ANYTHING = TypeAdapter(Any)


def plain(meta: Mapping[str, Any]) -> dict[str, Any]:
    """Return meta as JSON gives it back.

    Raises:
        TraceError: it is not JSON, or an entry is not what its reader takes it for.
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

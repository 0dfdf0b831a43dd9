"""Settings that speak plainly: frozen pydantic models whose errors name field, value and cure."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from moc_opt.errors import MocOptError, ScenarioError, UnknownNameError


def _none_if_infinite(value: Any) -> Any:
    return None if isinstance(value, float) and value == float("inf") else value


Level = Annotated[Annotated[float, Field(gt=0.0)] | None, BeforeValidator(_none_if_infinite)]
"""A limit above zero; None, or in TOML ``inf``, is no limit."""


class Settings(BaseModel):
    """Base of every table of settings.

    Subclasses say what they are (``KIND``, for messages) and which error they raise (``ERROR``).

    Raises:
        UnknownNameError: a field does not exist; the message lists the nearest ones.
        MocOptError: the subclass's own, naming the field, its value and the range.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    KIND: ClassVar[str] = "setting"
    ERROR: ClassVar[type[MocOptError]] = ScenarioError

    def __init__(self, **values: Any) -> None:
        for name in values:
            if name not in type(self).model_fields:
                raise UnknownNameError(self.KIND, name, type(self).model_fields)
        try:
            super().__init__(**values)
        except ValidationError as error:
            raise self.ERROR("; ".join(f"{self.KIND} {line}" for line in explain(error))) from error


def explain(error: ValidationError) -> list[str]:
    """One line per wrong field: name, value, cure."""
    lines = []
    for item in error.errors():
        field = ".".join(map(str, item["loc"]))
        message = item["msg"].removeprefix("Value error, ")
        lines.append(
            f"{field} = {item['input']!r:.200}: {message[0].lower()}{message[1:]}" if field else message
        )
    return lines

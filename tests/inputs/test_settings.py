"""Settings refuse unknown keys and wrong types."""

import importlib
import pkgutil
import re
from typing import Any, ClassVar, Literal

import numpy as np
import pytest
from pydantic import Field

import benchmarks
import moc_opt
from moc_opt.errors import ControlError, MocOptError, ScenarioError
from moc_opt.inputs.settings import Settings


class Inner(Settings):
    KIND: ClassVar[str] = "[inner]"
    gain: float = Field(default=1.0, gt=0.0, le=10.0)
    steps: int = 3


class Kinds(Settings):
    flag: bool = False
    limit: float | Literal["none"] | None = None
    point: tuple[float, float] = (0.0, 0.0)
    sizes: dict[str, float] = Field(default_factory=dict)
    free: dict[str, Any] = Field(default_factory=dict)


class Outer(Settings):
    KIND: ClassVar[str] = "outer:"
    ERROR: ClassVar[type[ControlError]] = ControlError
    inner: Inner = Inner()
    name: str = "x"


@pytest.mark.parametrize(("field", "value", "cure"), [
    ("limit", "2", r"limit = '2': a number has no quotes: drop them"), ("limit", True, r"limit = True: give a number"),
    ("point", [0.0, "1e-3"], r"\[1\] = '1e-3': a number has no quotes"),
    ("sizes", {"radius": "0.03"}, r"\[radius\] = '0.03': a number has no quotes"),
    ("flag", "yes", r"flag = 'yes': give true or false, without quotes"), ("flag", 1, r"flag = 1: give true or false"),
])  # fmt: skip
def test_value_of_the_wrong_type_is_refused(field, value, cure):
    with pytest.raises(ScenarioError, match=cure):
        Kinds(**{field: value})


def test_values_of_the_right_type_are_unchanged():
    given = {"flag": True, "limit": "none", "point": [1, 2.5], "sizes": {"a": 1}, "free": {"a": "2", "b": True}}
    assert (Kinds(**given).free, Kinds(**given).point) == (given["free"], (1.0, 2.5))
    assert Kinds(limit=np.float32(2.0), flag=np.True_) == Kinds(limit=2.0, flag=True)
    assert Kinds(limit=2) == Kinds(limit=2.0)


def test_error_message_contains_the_table_the_field_the_value_and_the_range():
    for wrong, said in (
        ({"gian": 1.0}, r"unknown \[inner\] key 'gian': did you mean 'gain'\? valid names: gain, steps"),
        *(({"gain": value}, rf"\[inner\] gain = {re.escape(repr(value))}: input should be")
          for value in (0.0, -1.0, 11.0, float("nan"), float("inf"), "fast", None, [1.0])),
        ({"gain": 0.0, "steps": "two"}, r"gain = 0\.0.*; .*steps = 'two'"),
    ):
        with pytest.raises(MocOptError, match=said):
            Inner(**wrong)
    for wrong, said in (
        ({"inner": {"gain": -3.0}}, r"^\[inner\] gain = -3\.0: input should be greater than 0"),
        ({"name": 5}, "name = 5"),
        ({"inner": 3}, r"inner = 3: must be a table: in a file write \[inner\] .*, in Python give a dict$"),
    ):  # fmt: skip
        with pytest.raises(ControlError, match=said):
            Outer(**wrong)


def every_table():
    for package in (moc_opt, benchmarks):
        for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
            if "__main__" not in module.name:
                importlib.import_module(module.name)
    found = [Settings]
    for table in found:  # `found` grows during the loop
        found += table.__subclasses__()
    return [table for table in found[1:] if table.__module__.startswith(("moc_opt.", "benchmarks."))]


NEEDED = {"last_link": "link_7", "group": "solver", "low": 0.0, "high": 1.0}
"""Values of fields that have no default."""


def test_every_setting_refuses_extreme_numbers():
    tables = every_table()
    assert len(tables) > 25
    tried = 0
    for table in tables:
        for name, field in table.model_fields.items():
            kinds = str(field.annotation)
            integer = "int" in re.findall(r"\w+", kinds) and "float" not in kinds
            if not integer and "float" not in kinds:
                continue
            needed = {other: NEEDED.get(other) for other, of in table.model_fields.items() if of.is_required()}
            time = name == "seconds" or (name.endswith("_s") and "_per_" not in name)
            values = [1e308, -1e308, 1e-300, 10**5000, -(10**5000), [1e308], {"x": 1e308}]
            for value in values + [2**70, -(2**70), [2**70]] * integer + [1e10] * time:
                tried += 1
                with pytest.raises(MocOptError, match=name):
                    table(**{**needed, name: value})
    assert tried > 800

"""Paths by name, those of other packages among them."""

import sys
import types
from importlib.metadata import EntryPoint

import numpy as np
import pytest

from moc_opt.errors import TaskError, UnknownNameError
from moc_opt.tasks import Path, Waypoints, make_path
from moc_opt.tasks.curves import Circle
from moc_opt.tasks.kinds import kinds

AXES = {"normal": [0.0, 0.0, 1.0], "heading": [1.0, 0.0, 0.0]}
module = sys.modules["moc_opt.tasks.kinds"]


def helix(radius: float, pitch: float = 0.01):
    """Go round once while it climbs."""
    angle = np.linspace(0.0, 2 * np.pi, 25)
    return np.stack([radius * np.sin(angle), radius * (1 - np.cos(angle)), pitch * angle / (2 * np.pi)], axis=1)


@pytest.fixture
def added(monkeypatch):
    own = types.ModuleType("own_paths")
    own.helix, own.Ring, own.number = helix, Circle, 3

    def crash(radius: float = 0.01):
        raise ZeroDivisionError("by hand")

    own.crash = crash
    monkeypatch.setitem(sys.modules, "own_paths", own)
    values = {"helix": "own_paths:helix", "ring": "own_paths:Ring", "number": "own_paths:number",
              "crash": "own_paths:crash", "gone": "no_such_module:f", "circle": "own_paths:helix"}  # fmt: skip
    found = [EntryPoint(name, value, module.GROUP) for name, value in values.items()]
    monkeypatch.setattr(module, "entry_points", lambda group: found if group == module.GROUP else [])


def test_a_function_of_sizes_gives_a_path_in_space(added):
    path = make_path("helix", np.zeros(3), radius=0.02, **AXES)
    assert isinstance(path, Waypoints)
    assert path.at(path.length)[0][2] == pytest.approx(0.01)
    assert path.length == pytest.approx(np.hypot(2 * np.pi * 0.02, 0.01), rel=1e-2)


def test_a_class_gives_a_planar_path(added):
    path = make_path("ring", np.zeros(3), radius=0.02, **AXES)
    assert isinstance(path, Path)
    assert path.length == pytest.approx(2 * np.pi * 0.02)


@pytest.mark.parametrize(
    ("kind", "given", "error", "message"),
    [
        ("helix", {}, TaskError, "a helix needs its radius"),
        ("helix", {"radios": 0.1}, UnknownNameError, "unknown size of a helix 'radios': did you mean 'radius'"),
        ("helx", {}, UnknownNameError, "unknown path 'helx': did you mean 'helix'"),
        ("number", {}, TaskError, "is no class or function"),
        ("crash", {}, TaskError, "raised ZeroDivisionError: by hand"),
        ("gone", {}, TaskError, "does not load: ModuleNotFoundError"),
        ("waypoints", {}, TaskError, "waypoints of shape"),
    ],
)
def test_what_is_wrong_with_a_path_is_named(added, kind, given, error, message):
    with pytest.raises(error, match=message):
        make_path(kind, np.zeros(3), **AXES, **given)


def test_every_path_is_listed_and_a_broken_one_hides_no_other(added):
    found = kinds()
    assert found["helix"] == "Go round once while it climbs."
    assert "does not load" in found["gone"]
    assert {"line", "circle", "sinusoid", "spiral", "waypoints", "ring"} <= set(found)
    assert make_path("circle", np.zeros(3), radius=0.02, **AXES).curve.radius == 0.02  # a built-in name is taken

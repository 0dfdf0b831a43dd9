"""Paths of the tip."""

import math
from collections.abc import Callable
from importlib.metadata import EntryPoint
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from moc_opt.errors import TaskError, UnknownNameError
from moc_opt.tasks import CURVES, Path, Reference, Trocar, Waypoints, duration, make_path, paths
from moc_opt.tasks.timelaw import WaitingReference, flags_at

START = np.array([0.4, -0.1, 0.25])
NORMAL = np.array([0.2, -0.3, 2.0])
HEADING = np.array([1.0, 0.4, 0.1])
AXES = {"normal": (0.0, 0.0, 1.0), "heading": (1.0, 0.0, 0.0)}
SIZES: dict[str, dict[str, float]] = {
    "line": {"length": 0.08}, "circle": {"radius": 0.03}, "spiral": {"turns": 3.0, "radius": 0.03},
    "sinusoid": {"amplitude": 0.01, "wavelength": 0.03, "periods": 2.5},
}  # fmt: skip


def build(kind: str, **changed: float) -> Path:
    return make_path(kind, START, normal=NORMAL, heading=HEADING, **{**SIZES[kind], **changed})


size = st.floats(0.003, 0.3)
any_path = st.one_of(
    st.builds(lambda d: build("line", length=d), size), st.builds(lambda r: build("circle", radius=r), size),
    st.builds(lambda a, w, n: build("sinusoid", amplitude=a, wavelength=w, periods=n), size, size, st.floats(0.2, 6.0)),
    st.builds(lambda n, r: build("spiral", turns=n, radius=r), st.floats(0.1, 8.0), size),
)


@settings(max_examples=30)
@given(any_path, st.floats(0.0, 1.0))
def test_a_curve_lies_in_its_plane_and_its_derivatives_are_finite_differences(path: Path, place: float) -> None:
    bends = max(1.0 / path.length, *(abs(path.curve.at(s)[4]) for s in path.curve.knots.tolist()))
    # The step h [m] is at most a thousandth of the smallest radius of curvature.
    h = 1e-3 / bends
    s = h + place * (path.length - 2.0 * h)
    np.testing.assert_allclose(path.at(0.0)[0], START, atol=1e-15)
    p, dp, ddp = path.at(np.array([s - h, s, s + h]))
    np.testing.assert_allclose(np.linalg.norm(dp, axis=1), 1.0, atol=1e-13)
    np.testing.assert_allclose(dp[1] @ ddp[1], 0.0, atol=1e-12 * bends)
    for rows in (p - START, dp, ddp / bends):
        np.testing.assert_allclose(rows @ path.normal, 0.0, atol=1e-13)
    np.testing.assert_allclose((p[2] - p[0]) / (2.0 * h), dp[1], atol=3e-5)
    np.testing.assert_allclose((dp[2] - dp[0]) / (2.0 * h), ddp[1], atol=3e-5 * bends)


@settings(max_examples=20)
@given(st.floats(0.1, 40.0), st.floats(0.002, 0.5), st.floats(0.0, 1.0))
def test_spiral_arc_length_is_the_closed_form(turns: float, radius: float, place: float) -> None:
    path = build("spiral", turns=turns, radius=radius)
    pitch = radius / (2.0 * math.pi * turns)
    s = place * path.length
    angle = float(np.linalg.norm(path.at(s)[0] - START)) / pitch
    exact = 0.5 * pitch * (angle * math.sqrt(1.0 + angle * angle) + math.asinh(angle))
    assert exact == pytest.approx(s, abs=1e-9)
    assert np.linalg.norm(path.at(path.length)[0] - START) == pytest.approx(radius, abs=1e-12)
    assert path.at(0.0)[1] @ path.heading == pytest.approx(1.0)


def test_circle_turns_left_and_line_is_straight() -> None:
    path, center = make_path("circle", START, radius=0.03, **AXES), START + np.array([0.0, 0.03, 0.0])
    p, _, ddp = path.at(np.linspace(0.0, path.length, 97))
    np.testing.assert_allclose(ddp, (center - p) / 0.03**2, atol=1e-10)
    np.testing.assert_allclose(p[-1], START, atol=1e-13)
    # The circle runs counter-clockwise about +z.
    np.testing.assert_allclose(path.at(0.0)[1], [1.0, 0.0, 0.0], atol=1e-15)
    line = make_path("line", START, normal=(1, 0, 0), heading=(0, 0, -3), length=0.2)
    np.testing.assert_allclose(line.at(line.length)[0], START - [0.0, 0.0, 0.2], atol=1e-15)
    np.testing.assert_array_equal(line.at(0.1)[2], np.zeros(3))


def helix(radius: float, pitch: float = 0.01):
    """One turn of a helix."""
    angle = np.linspace(0.0, 2 * np.pi, 25)
    return np.stack([radius * np.sin(angle), radius * (1 - np.cos(angle)), pitch * angle / (2 * np.pi)], axis=1)


def crash(radius: float = 0.01):
    raise ZeroDivisionError("by hand")


@pytest.fixture
def added(monkeypatch: pytest.MonkeyPatch) -> None:
    values = {"helix": f"{__name__}:helix", "ring": "moc_opt.tasks.curves:circle", "number": "math:pi",
              "crash": f"{__name__}:crash", "gone": "no_such_module:f", "circle": f"{__name__}:helix"}  # fmt: skip
    found = {name: [EntryPoint(name, value, paths.GROUP)] for name, value in values.items()}
    monkeypatch.setattr(paths.plugins, "plugins", lambda group: found if group == paths.GROUP else {})


@pytest.mark.parametrize("kind", ["screw", "helix"])  # "screw" is added to CURVES, "helix" comes from another package
def test_function_defines_a_kind_of_path(kind: str, added: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(CURVES, "screw", helix)
    assert paths.kinds()["screw"] == "One turn of a helix."
    path = make_path(kind, np.zeros(3), radius=0.02, **AXES)
    assert isinstance(path, Waypoints)
    assert path.at(path.length)[0][2] == pytest.approx(0.01)
    assert path.length == pytest.approx(np.hypot(2 * np.pi * 0.02, 0.01), rel=1e-2)
    assert make_path("ring", np.zeros(3), radius=0.02, **AXES).length == pytest.approx(2 * np.pi * 0.02)


@pytest.mark.parametrize(("kind", "sizes", "error", "words"), [
    ("sinus", {}, UnknownNameError, "'sinusoid'"), ("circle", {"radus": 0.1}, UnknownNameError, "'radius'"),
    ("circle", {"radius": 0.1, "length": 0.3}, UnknownNameError, "valid names: radius$"),  # a circle's only size
    ("helix", {}, TaskError, "radius"),
    ("helix", {"radios": 0.1}, UnknownNameError, "'radius'"), ("helx", {}, UnknownNameError, "'helix'"),
    ("number", {}, TaskError, "class or function"), ("crash", {}, TaskError, "ZeroDivisionError"),
    ("gone", {}, TaskError, "ModuleNotFoundError"), ("waypoints", {}, TaskError, "waypoints"),
])  # fmt: skip
def test_error_explains_a_wrong_kind_or_size(added: None, kind: str, sizes: dict, error: type, words: str) -> None:
    with pytest.raises(error, match=words):
        make_path(kind, np.zeros(3), **AXES, **sizes)


def test_path_that_does_not_load_does_not_hide_the_others(added: None) -> None:
    found = paths.kinds()
    assert found["helix"] == "One turn of a helix."
    assert "does not load" in found["gone"]
    assert {*CURVES, "waypoints", "ring"} <= set(found)
    taken = make_path("circle", np.zeros(3), radius=0.02, **AXES)  # the built-in path
    assert taken.curvature(0.0) == pytest.approx(50.0)


STEPS = st.lists(st.tuples(*[st.floats(-0.01, 0.01)] * 3), min_size=1, max_size=8)


@settings(max_examples=20)
@given(STEPS)
def test_a_path_through_waypoints_has_unit_speed_and_smooth_curvature(steps: list) -> None:
    points = np.cumsum(np.add(steps, (0.02, 0.0, 0.0)), axis=0)  # every step goes 1 to 3 cm ahead: no cusps
    path = Waypoints(points, START, **AXES)
    s = np.linspace(0.0, path.length, 1001)
    p, tangent, bend = path.at(s)
    np.testing.assert_allclose(p[0], START, atol=1e-12)
    np.testing.assert_allclose(p[-1], START + points[-1], atol=1e-9)
    for point in points:
        assert np.linalg.norm(p - (START + point), axis=1).min() < path.length / 1000
    np.testing.assert_allclose(np.linalg.norm(tangent, axis=1), 1.0, atol=1e-9)
    step = s[1] - s[0]
    np.testing.assert_allclose((p[2:] - p[:-2]) / (2 * step), tangent[1:-1], atol=1e-3)
    np.testing.assert_allclose((tangent[2:] - tangent[:-2]) / (2 * step), bend[1:-1], atol=5e-2 * (1 + abs(bend).max()))
    np.testing.assert_allclose(np.sum(tangent * bend, axis=1), 0.0, atol=1e-9 * (1 + abs(bend).max()))
    assert abs(np.diff(bend, axis=0)).max() < 0.2 * (1 + abs(bend).max())  # the curvature does not jump
    assert path.curvature(s[400]) == pytest.approx(np.linalg.norm(bend[400]))


def test_waypoints_are_in_the_axes_of_the_path() -> None:
    path = Waypoints([[0.01, 0.02, 0.03]], np.zeros(3), normal=(1, 0, 0), heading=(0, 0, 2))
    end, _, bend = path.at(path.length)
    np.testing.assert_allclose(end, [0.03, -0.02, 0.01], atol=1e-12)  # left = normal x heading
    np.testing.assert_allclose(path.at(0.5 * path.length)[0], 0.5 * end, atol=1e-12)
    np.testing.assert_allclose(bend, 0.0, atol=1e-12)


LINE = build("line")
MOVING: dict[str, Any] = {
    **{f"path {kind}": build(kind) for kind in CURVES}, "trocar": Trocar(START, 0.01, 4.2, (1.0, 2.0, 3.0)),
    **{f"reference {kind}": Reference(build(kind), 0.1, 0.3, t_start=0.01) for kind in CURVES},
    "waypoints": Waypoints([[0.02, 0.0, 0.0], [0.04, 0.02, 0.01]], START, **AXES),
}  # fmt: skip


@pytest.mark.parametrize("name", MOVING)
def test_array_and_single_numbers_give_the_same_bits(name: str) -> None:
    one = MOVING[name]
    s = np.random.default_rng(3).uniform(0.0, getattr(one, "length", 2.0), 60)
    vector = one.at(s)
    assert {rows.shape for rows in vector} == {(60, 3)}
    assert {rows.shape for rows in one.at(np.empty(0))} == {(0, 3)}
    for i, entry in enumerate(s):
        np.testing.assert_array_equal([rows[i] for rows in vector], one.at(entry))
        if hasattr(one, "rows"):
            np.testing.assert_array_equal(one.rows(entry), one.at(entry))


NUMBERS = [0.0, -0.1, math.nan, math.inf, "0.1", None, True]
ZERO, FAR = np.zeros(3), [[0.01, 0, 0], [-1001.0, 0, 0]]
REFUSED: dict[str, tuple[str, Callable[[Any], Any], list[Any]]] = {
    "arc length": ("s ", LINE.at, [-1e-3, 1.0, math.nan, [[0.0]], "here"]),
    "time of a trocar": ("t ", Trocar(START).at, [math.nan, math.inf, [[0.0]], "now"]),
    "time": ("t ", Reference(LINE, 0.1, 0.3).at, [math.nan, [0.1, math.nan], np.zeros((2, 2)), "soon"]),
    "t_start": ("t_start", lambda x: Reference(LINE, 0.1, 0.3, t_start=x), [math.inf, "x"]),
    **{f"{kind} {name}": (name, lambda x, kind=kind, name=name: build(kind, **{name: x}), NUMBERS)
       for kind, of in SIZES.items() for name in of},
    "v_max": ("v_max", lambda x: Reference(LINE, x, 0.3), NUMBERS),
    "a_max": ("a_max", lambda x: duration(build("circle"), 0.1, x), NUMBERS),
    "period_s": ("period_s", lambda x: WaitingReference(Reference(LINE, 0.1, 0.3), x), NUMBERS),
    "flags": ("flags", WaitingReference(Reference(LINE, 0.1, 0.3), 0.002).play, [np.ones(5), [[True]]]),
    "seen_times": ("rising", lambda x: flags_at([0.0], x, [True, True]), [[0.2, 0.1], [0.1]]),
    "point": ("point", Trocar, [(0.0, 1.0), (0.0, math.nan, 0.0)]),
    "breathing amplitude": ("breathing_amplitude_m", lambda x: Trocar(START, x), [-0.01, math.inf]),
    "breathing period": ("breathing_period_s", lambda x: Trocar(START, 0.01, x), NUMBERS),
    "direction": ("direction", lambda x: Trocar(START, direction=x), [ZERO, "up"]),
    "heading": ("heading", lambda x: make_path("line", START, normal=NORMAL, heading=x, length=0.1), [-2.0 * NORMAL]),
    "periods": ("cannot be tabulated", lambda x: build("sinusoid", periods=x), [1e9]),
    **{f"waypoints {words}": (words, lambda x: Waypoints(x, START, **AXES), [points]) for words, points in (
        ("away from the start", [[0.0, 0.0, 0.0]]), (r"shape \(0,\)", []), (r"shape \(1, 2\)", [[0.1, 0.0]]),
        ("finite", [[0.1, 0.0, np.nan]]), ("numbers", [[0.1, "a", 0.0]]), ("1001 waypoints", np.ones((1001, 3))),
        (r"\[0.01, 0.0, 0.0\] appears twice", [[0.01, 0, 0], [0.01, 0, 0], [0.02, 0, 0]]), ("1000 m", FAR),
        (r"turns back on the spot near waypoint \[0.02, 0.0, 0.0\]", [[0.02, 0, 0], [0, 0, 0]]),
    )},
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_error_names_the_unusable_argument(name: str) -> None:
    words, make, values = REFUSED[name]
    for value in values:
        with pytest.raises(TaskError, match=words):
            make(value)

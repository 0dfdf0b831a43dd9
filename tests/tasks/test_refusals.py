"""Times and arc lengths as numbers or vectors, and what no path, time law or trocar can be made from."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from moc_opt.errors import TaskError
from moc_opt.tasks import CURVES, Reference, Trocar, Waypoints, duration, make_path
from moc_opt.tasks.timelaw import WaitingReference, flags_at
from tests.tasks.test_paths import AXES, HEADING, NORMAL, SIZES, START, build

LINE = build("line")
MOVING: dict[str, Any] = {
    **{f"path {kind}": build(kind) for kind in CURVES}, "trocar": Trocar(START, 0.01, 4.2, (1.0, 2.0, 3.0)),
    **{f"reference {kind}": Reference(build(kind), 0.1, 0.3, t_start=0.01) for kind in CURVES},
    "waypoints": Waypoints([[0.02, 0.0, 0.0], [0.04, 0.02, 0.01]], START, **AXES),
}  # fmt: skip


@pytest.mark.parametrize("name", MOVING)
def test_vectors_and_numbers_give_the_same_bits(name: str) -> None:
    one = MOVING[name]
    s = np.random.default_rng(3).uniform(0.0, getattr(one, "length", 2.0), 60)
    vector = one.at(s)
    assert {rows.shape for rows in vector} == {(60, 3)}
    assert {rows.shape for rows in one.at(np.empty(0))} == {(0, 3)}
    for i, entry in enumerate(s):
        np.testing.assert_array_equal([rows[i] for rows in vector], one.at(entry))
        if hasattr(one, "rows"):
            np.testing.assert_array_equal(one.rows(entry), one.at(entry))


def test_a_trocar_is_copied_and_read_only() -> None:
    trocar = Trocar(point := np.array(START))
    point[:] = 0.0
    np.testing.assert_array_equal(trocar.at([3.0])[0][0], START)
    with pytest.raises(ValueError, match="read-only"):
        trocar.point[0] = 1.0
    with pytest.raises(AttributeError):
        trocar.breathing_period_s = 1.0  # type: ignore[misc]


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
    "pictures": ("rising", lambda x: flags_at([0.0], x, [True, True]), [[0.2, 0.1], [0.1]]),
    "point": ("point", Trocar, [(0.0, 1.0), (0.0, math.nan, 0.0)]),
    "breathing": ("breathing_amplitude_m", lambda x: Trocar(START, x), [-0.01, math.inf]),
    "breath": ("breathing_period_s", lambda x: Trocar(START, 0.01, x), NUMBERS),
    "direction": ("direction", lambda x: Trocar(START, direction=x), [ZERO, "up"]),
    "heading": ("heading", lambda x: make_path("line", START, normal=NORMAL, heading=x, length=0.1), [-2.0 * NORMAL]),
    "normal": ("normal", lambda x: make_path("line", START, normal=x, heading=HEADING, length=0.1), [ZERO]),
    "start": ("start", lambda x: make_path("line", x, normal=NORMAL, heading=HEADING, length=0.1),
              [START[:2], [0.0, math.nan, 0.0]]),
    "periods": ("cannot be tabulated", lambda x: build("sinusoid", periods=x), [1e9]),
    **{f"waypoints {told}": (told, lambda x: Waypoints(x, START, **AXES), [points]) for told, points in (
        ("off the start", [[0.0, 0.0, 0.0]]), (r"shape \(0,\)", []), (r"shape \(1, 2\)", [[0.1, 0.0]]),
        ("finite", [[0.1, 0.0, np.nan]]), ("numbers", [[0.1, "a", 0.0]]), ("1001 waypoints", np.ones((1001, 3))),
        (r"\[0.01, 0.0, 0.0\] stands twice", [[0.01, 0, 0], [0.01, 0, 0], [0.02, 0, 0]]), ("1000 m", FAR),
        (r"turns back on the spot near waypoint \[0.02, 0.0, 0.0\]", [[0.02, 0, 0], [0, 0, 0]]),
    )},
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_used_is_refused_by_name(name: str) -> None:
    told, make, values = REFUSED[name]
    for value in values:
        with pytest.raises(TaskError, match=told):
            make(value)

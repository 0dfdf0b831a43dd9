"""What trajectories amount to, on maps whose optima, limits and trajectories are put there by hand."""

from __future__ import annotations

from collections.abc import Callable
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest

from moc_opt.planning.swivel_map import (
    CLOSE_RAD,
    FEASIBLE,
    NEAR,
    UNREACHABLE,
    End,
    Reading,
    SwivelMap,
    Trajectory,
    alike,
    read_trajectory,
)

T = np.linspace(0.0, 10.0, 21)
ROWS = np.arange(-180.0, 180.0, 3.0)


def hill(top: float, height: float, width: float = 60.0) -> Callable[[Any], Any]:
    """mu over the swivel [deg]: a smooth hill."""
    return lambda swivel: height * np.exp(-(((np.asarray(swivel) - top + 180) % 360 - 180) ** 2) / width**2)


def made(
    mu: Callable[[Any], Any],
    trajectories: dict[str, Any],
    forbidden: tuple[float, float, int] | None = None,
    **more: Any,
) -> SwivelMap:  # fmt: skip
    """A map that is the same at all times.

    Args:
        mu: of the swivel [deg].
        trajectories: name -> swivel over time [deg]: a number, or one at each of 101 times.
        forbidden: from, to [deg], and what stands in `limit` there.
        more: of every trajectory.
    """
    limit = np.full((len(T), len(ROWS)), FEASIBLE)
    if forbidden:
        limit[:, (forbidden[0] <= ROWS) & (forbidden[1] >= ROWS)] = forbidden[2]
    grid = np.tile(mu(ROWS), (len(T), 1))
    feasible = np.where(limit == FEASIBLE, grid, -np.inf)
    best = feasible.max(axis=1)
    best[~np.isfinite(best)] = np.nan
    grid[limit == UNREACHABLE] = np.nan
    t = np.linspace(0.0, 10.0, 101)
    lines = {}
    for name, swivel in trajectories.items():
        degrees = np.broadcast_to(np.asarray(swivel, dtype=float), t.shape)
        lines[name] = Trajectory(t, np.radians(degrees), mu(degrees), **{"gap_rad": 0.01, **more})
    return SwivelMap(
        T, np.radians(ROWS), grid, np.zeros((len(T), len(ROWS), 7)), limit,
        np.radians(ROWS[np.argmax(feasible, axis=1)]), best, MappingProxyType(lines),
    )  # fmt: skip


def read(*given: Any, **more: Any) -> Reading:
    return read_trajectory(made(*given, **more), "run")


def ramp(start: float, end: float, until: float = 10.0) -> Any:
    """Evenly from start to end, there at the time `until`."""
    return start + (end - start) * np.minimum(np.linspace(0.0, 10.0, 101) / until, 1.0)


def test_a_trajectory_that_climbs_to_the_optimum() -> None:
    top = hill(60.0, 0.3)
    found = read(top, {"run": ramp(-30.0, 60.0, until=5.0)})
    assert found.end is End.OPTIMUM
    on_from = 60.0 - 60.0 * np.sqrt(-np.log(1.0 - NEAR))  # where mu is 2 % below the top
    arrives = 5.0 * (on_from + 30.0) / 90.0
    assert found.from_s == pytest.approx(arrives, abs=0.11)
    assert found.near == pytest.approx(1.0 - arrives / 10.0, abs=0.02)
    assert found.travel_rad == pytest.approx(np.radians(90.0))
    assert found.mu_share == pytest.approx(top(ramp(-30.0, 60.0, until=5.0)).mean() / 0.3)
    always = read(top, {"run": 60.0})
    assert (always.near, always.from_s) == (1.0, 0.0)


def test_a_local_maximum_holds_a_course() -> None:
    def two(swivel: Any) -> Any:
        return hill(60.0, 0.3, 30.0)(swivel) + hill(-60.0, 0.25, 30.0)(swivel)

    assert read(two, {"run": ramp(-100.0, -60.0, 6.0)}).end is End.LOCAL_MAXIMUM
    assert read(two, {"run": -60.0 - 0.7 * np.degrees(CLOSE_RAD)}).end is End.LOCAL_MAXIMUM
    assert read(two, {"run": -60.0 - 2.0 * np.degrees(CLOSE_RAD)}).end is End.STILL, "the way up is open"


@pytest.mark.parametrize(("place", "end"), [(-4.0, End.FEASIBLE_EDGE), (-10.0, End.FEASIBLE_EDGE), (-40.0, End.STILL)])
def test_a_limit_on_the_way_up_holds_a_course(place: float, end: End) -> None:
    found = read(hill(60.0, 0.3), {"run": place}, (0.0, 20.0, 4))
    assert (found.end, found.joint) == (end, 4 if end is End.FEASIBLE_EDGE else 0)


def test_time_at_the_grey_is_counted_with_its_joint() -> None:
    found = read(hill(60.0, 0.3), {"run": ramp(-50.0, 50.0)}, (-4.0, 20.0, 4))
    assert found.at_edge == pytest.approx((20.0 + 3.0 + 4.0 + 3.0) / 100.0, abs=0.04)
    assert found.limits == (4,)
    away = read(hill(60.0, 0.3), {"run": -40.0}, (-4.0, 20.0, 4))
    assert (away.at_edge, away.limits) == (0.0, ())


def test_the_reach_holds_a_trajectory_too() -> None:
    found = read(hill(60.0, 0.3), {"run": -4.0}, (0.0, 20.0, UNREACHABLE))
    # mu is not known where there is no pose, so that nobody can say that the way up leads there.
    assert found.joint == 0
    assert found.end in (End.FEASIBLE_EDGE, End.LOCAL_MAXIMUM, End.STILL)


def test_a_optimum_at_a_limit_is_a_optimum() -> None:
    """The best pose of all that are allowed lies at the limit; a run stops a little before it."""
    assert read(hill(60.0, 0.3), {"run": -5.0}, (0.0, 140.0, 2)).end is End.FEASIBLE_EDGE
    assert read(hill(60.0, 0.3, 200.0), {"run": -4.0}, (0.0, 140.0, 2)).end is End.OPTIMUM


@pytest.mark.parametrize(
    ("swivel", "end"),
    [(-60.0, End.STILL), (ramp(-120.0, -20.0), End.RISING), (ramp(0.0, -60.0), End.FALLING)],
)
def test_where_the_way_is_open_its_motion_tells(swivel: Any, end: End) -> None:
    assert read(hill(60.0, 0.3, 90.0), {"run": swivel}).end is end


def test_the_climb_crosses_the_cut_of_the_map() -> None:
    """The map is a circle, cut open somewhere: a top beyond its last row is close to its first one."""

    def two(swivel: Any) -> Any:
        return hill(178.0, 0.25, 30.0)(swivel) + hill(0.0, 0.3, 30.0)(swivel)

    assert read(two, {"run": -176.0}).end is End.LOCAL_MAXIMUM


def test_what_cannot_be_judged_is_said() -> None:
    elsewhere = read(hill(60.0, 0.3), {"run": 60.0}, gap_rad=2.0)
    assert elsewhere.end is End.OTHER_BRANCH
    assert np.isnan([elsewhere.near, elsewhere.mu_share, elsewhere.from_s]).all()
    nowhere = read(hill(60.0, 0.3), {"run": 60.0}, (-180.0, 180.0, 1))
    assert nowhere.end is End.UNKNOWN


def test_trajectories_that_look_the_same_are_one_kind() -> None:
    found = made(
        hill(60.0, 0.3), {"a": 0.0, "b": 10.0, "c": 2.0, "d": ramp(0.0, 30.0), "e": 11.0, "f": 360.0}
    )
    assert alike(found) == {"a": ["c", "f"], "b": ["e"], "d": []}
    assert alike(found, within_rad=np.radians(0.5)) == {"a": ["f"], "b": [], "c": [], "d": [], "e": []}


def test_a_run_that_ends_early_or_folds_otherwise_is_a_kind_of_its_own() -> None:
    found = made(hill(60.0, 0.3), {"a": 0.0})
    whole = found.trajectories["a"]
    short = Trajectory(whole.t_s[:50], whole.swivel_rad[:50], whole.mu[:50], whole.gap_rad)
    folded = Trajectory(whole.t_s, whole.swivel_rad, whole.mu, 2.0)
    for other in (short, folded):
        trajectories = MappingProxyType({"a": whole, "other": other})
        both = SwivelMap(
            found.t_s, found.swivel_rad, found.mu, found.q_rad, found.limit, found.best_swivel_rad, found.best_mu,
            trajectories,
        )  # fmt: skip
        assert alike(both) == {"a": [], "other": []}

"""Exchanged controllers, each a constant torque: what is sent, when the next one begins, and what a refusal leaves."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from moc_opt.control import ControlSettings
from moc_opt.errors import ControlError, MocOptError
from moc_opt.live.exchange import BLEND_S, Choice, ExchangeableController
from tests.conftest import Array

PERIOD_S = 0.004
APART = 25
"""Ticks of this period in 0.1 s."""
REST = np.zeros(2)


class Constant:
    """A controller whose torque is constant; it notes what it is told."""

    def __init__(self, torque: float, refuses: bool = False) -> None:
        self.torque, self.refuses = np.full(2, torque), refuses
        self.starts, self.applied = 0, list[Array]()

    def start(self, *_: object) -> None:
        if self.refuses:
            raise ControlError(f"{self.torque[0]:g} refuses")
        self.starts += 1

    def tick(self, *_: object) -> Array:
        return self.torque.copy()

    def set_applied_torque(self, tau: Array) -> None:
        self.applied.append(tau.copy())


def choice(torque: float, refuses: bool = False) -> Choice:
    return Choice(Constant(torque, refuses), f"{torque:g}", ControlSettings())  # type: ignore[arg-type]


class Bench:
    """The exchange under test, begun with a torque of 1 Nm, and the names of what was refused."""

    def __init__(self) -> None:
        robot: Any = SimpleNamespace(n=2, state=lambda q, v: None)
        self.refused: list[str] = []
        self.first = choice(1.0)
        self.exchange = ExchangeableController(robot, self.first, PERIOD_S, self._refuse)
        self.exchange.restart()

    def _refuse(self, of: Choice, error: MocOptError) -> None:
        assert self.exchange.used is not of
        self.refused.append(f"{of.solver}: {error}")

    def ticks(self, count: int) -> Array:
        return np.array([self.exchange.tick(REST, REST, REST, REST)[0] for _ in range(count)])


@pytest.fixture
def bench() -> Bench:
    made = Bench()
    np.testing.assert_array_equal(made.ticks(3), 1.0)
    return made


def told(of: Choice) -> list[float]:
    return [tau[0] for tau in of.controller.applied]  # type: ignore[attr-defined]


def test_the_torque_goes_on_where_it_was_and_its_difference_decays(bench: Bench) -> None:
    other = choice(5.0)
    bench.exchange.replace(other)
    sent = bench.ticks(100)
    np.testing.assert_allclose(sent, 5.0 - 4.0 * np.exp(-np.arange(100) * PERIOD_S / BLEND_S), rtol=1e-12)
    assert told(other) == [1.0, *sent], "the observer knows what was sent: before its first tick, and at each"
    assert bench.exchange.used is other


def test_a_faded_difference_is_forgotten(bench: Bench) -> None:
    other = choice(5.0)
    bench.exchange.replace(other)
    bench.ticks(1000)
    heard = len(told(other))
    np.testing.assert_array_equal(bench.ticks(5), 5.0)
    assert len(told(other)) == heard


def test_the_next_one_begins_from_the_torque_that_was_applied(bench: Bench) -> None:
    """Where the safety filter cut it, from what was left of it; the controller in use is told, too."""
    bench.exchange.set_applied_torque(np.full(2, 0.25))
    assert told(bench.first) == [0.25]
    other = choice(5.0)
    bench.exchange.replace(other)
    assert bench.ticks(1)[0] == 0.25
    assert told(other)[0] == 0.25


def test_the_last_one_that_was_asked_for_follows_after_a_tenth_of_a_second(bench: Bench) -> None:
    second, third, fourth = choice(2.0), choice(3.0), choice(4.0)
    bench.exchange.replace(second)
    bench.ticks(1)
    bench.exchange.replace(third)
    bench.exchange.replace(fourth)
    bench.ticks(APART - 1)
    assert bench.exchange.used is second
    bench.ticks(1)
    assert bench.exchange.used is fourth
    assert third.controller.starts == 0  # type: ignore[attr-defined]
    bench.ticks(3 * APART)
    assert bench.exchange.used is fourth


def test_one_that_cannot_start_leaves_the_place_to_the_one_before(bench: Bench) -> None:
    good, bad, worse = choice(2.0), choice(3.0, refuses=True), choice(4.0, refuses=True)
    for each in (good, bad, worse):
        bench.exchange.replace(each)
    bench.ticks(1)
    assert bench.exchange.used is good
    assert bench.refused == ["4: 4 refuses", "3: 3 refuses"]
    bench.ticks(3 * APART)
    assert len(bench.refused) == 2, "asked once"


def test_a_refusal_changes_nothing_and_the_next_order_need_not_wait(bench: Bench) -> None:
    bench.exchange.replace(choice(3.0, refuses=True))
    np.testing.assert_array_equal(bench.ticks(2), 1.0)
    assert bench.exchange.used is bench.first
    assert bench.first.controller.starts == 2, "those of its first tick"  # type: ignore[attr-defined]
    other = choice(2.0)
    bench.exchange.replace(other)
    bench.ticks(1)
    assert bench.exchange.used is other


def test_a_reset_starts_the_last_choice_at_once_and_without_a_blend(bench: Bench) -> None:
    second, third = choice(2.0), choice(3.0)
    bench.exchange.replace(second)
    bench.ticks(2)
    bench.exchange.replace(third)
    bench.exchange.restart()
    np.testing.assert_array_equal(bench.ticks(2), 3.0)
    assert bench.exchange.used is third
    assert told(third) == []


def test_a_reset_starts_the_one_in_use_afresh_where_the_last_choice_cannot_start(bench: Bench) -> None:
    bench.exchange.replace(choice(3.0, refuses=True))
    bench.exchange.restart()
    np.testing.assert_array_equal(bench.ticks(2), 1.0)
    assert bench.first.controller.starts == 4, "twice at each first tick"  # type: ignore[attr-defined]
    assert len(bench.refused) == 1


def test_the_error_of_the_only_controller_is_raised() -> None:
    alone = choice(1.0, refuses=True)
    robot: Any = SimpleNamespace(n=2, state=lambda q, v: None)
    exchange = ExchangeableController(robot, alone, PERIOD_S, lambda *_: pytest.fail("it is raised"))
    with pytest.raises(ControlError, match="1 refuses"):
        exchange.tick(REST, REST, REST, REST)

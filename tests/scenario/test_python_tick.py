"""A controller in Python called as a C function: the same torque, and an error that goes through no compiled code."""

import numpy as np
import pytest

from moc_opt.control.called_tick import BAD_INPUT, CalledTick
from moc_opt.numerics.compiled import ask
from moc_opt.scenario import Scenario, Setup
from moc_opt.scenario.python_tick import PythonTick


def started(law="moc"):
    """Two controllers begun alike, the second one to be called, with its columns; and a measurement."""
    setup = Setup(Scenario(control={"law": law}))
    seen, tip_ref = setup.plant.measure(), np.stack(setup.reference.at(0.0))
    trocar = np.stack(setup.registered.at(0.0))
    plain, called = setup.adapter(), PythonTick(setup.adapter())
    for controller in (plain, called):
        controller.start(seen.q, seen.v, tip_ref, trocar)
    columns = {"tick_us": np.full(9, 100.0), **called.columns(9)}
    called.begin(columns, 2)
    for name, value in (("q", seen.q), ("v", seen.v), ("tip_ref", tip_ref), ("trocar", trocar)):
        getattr(called.memory, name)[:] = value
    return plain, called, columns, (seen.q, seen.v, tip_ref, trocar)


def call(controller):
    return ask(int(controller.memory.function[0]), tuple(controller.memory.pointers.tolist()))


@pytest.mark.parametrize("law", ["moc", "dcac"])
def test_called_from_compiled_code_it_is_the_same_tick(law):
    plain, called, columns, given = started(law)
    assert isinstance(called, CalledTick)
    assert not isinstance(plain, CalledTick)
    for row in (2, 3):
        tau = plain.tick(*given)
        assert call(called) == 0
        np.testing.assert_array_equal(called.memory.tau, tau)
        np.testing.assert_array_equal(called.memory.known[called.memory.places], plain.state.record)
        if law == "moc":
            np.testing.assert_array_equal(columns["x_rad_per_s"][row], plain.controller.solution.x)
            assert columns["status"][row] == "solved"
    called.took(np.zeros(2, dtype=np.int64), columns, 2)
    assert (columns["tick_us"][2:4] < 100.0).all()
    assert (np.delete(columns["tick_us"], [2, 3]) == 100.0).all()


def test_a_torque_that_was_cut_is_told_before_the_next_tick_or_at_the_end():
    plain, called, columns, given = started()
    plain.tick(*given)
    call(called)
    called.memory.torque[:] = 0.5 * called.memory.tau
    plain.set_applied_torque(called.memory.torque.copy())
    assert call(called) == 0
    np.testing.assert_array_equal(called.memory.tau, plain.tick(*given))
    assert np.isnan(called.memory.torque).all()
    called.memory.torque[:] = 0.0
    called.took(np.zeros(2, dtype=np.int64), columns, 2)
    plain.set_applied_torque(np.zeros(7))
    np.testing.assert_array_equal(called.tick(*given), plain.tick(*given))


def test_an_error_is_kept_for_the_single_step():
    _, called, _, given = started()
    error = KeyboardInterrupt()

    def tick(*_):
        raise error

    called.controller.tick = tick
    assert call(called) == BAD_INPUT
    del called.controller.tick
    with pytest.raises(KeyboardInterrupt) as caught:
        called.tick(*given)
    assert caught.value is error
    assert np.isfinite(called.tick(*given)).all()

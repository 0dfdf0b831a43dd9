"""A machine with more to do than it has cores says so."""

import os

import pytest

from moc_opt.report import machine

CORES = len(os.sched_getaffinity(0))


@pytest.mark.parametrize(("load", "said"), [(CORES + 1.5, True), (0.4, False), (float(CORES), False)])
def test_more_threads_than_cores_are_said(monkeypatch, load, said):
    monkeypatch.setattr(os, "getloadavg", lambda: (load, 0.0, 0.0))
    found = machine.busy()
    assert bool(found) is said
    if said:
        assert f"load {load:.1f} on {CORES} cores" in found


def test_where_the_load_is_unknown_nothing_is_said(monkeypatch):
    def unknown():
        raise OSError

    monkeypatch.setattr(os, "getloadavg", unknown)
    assert machine.busy() == ""

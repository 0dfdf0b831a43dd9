"""Workers behind threads: results in order, errors of their own type, nothing left behind."""

import os
import time

import pytest

from benchmarks.common.crew import Crew, run_parallel, spread
from benchmarks.common.processes import Crashed, Worker
from moc_opt.errors import UnknownNameError
from tests.benchmarks.common.test_processes import gone, square


@pytest.mark.parametrize("processes", [1, 2])
def test_results_are_in_the_order_of_the_items(processes):
    told = []
    assert run_parallel(square, range(8), processes, lambda: told.append(1)) == [n**2 for n in range(8)]
    assert len(told) == 8


@pytest.mark.parametrize(("number", "error"), [(13, UnknownNameError), (19, Crashed)])
def test_an_error_ends_all_work(number, error):
    with pytest.raises(error):
        run_parallel(square, [1, 2, number, 4], 2, lambda: None)
    with pytest.raises(error):
        spread([1, number, 2], lambda worker, item: worker.call(square, item), 2)


def interrupted(told):
    """A crew at work, left by a Ctrl-C."""
    with Crew(2) as crew:
        told.append(crew.submit(Worker.call, os.getpid).result())
        for _ in range(3):
            crew.submit(Worker.call, time.sleep, 600.0)
        raise KeyboardInterrupt


def test_a_crew_that_is_left_in_a_hurry_ends_its_workers():
    told = []
    with pytest.raises(KeyboardInterrupt):
        interrupted(told)
    assert gone(told[0])

"""Workers: results come one by one, and a hang, a crash or an exception costs one call and never the caller."""

import os
import signal
import time

import pytest

from benchmarks.solver_study.worker import Crashed, Hung, Raised, Worker, beat


def numbers(count):
    yield from range(count)


def hangs_after(count):
    yield from range(count)
    while True:
        pass


def crashes_after(count):
    yield from range(count)
    os.kill(os.getpid(), signal.SIGSEGV)


def raises_after(count):
    yield from range(count)
    raise ValueError("no more")


def beats(count, pause):
    for _ in range(count):
        time.sleep(pause)
        beat()
    yield "done"


def exits():
    yield os.getpid()
    os._exit(3)


@pytest.fixture(scope="module")
def worker():
    with Worker() as made:
        yield made


def collected(stream):
    """What came, and the error that ended it."""
    found = []
    try:
        for item in stream:
            found.append(item)
    except (Hung, Crashed, Raised) as error:
        return found, error
    return found, None


def test_results_come_in_order(worker):
    assert list(worker.stream(numbers, 5, patience_s=10.0)) == [0, 1, 2, 3, 4]


def test_a_hang_ends_in_time_and_what_came_before_stays(worker):
    list(worker.stream(numbers, 1, patience_s=10.0))  # it is running
    begin = time.monotonic()
    found, error = collected(worker.stream(hangs_after, 3, patience_s=0.5, first_s=5.0))
    assert found == [0, 1, 2]
    assert isinstance(error, Hung)
    assert time.monotonic() - begin < 5.0
    assert list(worker.stream(numbers, 2, patience_s=10.0)) == [0, 1]  # a new process serves


def test_a_crash_says_its_signal(worker):
    found, error = collected(worker.stream(crashes_after, 2, patience_s=10.0))
    assert found == [0, 1]
    assert isinstance(error, Crashed)
    assert "SIGSEGV" in str(error)
    _, error = collected(worker.stream(exits, patience_s=10.0))
    assert "exit code 3" in str(error)


def test_an_exception_leaves_the_worker_alive(worker):
    (pid,), _ = collected(worker.stream(process_id, patience_s=10.0))
    found, error = collected(worker.stream(raises_after, 1, patience_s=10.0))
    assert (found, str(error)) == ([0], "ValueError: no more")
    assert collected(worker.stream(process_id, patience_s=10.0)) == ([pid], None)


def process_id():
    yield os.getpid()


def test_signs_of_life_stretch_the_patience(worker):
    list(worker.stream(numbers, 1, patience_s=10.0))
    assert list(worker.stream(beats, 6, 0.3, patience_s=1.2, first_s=0.0)) == ["done"]
    _, error = collected(worker.stream(beats, 1, 3.0, patience_s=0.4, first_s=0.0))
    assert isinstance(error, Hung)


def test_a_stream_that_nobody_reads_to_its_end_is_stopped(worker):
    (pid,), _ = collected(worker.stream(process_id, patience_s=10.0))
    stream = worker.stream(hangs_after, 5, patience_s=10.0)
    assert next(stream) == 0
    stream.close()
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)
    assert list(worker.stream(numbers, 1, patience_s=10.0)) == [0]


def test_beat_outside_a_worker_does_nothing():
    assert beat() is None

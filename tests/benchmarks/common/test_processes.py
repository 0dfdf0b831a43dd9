"""Workers: results come one by one, and a hang, a crash or an exception costs one call and never the caller."""

import errno
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from benchmarks.common.processes import Crashed, Hung, Raised, Worker, beat
from moc_opt.errors import UnknownNameError

ROOT = Path(__file__).resolve().parents[3]


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
    found, error = collected(worker.stream(hangs_after, 3, patience_s=2.0, first_s=60.0))
    assert found == [0, 1, 2]
    assert isinstance(error, Hung)
    assert "within 2 s" in str(error), "the patience, not that for the first result"
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
    assert list(worker.stream(beats, 10, 0.3, patience_s=2.5, first_s=0.0)) == ["done"]
    _, error = collected(worker.stream(beats, 1, 60.0, patience_s=0.4, first_s=0.0))
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


# --- one call ---


def square(number):
    if number == 13:
        raise UnknownNameError("number", "13", ["12", "14"])
    if number == 17:
        raise ValueError(lambda: "cannot be pickled")
    if number == 19:
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(0.02 * (number % 3))
    return number**2


def test_a_call_returns_or_raises_as_it_would_here(worker):
    assert worker.call(square, 5) == 25
    with pytest.raises(UnknownNameError, match="13"):
        worker.call(square, 13)
    with pytest.raises(OSError, match="No such file") as missing:
        worker.call(os.stat, "/no/such/file")
    assert missing.value.errno == errno.ENOENT
    with pytest.raises(Raised, match=r"ValueError: <function .*lambda"):
        worker.call(square, 17)
    with pytest.raises(Crashed, match="SIGKILL"):
        worker.call(square, 19)
    with pytest.raises(Hung):
        worker.call(time.sleep, 60.0, patience_s=-39.5)
    assert worker.call(square, 6) == 36


def test_every_sign_of_life_is_told(worker):
    told = []
    assert list(worker.stream(beats, 3, 0.01, patience_s=10.0, on_beat=lambda: told.append(1))) == ["done"]
    assert len(told) == 3


# --- nothing is left behind ---


def alive(pid):
    """Whether a process is there; one that has ended, and that nobody has waited for, is not."""
    try:
        return (Path("/proc") / str(pid) / "stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def gone(pid):
    """Whether a process has ended, or does so within a minute."""
    for _ in range(1200):
        if not alive(pid):
            return True
        time.sleep(0.05)
    return False


def starts_another():
    yield subprocess.Popen(["sleep", "600"]).pid
    while True:
        pass


def test_what_a_killed_worker_has_started_ends_with_it(worker):
    found, error = collected(worker.stream(starts_another, patience_s=0.5, first_s=20.0))
    assert isinstance(error, Hung)
    assert gone(found[0])


PARENT = """
import os, sys, time
from benchmarks.common.processes import Worker
if __name__ == "__main__":
    worker = Worker(fresh=sys.argv[1] == "fresh", preload=())
    print(worker.call(os.getpid), flush=True)
    worker.call(time.sleep, 600.0)
"""


@pytest.mark.parametrize("start", ["fresh", "forked"])
def test_a_worker_ends_with_its_parent_however_that_ends(start, tmp_path):
    (tmp_path / "parent.py").write_text(PARENT)
    parent = subprocess.Popen(
        [sys.executable, str(tmp_path / "parent.py"), start], stdout=subprocess.PIPE, text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    pid = int(parent.stdout.readline())
    time.sleep(0.3)
    assert alive(pid)
    parent.kill()
    parent.wait()
    parent.stdout.close()
    assert gone(pid)

"""Finished jobs: they come back as they were, where nothing they depend on changed, and only kinds that results are."""

import hashlib
import os
import pickle
import subprocess
from pathlib import Path

import numpy as np
import pytest

from benchmarks.common import kept as kept_jobs
from benchmarks.common.crew import run_parallel
from benchmarks.common.kept import Kept
from benchmarks.paper_experiment.trials import Measurement, Outcome
from moc_opt.trace.trace import Trace

STOP = "stop"


def work(item):
    """Write that it was called; items after a file called "stop" in its folder are interrupted."""
    folder, number = item
    if number >= 2 and (folder / STOP).exists():
        raise KeyboardInterrupt
    (folder / f"{number}.{os.getpid()}.called").touch(exist_ok=False)
    return {"number": number, "square": np.float64(number**2)}


def test_what_is_kept_comes_back(tmp_path):
    found = Measurement("g", "exact", "circle", "circle/0", 3, "whole", {"mu_mean": np.float64(0.25)})
    trace = Trace({"t_s": [0.0, 0.002], "status": ["solved", "none"]}, {"ended": "completed"})
    outcome = Outcome([found], {("exact", "circle"): {"mu": np.ones(3, dtype=np.float32)}}, {"exact": trace})
    Kept(tmp_path, {"seed": 0}).put("one", outcome)
    again = Kept(tmp_path, {"seed": 0})
    (back,) = again.get("one")
    assert back.measurements == [found]
    np.testing.assert_array_equal(back.samples["exact", "circle"]["mu"], np.ones(3))
    assert back.traces["exact"].status.tolist() == ["solved", "none"]
    assert back.traces["exact"].meta == trace.meta
    assert again.reused == 1
    assert again.of("one", lambda: pytest.fail("it is there")).measurements == [found]


def test_another_configuration_job_or_source_asks_again(tmp_path, monkeypatch):
    Kept(tmp_path, {"seed": 0}).put("one", None)
    assert Kept(tmp_path, {"seed": 0}).get("one") == (None,)
    assert Kept(tmp_path, {"seed": 1}).get("one") is None
    assert Kept(tmp_path, {"seed": 0}).get("two") is None
    monkeypatch.setattr(kept_jobs, "circumstances", lambda sources: "another version")
    assert Kept(tmp_path, {"seed": 0}).get("one") is None


def test_a_damaged_result_is_done_again(tmp_path, capsys):
    kept = Kept(tmp_path, {})
    kept.put("one", {"a": 1.0})
    (path,) = tmp_path.glob("*.job")
    path.write_bytes(b"x" + path.read_bytes()[1:])
    assert kept.of("one", lambda: {"a": 2.0}) == {"a": 2.0}
    assert "done again" in capsys.readouterr().err
    assert (tmp_path / "damaged" / path.name).exists()


class Call:
    """Pickles as the call of a function."""

    def __init__(self, function, *arguments):
        self.call = function, arguments

    def __reduce__(self):
        return self.call


@pytest.mark.parametrize("what", [os.system, subprocess.Popen, Path.touch, eval])
def test_a_file_from_elsewhere_calls_nothing(tmp_path, what, capsys):
    kept = Kept(tmp_path, {})
    kept.put("one", None)
    (path,) = tmp_path.glob("*.job")
    target = tmp_path / "made"
    argument = target if what is Path.touch else f"open({str(target)!r}, 'w')" if what is eval else f"touch {target}"
    data = pickle.dumps(Call(what, argument))
    path.write_bytes(data + hashlib.sha256(data).digest())
    assert kept.get("one") is None
    assert not target.exists()
    assert "no kind of result" in capsys.readouterr().err


def test_a_class_reached_through_a_module_of_ours_is_none_of_ours(tmp_path):
    kept = Kept(tmp_path, {})
    kept.put("one", None)
    (path,) = tmp_path.glob("*.job")
    data = b"\x80\x04\x8c\x17benchmarks.common.output\x8c\x10subprocess.Popen\x93."
    data = data.replace(b"\x8c\x17", b"\x8c\x18")
    path.write_bytes(data + hashlib.sha256(data).digest())
    assert kept.get("one") is None


@pytest.mark.parametrize("processes", [1, 2])
def test_what_was_stopped_goes_on_where_it_stopped(tmp_path, processes):
    folder, done = tmp_path / "runs", []
    folder.mkdir()
    (folder / STOP).touch()
    items = [(folder, number) for number in range(5)]

    def run():
        return run_parallel(work, items, processes, lambda: done.append(1), Kept(tmp_path / "jobs", {"seed": 0}))

    with pytest.raises(KeyboardInterrupt):
        run()
    before = {path.name.partition(".")[0] for path in folder.glob("*.called")}
    (folder / STOP).unlink()
    done.clear()
    assert [found["number"] for found in run()] == list(range(5))
    assert len(done) == 5
    called = [path.name.partition(".")[0] for path in folder.glob("*.called")]
    assert sorted(called) == ["0", "1", "2", "3", "4"] if processes == 1 else set(called) == set("01234")
    assert before <= {"0", "1"}
    assert [found["square"] for found in run()] == [0.0, 1.0, 4.0, 9.0, 16.0]
    assert len([path for path in folder.glob("*.called")]) == len(called), "nothing was left to do"

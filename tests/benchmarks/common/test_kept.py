"""Finished jobs: they come back as they were, where nothing they depend on changed, and only kinds that results are."""

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.common import store
from benchmarks.common.crew import run_parallel
from benchmarks.common.kept import Kept, packed, unpacked
from benchmarks.paper_experiment.trials import Measurement, Outcome
from moc_opt.errors import MocOptError
from moc_opt.inputs.files import parse_json, to_json
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
    monkeypatch.setattr(store, "circumstances", lambda sources: "another version")
    assert Kept(tmp_path, {"seed": 0}).get("one") is None


def test_a_damaged_result_is_done_again(tmp_path, capsys):
    kept = Kept(tmp_path, {})
    kept.put("one", {"a": 1.0})
    (path,) = tmp_path.glob("*.npz")
    path.write_bytes(b"x" + path.read_bytes()[1:])
    assert kept.of("one", lambda: {"a": 2.0}) == {"a": 2.0}
    assert "done again" in capsys.readouterr().err
    assert (tmp_path / "damaged" / path.name).exists()


LEAVES = st.none() | st.booleans() | st.integers(-(2**62), 2**62) | st.floats() | st.text(max_size=5)


@given(
    st.recursive(
        LEAVES,
        lambda inner: (
            st.lists(inner, max_size=3)
            | st.tuples(inner, inner)
            | st.dictionaries(st.text(max_size=3) | st.tuples(st.text(max_size=2)), inner, max_size=3)
        ),
        max_leaves=8,
    )
)
def test_plain_values_come_back_with_their_types(value):
    arrays = {}
    text = to_json(packed(value, arrays), indent=None)
    assert repr(unpacked(parse_json(text, "test", MocOptError), arrays)) == repr(value)


@pytest.mark.parametrize(
    ("module", "name"),
    [("subprocess", "Popen"), ("benchmarks.common.output", "subprocess"), ("benchmarks.common.kept", "Kept"),
     ("benchmarks.common.store", "Store"), ("benchmarks.common.kept", "Part"), ("moc_opt.trace.trace", "Trace"),
     ("benchmarks.common.nowhere", "Part"), ("builtins", "eval")],
)  # fmt: skip
def test_a_file_from_elsewhere_calls_nothing_but_a_record(module, name):
    with pytest.raises(MocOptError, match="of no known kind"):
        unpacked(["record", [module, name, {}]], {})


@pytest.mark.parametrize("value", [object(), {1, 2}, b"bytes", Path("x"), [lambda: 0]])
def test_what_is_no_result_is_refused_when_it_is_kept(tmp_path, value):
    with pytest.raises(TypeError, match="not kept"):
        Kept(tmp_path, {}).put("one", value)


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

"""The trace of a run is written, whatever ends the run."""

import os
import signal
from pathlib import Path

import numpy as np
import pytest

from moc_opt.__main__ import main
from moc_opt.errors import TraceError
from moc_opt.scenario import Scenario, Setup
from moc_opt.sim import Plant
from moc_opt.trace.file import check_trace
from moc_opt.trace.metrics import summarize
from moc_opt.trace.trace import Trace

SHORT = {"duration_s": 0.2, "bound_samples": 3}


@pytest.fixture(scope="module")
def whole():
    return Setup(Scenario(**SHORT)).trace()


@pytest.mark.parametrize("place", ["watch", "controller"])
@pytest.mark.parametrize("error", [KeyboardInterrupt(), ValueError("a defect")])
def test_trace_is_saved_whatever_ends_the_run(whole, error, place, tmp_path, monkeypatch):
    ticks, calls, setup = 57, iter(range(10**6)), Setup(Scenario(**SHORT))
    controller = setup.controller()

    def failing(sound):
        def call(*given):
            if next(calls) == ticks:
                raise error
            return sound(*given)

        return call

    if place == "controller":
        monkeypatch.setattr(controller, "tick", failing(controller.tick))
        monkeypatch.setattr(setup, "controller", lambda: controller)
    with pytest.raises(type(error)) as caught:
        setup.trace(failing(lambda tick: None) if place == "watch" else None, tmp_path / "t.parquet")
    assert caught.value is error
    assert any("first 0.114 s" in note and "t.parquet" in note for note in caught.value.__notes__)
    found = Trace.load(tmp_path / "t.parquet")
    assert type(error).__name__ in found.meta["ended"]
    assert (len(found), found.meta["ticks"], found.meta["ticks_planned"]) == (ticks, ticks, len(whole))
    assert found.q_rad.tobytes() == whole.q_rad[:ticks].tobytes()
    assert found.verified.tobytes() == whole.verified[:ticks].tobytes()
    assert os.listdir(tmp_path) == ["t.parquet"]
    assert 0.0 < summarize(found)["share_of_run"] < 1.0


@pytest.mark.parametrize(("number", "status", "message"), [
    (signal.SIGINT, 130, "interrupted; the first 0.296 s "), (signal.SIGTERM, 130, "interrupted; the first 0.296 s "),
    (0, 1, f"ZeroDivisionError: a defect of two lines ({Path(__file__).name}:"),
])  # fmt: skip
def test_run_saves_the_trace_at_a_signal_or_defect(tmp_path, capsys, monkeypatch, number, status, message):
    calls, real = iter(range(10**6)), Plant.measure

    def breaking(self):
        if next(calls) == 150:
            os.chdir("/")
            if not number:
                raise ZeroDivisionError("a defect\nof two lines")
            signal.raise_signal(number)
        return real(self)

    monkeypatch.setattr(Plant, "measure", breaking)
    monkeypatch.chdir(tmp_path)
    file, target = tmp_path / "s.toml", tmp_path / "t.parquet"
    file.write_text("duration_s = 1.0\n")
    assert main(["run", str(file), "--trace", str(target)]) == status
    said = capsys.readouterr()
    assert (said.out, said.err[: len(message)]) == ("", message)
    assert (len(Trace.load(target)), sorted(os.listdir())) == (148, ["s.toml", "t.parquet"]), "2 calls precede the loop"


@pytest.mark.parametrize("target", ["nowhere/t.parquet", "file/t.parquet", "t.csv", "."])
def test_file_that_cannot_be_written_is_refused_before_the_run(target, tmp_path, capsys, monkeypatch):
    (tmp_path / "file").write_text("")
    (tmp_path / "s.toml").write_text("duration_s = 0.1\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(Plant, "step", lambda *given: pytest.fail("the run began"))
    assert main(["run", "s.toml", "--trace", target]) == 2
    assert "folder" in capsys.readouterr().err or target == "t.csv"
    assert sorted(os.listdir(tmp_path)) == ["file", "s.toml"]


def test_a_file_of_another_kind_is_not_replaced(tmp_path):
    for kind, other in (("run", "course"), ("course", "run")):
        Trace({"t_s": np.zeros(2)}, {"kind": kind} if kind == "course" else {}).save(tmp_path / "t.parquet")
        check_trace(tmp_path / "t.parquet", kind)
        with pytest.raises(TraceError, match=f"holds no {other} and would be replaced"):
            check_trace(tmp_path / "t.parquet", other)

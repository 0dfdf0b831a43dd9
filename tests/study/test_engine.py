"""The engine that runs a study's jobs."""

import importlib
import operator
import os
import signal
import subprocess
import sys
import sysconfig
import time
from collections import defaultdict
from functools import partial
from importlib.metadata import EntryPoint
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import psutil
import pytest

from moc_opt.errors import StudyError
from moc_opt.scenario import Scenario
from moc_opt.study import Failed, Job, Kept, engine, kept, run
from moc_opt.study.kept import key_of
from tests.study import work

HOME = Path(__file__).parents[2]
ENV = os.environ | {"PYTHONPATH": str(HOME), "PYTHONDONTWRITEBYTECODE": "1"}


def test_failing_jobs_do_not_harm_other_jobs(tmp_path):
    jobs = [
        Job(work.square, (3.0,)), Job(time.sleep, (60.0,), limit_s=0.5), Job(work.die), Job(work.leave),
        Job(work.refuse), Job(work.throw, (KeyboardInterrupt,)),
        Job(work.fork_and_hang, (str(tmp_path / "child"),), limit_s=3.0),
        Job(work.eat_memory), Job(lambda: None), Job(work.refuse_name), Job(work.odd_result),
        # GeneratorExit is no subclass of Exception.
        Job(work.throw, (GeneratorExit,)), Job(work.NoWayBack), Job(work.square, (4.0,)),
    ]  # fmt: skip
    done: list[int] = []
    found = run(jobs, workers=2, done=lambda job, result: done.append(jobs.index(job)))
    assert (found[0], found[-1], sorted(done)) == (9.0, 16.0, list(range(len(jobs))))
    kinds = [result.kind if isinstance(result, Failed) else None for result in found]
    assert kinds == [None, "hung", "crashed", "crashed", "raised", "raised", "hung", *["raised"] * 6, None]
    assert "SIGSEGV" in str(found[2])
    assert "exit code 3" in str(found[3])
    assert "'knot'" in str(found[4])
    assert "memory" in str(found[7]).lower()
    child = int((tmp_path / "child").read_text())
    until = time.monotonic() + 5.0
    while psutil.pid_exists(child) and psutil.Process(child).status() != psutil.STATUS_ZOMBIE:
        assert time.monotonic() < until, "a process that the job started is still alive"
        time.sleep(0.05)


@pytest.mark.parametrize("workers", [1, 2])
def test_dying_processes_are_reported_as_crashed(workers):
    jobs = [Job(work.die, (signal.SIGKILL, 0.0)), Job(work.leave, (0, 0.0)), Job(work.square, (2.0,))] * 6
    found = run(jobs, workers=workers)
    assert [getattr(result, "kind", result) for result in found] == ["crashed", "crashed", 4.0] * 6


def test_stored_result_is_ignored_after_a_hang_in_its_group(tmp_path):
    good = Job(work.square, (3.0,), group="slow")
    assert run([good], kept=Kept(tmp_path)) == [9.0]
    found = run([Job(time.sleep, (60.0,), limit_s=0.3, group="slow"), good], kept=Kept(tmp_path))
    assert [result.kind for result in found] == ["hung", "not run"]


def test_time_limit_applies_to_each_step_of_a_job():
    found = run([Job(work.steps, ([0.01, 0.5, 0.01], 0.3)), Job(work.steps, ([0.01, 9.0], 0.3))], workers=2)
    assert found[0] == 3, "the limit is processor time; a sleeping step is stopped after five times the limit"
    assert (found[1].kind, found[1].parts) == ("hung", (0.01,))


def test_jobs_marked_alone_share_one_process():
    found = run([Job(os.getpid, alone=True) for _ in range(4)] + [Job(os.getpid)], workers=2)
    assert len(set(found[:4])) == 1
    assert found[4] != found[0]


def test_second_run_repeats_only_failed_jobs(tmp_path):
    log, file = str(tmp_path / "log"), tmp_path / "file"
    jobs = [Job(work.square, (float(x), log)) for x in range(5)] + [Job(work.refuse), Job(work.arrays, (3,))]
    jobs.append(Job(operator.call, (partial(os.truncate, str(file), 5),)))  # changes a file that it names
    file.touch()
    first = run(jobs, kept=Kept(tmp_path / "jobs"), workers=2)
    file.write_text("")
    kept = Kept(tmp_path / "jobs")
    second = run(jobs, kept=kept, workers=2)
    assert (first[:5], kept.reused) == (second[:5], 6)
    np.testing.assert_array_equal(second[6]["column"], np.arange(3.0))
    assert len((tmp_path / "log").read_text().split()) == 5


CHANGED = """
from pathlib import Path
import own_trial
from moc_opt.study import Job, Kept, run
if __name__ == "__main__":
    kept = Kept(Path("jobs"))
    print(*run([Job(own_trial.trial)], kept=kept, workers=1), kept.reused)
"""


def test_job_runs_again_after_a_change_of_its_code(tmp_path):
    (tmp_path / "own_trial.py").write_text("import own_part\ndef trial(): return own_part.value()\n")
    answers = []
    for text in ("1", "1", "2"):
        (tmp_path / "own_part.py").write_text(f"def value(): return {text}\n")
        answers.append(_python(tmp_path, CHANGED))
    assert answers == ["1 0", "1 1", "2 0"]


def _python(folder: Path, script: str) -> str:
    (folder / "script.py").write_text(script)
    return subprocess.check_output([sys.executable, "script.py"], env=ENV, cwd=folder, text=True).strip()


KILLED = """
from pathlib import Path
from moc_opt.study import Job, Kept, run
from tests.study.work import slow_square
if __name__ == "__main__":
    print(run([Job(slow_square, (k,)) for k in range(8)], kept=Kept(Path("jobs")), workers=2), flush=True)
"""


def test_killed_study_loses_no_finished_job(tmp_path):
    (tmp_path / "script.py").write_text(KILLED)
    done = 0
    for number in (signal.SIGKILL, signal.SIGINT):
        study = subprocess.Popen([sys.executable, "script.py"], env=ENV, cwd=tmp_path, stderr=subprocess.DEVNULL)
        before, until = _finished(tmp_path), time.monotonic() + 30.0
        while _finished(tmp_path) <= before and study.poll() is None and time.monotonic() < until:
            time.sleep(0.02)
        family = psutil.Process(study.pid).children(recursive=True) if study.poll() is None else []
        study.send_signal(number)
        study.wait(20.0)
        _, alive = psutil.wait_procs(family, timeout=10.0)
        assert not alive
        assert _finished(tmp_path) >= done
        done = _finished(tmp_path)
    assert 2 <= done < 8
    assert _python(tmp_path, KILLED) == str([float(k * k) for k in range(8)])


def _finished(folder: Path) -> int:
    return len(Kept(folder / "jobs")._cache) if (folder / "jobs").exists() else 0


def test_damaged_folder_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    (tmp_path / "jobs").mkdir()
    (tmp_path / "jobs" / "cache.db").write_bytes(b"not a database" * 1000)
    for name in ("jobs", "file"):
        with pytest.raises(StudyError, match=f"{name} cannot keep finished jobs .*remove it"):
            Kept(tmp_path / name)


def test_cluster_gives_the_same_results(monkeypatch, tmp_path):
    monkeypatch.setattr(engine, "CONNECT_S", 5.0)
    monkeypatch.syspath_prepend(HOME / "examples")
    own_study = importlib.import_module("own_study")
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(1, threads_per_worker=1, processes=True, dashboard_address=None) as cluster:
        jobs = [Job(work.square, (3.0,)), Job(work.refuse), Job(work.arrays, (2,))]
        here, there = run(jobs, workers=1), run(jobs, dask=cluster.scheduler_address)
        assert (there[0], str(there[1])) == (here[0], str(here[1]))
        np.testing.assert_array_equal(there[2]["column"], here[2]["column"])
        trials = [Job(own_study.trial, ("exact", delay, 0)) for delay in (1, 3)]
        rows = run(trials, kept=Kept(tmp_path / "jobs"), dask=cluster.scheduler_address)
    assert [row["delay"] for row in rows] == [1, 3]
    assert run(trials, kept=Kept(tmp_path / "jobs")) == rows, "the rows come from the folder: the scheduler has ended"
    with pytest.raises(StudyError, match="no Dask scheduler answers"):
        run(jobs, dask="tcp://127.0.0.1:1")


def test_unusable_workers_and_clusters_are_refused(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    for more, said in (({"workers": -3}, "workers = -3: give 1"), ({"dask": "tcp://x:1"}, r".\[cluster\]")):
        with pytest.raises(StudyError, match=said):
            run([Job(work.square, (2.0,))], **more)


def test_job_has_a_new_key_if_a_file_that_its_settings_or_its_robot_names_changes(tmp_path):
    arm, urdf, links, keys = tmp_path / "arm.toml", tmp_path / "arm.urdf", tmp_path / "links", set()
    links.mkdir()
    urdf.touch()
    for file, text in (arm, "urdf = 'links/a'"), (arm, "urdf = 'links/bb'"), (links / "bb", ""), (links / "bb", "new"):
        file.write_text(text)
        for k, settings in enumerate((Scenario(robot={"name": str(arm)}), {"x": [str(arm)]}, {"x": str(urdf)})):
            keys.add((k, key_of(work.square, (settings,))))
    assert len(keys) == 3 * 4


def test_plug_ins_of_every_kind_are_sources_of_a_job(monkeypatch):
    file = f"{sysconfig.get_path('purelib')}/own.py"
    monkeypatch.setitem(sys.modules, "own", SimpleNamespace(__file__=file))
    for kind in ("moc_opt.solvers", "moc_opt.tasks", "moc_opt.metrics", "another"):
        points = defaultdict(dict, {kind: {"x": [EntryPoint("x", "own:x", kind)]}})
        monkeypatch.setattr(kept, "plugins", points.__getitem__)
        kept._sources.cache_clear()
        assert any(source.endswith("/own.py") for source in kept.loaded_sources()) is (kind != "another")

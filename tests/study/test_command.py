"""The command line of a study: its options, output, files and exit status."""

import json
import os
import re
import signal
from pathlib import Path
from typing import Any, Self

import polars as pl
import pytest

from moc_opt.errors import ScenarioError, SolverError, UnknownNameError
from moc_opt.figures.style import figure
from moc_opt.report.tables import Column, Table
from moc_opt.scenario import Scenario
from moc_opt.study import Job, command
from moc_opt.study.command import Found, Study, StudyConfig
from moc_opt.study.results import Results
from moc_opt.study.show import Picture, Report
from moc_opt.study.trials import Trial
from tests.study.work import refuse, slow_square


class Config(StudyConfig):
    count: int = 4

    def quick(self) -> Self:
        return self.model_copy(update={"count": 1})


def squares(study: Study, config: Config) -> Found:
    """Sum the first `config.count` squares. A further job fails."""
    found = study.run([Job(slow_square, (k,)) for k in range(config.count)])
    rows = Results({"trial": k, "x": x} for k, x in enumerate(found))
    rows.add({"trial": "last", "error": str(study.run([Job(refuse)])[0])})
    table = Table("Squares", [Column("trial", "k"), Column("x", "square")], list(rows)[:-1])
    summary = {"all": {"sum": sum(found), "none": float("nan")}}
    report = Report("Sums", [f"The sum is [{sum(found):.0f}]."], table, [Picture(figure(), "See.", "seen")])
    return Found(report, summary, rows, {"note": 1}, ["more.txt"], ["One more sentence."], 3)


def call(work: Any, *arguments: Any, **more: Any) -> int:
    return command.command("tiny", "About sums.", Config, work, [*map(str, arguments)], **more)


@pytest.fixture
def asked(tmp_path: Path) -> tuple[Path, Path]:
    (tmp_path / "tiny.toml").write_text("seed = 5\nprocesses = 2\n")
    return tmp_path / "tiny.toml", tmp_path / "new" / "out"


def test_study_writes_and_prints_its_result(asked, capsys):
    config, out = asked
    assert call(squares, config, "--out", out) == 3, "`squares` returns the exit status 3"
    said = capsys.readouterr().out
    assert all(words in said for words in ("The sum is [14].", "Squares", "One more sentence.", "more.txt"))
    summary = json.loads((out / "summary.json").read_text())
    assert summary == {"all": {"sum": 14.0, "none": None}}
    rows = pl.read_parquet(out / "rows.parquet").to_dicts()
    assert [row["x"] for row in rows] == [0.0, 1.0, 4.0, 9.0, None]
    made = json.loads((out / "environment.json").read_text())
    assert (made["seed"], made["note"], made["config"]["count"], made["jobs_of_an_earlier_run"]) == (5, 1, 4, 0)
    assert made["arguments"] == [str(config), "--out", str(out)]
    assert made["machine"]["cores"] == os.cpu_count()
    assert "The sum is [14]." in (out / "report.html").read_text()
    assert (out / "report.md").read_text().startswith("# Sums\n\nThe sum is [14].\n")
    assert call(squares, config, "--out", out, "--json") == 3
    assert capsys.readouterr().out == (out / "summary.json").read_text()
    assert json.loads((out / "environment.json").read_text())["jobs_of_an_earlier_run"] == 4, "no failed job is kept"
    capsys.readouterr()
    other = (out / "environment.json").read_text().replace('"study": "tiny"', '"study": "cubes"')
    for spoil in (lambda file: file.write_text(other), lambda file: file.write_text("mine"), Path.unlink):
        spoil(out / "environment.json")
        assert call(lambda *_: pytest.fail("the study ran in a folder that must be refused"), config, "--out", out) == 2
        assert "that this study has not written" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "seed", "count"), [((), 5, 4), (("--seed", str(2**62)), 2**62, 4), (("--seed", "7", "--quick"), 7, 1)],
)
def test_options_change_the_configuration(asked, monkeypatch, options, seed, count):
    seen = []

    def work(study, config):
        seen.append((config.seed, config.count, study.processes, study.out, study.given.many))
        raise ScenarioError("enough")

    monkeypatch.setattr("sys.argv", ["pytest", "--nonsense"])
    own = {"options": lambda parser: parser.add_argument("--many", type=int, default=8), "folder": asked[0].parent}
    assert call(work, *options, **own) == 2
    assert seen == [(seed, count, 2, Path("results/tiny"), 8)]


@pytest.mark.parametrize(("content", "said"), [
    ("cuont = 3", r"tiny\.toml: .*did you mean 'count'"), ("seed = -1", r"tiny\.toml: .*seed = -1"),
    (None, r"tiny\.toml.*no such file"), ("", r"new"),
])  # fmt: skip
def test_input_error_is_printed_as_one_line(asked, capsys, content, said):
    config, out = asked
    config.unlink() if content is None else config.write_text(content)
    out.parent.write_text("a file in the place of the folder")
    assert call(squares, config, "--out", out) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert re.search(rf"^\w+Error: .*{said}", line)


def test_trial_without_a_start_is_reported_in_a_row(asked):
    case = Scenario(name="circle/5", seed=5, duration_s=0.1, bound_samples=0, judge=False)
    bad = case.change(name="bad", start={"q_rad": (0.0,) * 7})
    study = Study("tiny", asked[1], command.Namespace(), 1)
    (found,), (lost,) = study.placed([bad, case])
    assert (found.name, found.start.check_path) == ("circle/5", False)
    assert (lost["trial"], lost["ended"], lost["whole"]) == ("bad", "no start", False)
    runs = study.trials([Trial(found, "exact"), Trial(bad, "exact")])
    assert [run.row["ended"] for run in runs] == ["completed", "failed"]
    endless = found.change(duration_s=1000.0)
    assert study.trials([Trial(endless, "rnn")], limit_s=0.01)[0].row["error"].startswith("hung")


def test_solvers_are_chosen_by_name(monkeypatch):
    monkeypatch.setattr(command, "available", lambda: {"exact": None, "osqp": "no module named osqp"})
    assert command.choose("all", "dcac") == (["dcac", "exact"], {"osqp": "no module named osqp"})
    assert command.runnable(["dcac", "exact"], "dcac") == ["dcac", "exact"]
    with pytest.raises(UnknownNameError, match="did you mean 'exact'"):
        command.runnable(["exakt"])
    with pytest.raises(SolverError, match="'osqp' cannot run here: no module"):
        command.runnable(["exact", "osqp"])


def test_sigterm_ends_a_study_as_ctrl_c_does(asked, capsys):
    before = signal.getsignal(signal.SIGTERM)
    try:
        assert call(lambda study, config: signal.raise_signal(signal.SIGTERM), asked[0], "--out", "there") == 130
    finally:
        signal.signal(signal.SIGTERM, before)
    assert "there/jobs" in capsys.readouterr().err

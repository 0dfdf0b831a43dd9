"""The command line of the benchmarks: options, what is written and printed, and the exit status."""

import json
import signal
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from benchmarks.common import cli
from moc_opt import figures
from moc_opt.errors import ScenarioError
from moc_opt.report import export
from moc_opt.report.page import Page
from moc_opt.report.tables import Column, Table


def test_options_that_every_benchmark_has():
    given = cli.parser("speed", "about").parse_args(["a.toml", "--out", "b", "--seed", "3", "--quick"])
    assert (given.config, given.out, given.seed, given.quick) == (Path("a.toml"), Path("b"), 3, True)
    none = cli.parser("speed", "about").parse_args([])
    assert (none.config, none.out, none.seed, none.quick) == (None, Path("results/speed"), None, False)


def test_a_command_without_configuration_has_no_options_of_one():
    given = cli.parser("sweep", "about", configured=False).parse_args(["--json"])
    assert (given.out, given.json) == (Path("results/sweep"), True)
    assert not {"seed", "config", "quick", "figures"} & vars(given).keys()


@pytest.mark.parametrize("text", ["-1", "1.5", "many", str(2**62 + 1)])
def test_a_seed_is_a_number_that_a_configuration_takes(text, capsys):
    with pytest.raises(SystemExit):
        cli.parser("speed", "about").parse_args(["--seed", text])
    assert "from 0 to 2^62" in capsys.readouterr().err


def found(given, status=0):
    page = Page("a page")
    page.figure(figures.latency_ecdf({"a": [1.0, 2.0]}), "times", name="times")
    table = Table("Runs", [Column("name", "run"), Column("us", "time")], [{"name": "[first]", "us": 2.0}])
    return cli.Results(
        {"part": {"b": 1, "a": float("nan")}}, {"arguments": given.argv}, [{"name": "first", "us": 2.0}], page,
        [table], ["mean [low, high]"], ["more.txt"], status,
    )  # fmt: skip


def test_results_are_written_and_shown(tmp_path, capsys, monkeypatch):
    asked = []
    monkeypatch.setattr(export, "save_figures", lambda drawn, folder: asked.append((list(drawn), folder)))
    arguments = ["--out", str(tmp_path), "--figures"]
    assert cli.run(cli.parser("speed", "about"), lambda given: found(given, 1), arguments) == 1
    said = capsys.readouterr().out
    files = "summary.json rows.parquet environment.json report.html more.txt"
    for words in ("Runs", "[first]", "mean [low, high]", files):
        assert words in said
    assert json.loads((tmp_path / "summary.json").read_text()) == {"part": {"a": None, "b": 1}}
    assert json.loads((tmp_path / "environment.json").read_text()) == {"arguments": arguments}
    assert pq.read_table(tmp_path / "rows.parquet").to_pylist() == [{"name": "first", "us": 2.0}]
    assert "a page" in (tmp_path / "report.html").read_text()
    assert asked == [(["times"], tmp_path / "figures")]


def test_with_json_the_summary_alone_is_printed(tmp_path, capsys):
    assert cli.run(cli.parser("speed", "about"), found, ["--out", str(tmp_path), "--json"]) == 0
    assert capsys.readouterr().out == (tmp_path / "summary.json").read_text()


def test_no_arguments_are_no_arguments(monkeypatch):
    """Not those of the process that runs the tests."""
    monkeypatch.setattr("sys.argv", ["pytest", "--nonsense"])
    seen = []
    assert cli.run(cli.parser("speed", "about"), lambda given: seen.append(given.argv) or 3, []) == 3
    assert seen == [[]]


@pytest.mark.parametrize(
    ("error", "said"),
    [(ScenarioError("seed = x"), "ScenarioError: seed = x"), (FileNotFoundError(2, "gone", "a"), "FileNotFoundError")],
)
def test_an_error_is_one_line_and_status_2(error, said, tmp_path, capsys):
    def work(given):
        raise error

    assert cli.run(cli.parser("speed", "about"), work, ["--out", str(tmp_path)]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith(said)


def test_a_defect_is_not_hidden():
    with pytest.raises(ZeroDivisionError):
        cli.run(cli.parser("speed", "about"), lambda given: 1 // 0, [])


def test_an_interrupt_says_where_it_goes_on(capsys):
    def work(given):
        raise KeyboardInterrupt

    options = cli.parser("sweep", "about")
    assert cli.run(options, work, ["--out", "there"], "stopped; goes on from {out}") == 130
    assert capsys.readouterr().err == "stopped; goes on from there\n"


def test_sigterm_is_an_interrupt_while_it_works_and_only_then():
    def mine(*_: object) -> None: ...

    def work(given):
        try:
            signal.raise_signal(signal.SIGTERM)
        finally:
            cleaned.append(True)

    cleaned, before = [], signal.signal(signal.SIGTERM, mine)
    try:
        assert cli.run(cli.parser("sweep", "about"), work, []) == 130
        assert cleaned == [True]
        assert signal.getsignal(signal.SIGTERM) is mine
    finally:
        signal.signal(signal.SIGTERM, before)


def test_work_in_another_thread_needs_no_handler():
    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(cli.run, cli.parser("sweep", "about"), lambda given: 7, []).result() == 7

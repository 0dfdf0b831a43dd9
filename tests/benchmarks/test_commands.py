"""The commands of a checkout: those that the documents name exist, and the figures of studies get into the pages."""

from __future__ import annotations

import importlib
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks import docs
from moc_opt.report.tables import Column, Table
from moc_opt.study.command import CONFIGS, environment
from moc_opt.study.show import Report, Section

ROOT = Path(__file__).resolve().parents[2]
PAGES = {
    page.name: page.read_text(encoding="utf-8")
    for page in (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md")))
}


COMMANDS = {
    file.stem for file in (ROOT / "benchmarks").glob("*.py") if re.search("^(def )?main\\b", file.read_text(), re.MULTILINE)
}


def test_the_documents_name_every_command_and_no_other() -> None:
    named = {page: set(re.findall(r"-m benchmarks\.([a-z_]+)|`benchmarks\.([a-z_]+)`", PAGES[page])) for page in PAGES}
    wrong = {page: names for page, found in named.items() if (names := {a or b for a, b in found} - COMMANDS)}
    assert wrong == {}
    assert COMMANDS - {a or b for found in named.values() for a, b in found} == set()


@pytest.mark.parametrize("name", sorted(COMMANDS - {"docs"}))
def test_a_command_says_how_it_is_called(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="0"):
        importlib.import_module(f"benchmarks.{name}").main(["--help"])
    assert f"python -m benchmarks.{name}" in capsys.readouterr().out


def test_a_command_runs_as_a_module() -> None:
    command = [sys.executable, "-m", "benchmarks.export", "--help"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert "python -m benchmarks.export" in done.stdout


def test_every_mark_is_of_a_study_and_has_its_end() -> None:
    studies, count = COMMANDS | {file.stem for file in CONFIGS.glob("*.toml")}, 0
    for page, text in PAGES.items():
        blocks = [(at["name"], at["title"]) for at in docs.BLOCK.finditer(text)]
        ends = re.findall(r"^<!-- /([\w-]+)(?:: (.+))? -->$", text, re.MULTILINE)
        assert ends == [(name, title or "") for name, title in blocks], page
        assert {name for name, _ in blocks} <= studies, page
        count += len(blocks)
    assert count > 3


PAGE = """# Page
<!-- sums -->
old
<!-- /sums -->
kept
<!-- sums: More \\1 -->
<!-- /sums: More \\1 -->
<!-- other -->
old
<!-- /other -->
"""


def test_figures_of_a_study_are_put_into_the_pages(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    table = Table("Sums", [Column("k", "k"), Column("us", "time", unit="us")], [{"k": "a", "us": 2.0}])
    more = Section("More \\1", "Read this.", [table])
    report = Report("A title", ["It holds."], table, sections=[Section("Before"), more, Section("Behind", "No.")])
    results = tmp_path / "results" / "sums"
    results.mkdir(parents=True)
    (results / "report.md").write_text(report.markdown())
    made = {**environment({}, 3, ["--quick"]), "study": "squares"}
    (results / "environment.json").write_text(json.dumps(made))
    (tmp_path / "docs").mkdir()
    (tmp_path / "README.md").write_text("no marks")
    (tmp_path / "docs" / "page.md").write_text(PAGE)
    monkeypatch.setattr(docs, "HOME", tmp_path)
    for changed in ("docs/page.md\n", ""):
        assert docs.main([]) == 0
        assert capsys.readouterr().out == changed
    filled = (tmp_path / "docs" / "page.md").read_text()
    first, rest = filled.split("\nkept\n")
    assert first.startswith("# Page\n<!-- sums -->\n`python -m benchmarks.squares --quick` (seed 3, ")
    assert first.endswith("\n\nIt holds.\n\n| k | time [us] |\n| --- | --- |\n| a | 2 |\n<!-- /sums -->")
    assert rest.endswith(
        "\n\nRead this.\n\n| k | time [us] |\n| --- | --- |\n| a | 2 |\n<!-- /sums: More \\1 -->\n"
        "<!-- other -->\nold\n<!-- /other -->\n"
    )
    (tmp_path / "docs" / "page.md").write_text(PAGE.replace("More", "Less"))
    with pytest.raises(SystemExit, match="has no section 'Less"):
        docs.main([str(tmp_path / "results")])

"""The commands of `benchmarks`."""

import importlib
import json
import re
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
    file.stem for file in (ROOT / "benchmarks").glob("*.py")
    if re.search(r"^(def )?main\b", file.read_text(encoding="utf-8"), re.MULTILINE)
}  # fmt: skip


def test_documents_name_exactly_the_commands() -> None:
    named = {page: set(re.findall(r"-m benchmarks\.([a-z_]+)|`benchmarks\.([a-z_]+)`", PAGES[page])) for page in PAGES}
    wrong = {page: names for page, found in named.items() if (names := {a or b for a, b in found} - COMMANDS)}
    assert wrong == {}
    assert COMMANDS - {a or b for found in named.values() for a, b in found} == set()


@pytest.mark.parametrize("name", sorted(COMMANDS - {"docs"}))
def test_help_shows_how_to_call_a_command(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="0"):
        importlib.import_module(f"benchmarks.{name}").main(["--help"])
    assert f"python -m benchmarks.{name}" in capsys.readouterr().out


FAULT, GROUPS = '[cases.a]\ngroup = "plant"\n', "[groups.tuned]\n[groups.paper]\n[ablation.cases.a]\n"


@pytest.mark.parametrize(("study", "text", "said"), [
    ("faults", "", "cases"), ("faults", FAULT.replace("cases.a", "cases.none"), "run without a fault"),
    ("faults", f"{FAULT}from_s = 2.0\nuntil_s = 1.0", "until_s"), ("faults", f'solvers = ["oskp"]\n{FAULT}', "osqp"),
    ("paper", f'tasks = ["circel"]\n{GROUPS}', "did you mean 'circle'"),
    ("paper", "[groups.other]", "unknown group 'tuned'"),
    ("paper", f'{GROUPS}without = ["rcm_lamda"]', "did you mean 'rcm_lambda'"),
    ("paper", f"{GROUPS}control = {{ K_n2 = 1.0 }}", "did you mean 'K_N2'"),
    ("plant", "[effects.bias]\nencoder_bais_rad = 0.001", "did you mean 'encoder_bias_rad'"),
    ("speed", 'solvers = ["daqp"]', "'exact' must be among them"),
    ("speed", 'solvers = ["exact", "dapq"]', "did you mean 'daqp'"),
    ("speed", 'peers = ["minc"]', "did you mean 'mink'"),
])  # fmt: skip
def test_wrong_configuration_is_refused_before_any_run(study, text, said, tmp_path, capsys):
    (tmp_path / "wrong.toml").write_text(text)
    command = importlib.import_module(f"benchmarks.{study}").main
    assert command([str(tmp_path / "wrong.toml"), "--out", str(tmp_path / "out")]) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_blocks_between_comments_in_pages_are_named_after_studies() -> None:
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


def test_results_are_written_into_the_pages(tmp_path, monkeypatch, capsys):
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
    assert "`python -m benchmarks.squares --quick` (seed 3, " in first
    assert first.endswith("\n\nIt holds.\n\n| k | time [us] |\n| --- | --- |\n| a | 2 |\n<!-- /sums -->")
    assert "\n\nRead this.\n\n| k |" in rest
    assert rest.endswith("\n<!-- /sums: More \\1 -->\n<!-- other -->\nold\n<!-- /other -->\n")
    (tmp_path / "docs" / "page.md").write_text(PAGE.replace("More", "Less"))
    with pytest.raises(SystemExit, match="has no section 'Less"):
        docs.main([str(tmp_path / "results")])

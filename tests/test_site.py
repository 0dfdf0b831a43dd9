"""The documentation site: what it is made of hangs together, without building it. `make docs` builds it."""

import ast
import re
import runpy
from pathlib import Path

import pytest

import moc_opt as mo

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
EXAMPLES = sorted((ROOT / "examples" / "gallery").glob("*.py"))


def test_every_page_is_reached():
    listed = set()
    for page in DOCS.glob("*.md"):
        for tree in re.findall(r"```\{toctree\}\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL):
            listed |= {line.strip() for line in tree.splitlines() if line.strip() and not line.startswith(":")}
    assert {page.stem for page in DOCS.glob("*.md")} - {"index"} == listed - {"gallery/index"}


def test_the_reference_has_every_public_name():
    words = (DOCS / "reference.md").read_text(encoding="utf-8")
    described = set(re.findall(r"^\.\. auto\w+:: moc_opt\.(\w+)", words, re.MULTILINE))
    assert set(mo.__all__) - described == {"solvers"} - described


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_is_short_and_says_what_it_is(example):
    text = example.read_text(encoding="utf-8")
    said = ast.get_docstring(ast.parse(text)) or ""
    title, rule, *_ = said.splitlines()
    assert title
    assert set(rule) == {"="}
    assert len(rule) >= len(title)
    assert len(text.splitlines()) <= 60


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_runs(example, capsys):
    runpy.run_path(str(example), run_name="__main__")
    printed = capsys.readouterr().out
    assert printed.strip()
    assert "nan" not in printed


def test_there_are_examples():
    assert len(EXAMPLES) >= 10

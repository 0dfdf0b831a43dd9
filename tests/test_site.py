"""The documentation site is consistent, and every public name is used in an example."""

import doctest
import importlib
import inspect
import re
import runpy
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import plotly.graph_objects as go
import pytest

import moc_opt as mo
from tests.conftest import opened

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
EXAMPLES = sorted((ROOT / "examples" / "gallery").glob("*.py"))
assert len(EXAMPLES) >= 10


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_example_runs(example, capsys):
    runpy.run_path(str(example), run_name="__main__")
    printed = capsys.readouterr().out
    assert printed.strip()
    assert "nan" not in printed


def test_broken_link_is_found(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(DOCS / "_extensions")
    links = importlib.import_module("links")
    (tmp_path / "reports" / "a").mkdir(parents=True)  # links and anchors of reports are not checked
    (tmp_path / "reports" / "a" / "report.html").write_text('<a href="gone.html">made by scripts</a>', encoding="utf-8")
    sound = ["#here", "b.html", "b.html#there", "https://example.org/x", "data:,x", "reports/a/report.html#made-by-it"]
    wrong = ["#nowhere", "gone.html", "b.html#nowhere", "gone.png"]
    text = '<p id="here"></p>' + "".join(f'<a href="{link}"></a>' for link in (*sound, *wrong))
    (tmp_path / "a.html").write_text(text, encoding="utf-8")
    (tmp_path / "b.html").write_text('<p id="there"></p><img src="a.html">', encoding="utf-8")
    assert links.broken(tmp_path) == [("a.html", link) for link in sorted(wrong)]


def test_figure_of_the_gallery_is_drawn(chromium, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(DOCS / "_extensions")
    site = importlib.import_module("figures")
    for folder in ("_static", "gallery"):
        (tmp_path / folder).mkdir()
    site._write_script(SimpleNamespace(outdir=tmp_path))
    drawn = site.PageRenderer().to_mimebundle(go.Figure(go.Scatter(y=[1.0, 2.0])).to_plotly_json())["text/html"]
    example = tmp_path / "gallery" / "example.html"
    example.write_text(f"<!doctype html><meta charset='utf-8'><body>{drawn}</body>", encoding="utf-8")
    with opened(chromium, example.as_uri(), ".main-svg", tmp_path.as_uri()) as page:
        assert page.locator(".main-svg .scatterlayer path.js-line").count() == 1


DIRECTIVE = re.compile(r"^\.\. auto(function|class|exception):: ([\w.]+)$\n((?:   :.*\n)*)", re.MULTILINE)
PAGES = "".join(
    path.read_text("utf-8")
    for path in (ROOT / "README.md", *(ROOT / "docs").glob("*.md"), *(ROOT / "examples").rglob("*.py"))
    if path.name != "reference.md"
)
ENTRIES = {
    name: (kind, options) for kind, name, options in DIRECTIVE.findall((ROOT / "docs/reference.md").read_text("utf-8"))
}


def found(name):
    module, _, attribute = name.rpartition(".")
    return getattr(__import__(module, fromlist=[attribute]), attribute)


def methods(name):
    """Return the methods that the reference lists for this class."""
    kind, options = ENTRIES[name]
    if kind != "class" or ":members:" not in options or ":undoc-members:" in options:
        return {}
    listed = re.search(r":members: (.+)", options)
    return {
        member: of for member, of in vars(found(name)).items()
        if not member.startswith("_") and (isinstance(of, classmethod) or inspect.isfunction(of))
        and (listed is None or member in listed[1].split(", "))
    }  # fmt: skip


def test_every_public_name_is_in_the_reference():
    assert set(mo.__all__) <= set(dir(mo))
    public = {name: getattr(mo, name) for name in mo.__all__ if name != "solvers"}
    public |= {name: getattr(mo.solvers, name) for name in mo.solvers.__all__}
    described = [found(entry) for entry in ENTRIES]
    assert [name for name, one in public.items() if one not in described] == []


@pytest.mark.parametrize("name", ENTRIES)
def test_public_name_is_used_in_an_example(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    runner, said, shown = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS), [], PAGES
    for title, one in {name: found(name), **methods(name)}.items():
        text = inspect.getdoc(one) or ""
        case = doctest.DocTestParser().get_doctest(text, {"mo": mo, "np": np}, title, None, 0)
        shown += "".join(example.source for example in case.examples)
        runner.run(case, out=said.append)
    assert runner.summarize(verbose=False).failed == 0, "".join(said)
    assert len(shown) > len(PAGES) or name.rpartition(".")[2] in PAGES
    assert {member for member in methods(name) if not re.search(rf"(\.|\bdef ){member}\(", shown)} == set()

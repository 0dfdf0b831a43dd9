"""The documentation site: what it is made of hangs together, without building it. `make docs` builds it."""

import importlib
import re
import runpy
from pathlib import Path
from types import SimpleNamespace

import plotly.graph_objects as go
import pytest

from tests.conftest import opened

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
EXAMPLES = sorted((ROOT / "examples" / "gallery").glob("*.py"))


def test_every_page_is_reached_and_there_are_examples():
    listed = set()
    for page in DOCS.glob("*.md"):
        for tree in re.findall(r"```\{toctree\}\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL):
            listed |= {line.strip() for line in tree.splitlines() if line.strip() and not line.startswith(":")}
    assert len(EXAMPLES) >= 10
    assert {page.stem for page in DOCS.glob("*.md")} - {"index"} == listed - {"gallery/index"}


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_runs(example, capsys):
    runpy.run_path(str(example), run_name="__main__")
    printed = capsys.readouterr().out
    assert printed.strip()
    assert "nan" not in printed


def test_a_link_that_leads_nowhere_is_found(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(DOCS / "_extensions")
    links = importlib.import_module("links")
    (tmp_path / "reports" / "a").mkdir(parents=True)
    (tmp_path / "reports" / "a" / "report.html").write_text('<a href="gone.html">made by scripts</a>', encoding="utf-8")
    sound = ["#here", "b.html", "b.html#there", "https://example.org/x", "data:,x", "reports/a/report.html#made-by-it"]
    wrong = ["#nowhere", "gone.html", "b.html#nowhere", "gone.png"]
    text = '<p id="here"></p>' + "".join(f'<a href="{link}"></a>' for link in (*sound, *wrong))
    (tmp_path / "a.html").write_text(text, encoding="utf-8")
    (tmp_path / "b.html").write_text('<p id="there"></p><img src="a.html">', encoding="utf-8")
    assert links.broken(tmp_path) == [("a.html", link) for link in sorted(wrong)]


def test_a_figure_of_the_gallery_is_drawn(chromium, tmp_path, monkeypatch):
    """As the theme lays a page out, which puts its own scripts behind the examples' figures."""
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

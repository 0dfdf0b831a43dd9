"""The index links every report of a folder of results, with what each says first, and is written nowhere else."""

from __future__ import annotations

import json
import re
from pathlib import Path

from benchmarks.common import index
from moc_opt.report.page import Page


def report(folder: Path, title: str, said: str = "") -> None:
    page = Page(title)
    if said:
        page.headline(said)
    page.save(folder / "report.html")


def test_every_report_is_linked_with_what_it_says_first(tmp_path):
    results = tmp_path / "results"
    report(results / "solvers", "Solvers <b>", "Take `exact` & avoid \"x\".")
    report(results / "paper", "The paper")
    report(results / "another", "Another")
    (results / "solvers" / "environment.json").write_text(json.dumps({"when": "2026-11-22T05:20:11", "seed": 3}))
    (results / "paper" / "environment.json").write_text("no JSON")
    (results / "empty").mkdir()
    path = index.write_index(results)
    assert path == results / "index.html"
    text = path.read_text()
    links = re.findall(r'href="([^"]+report.html)"', text)
    assert links == ["solvers/report.html", "paper/report.html", "another/report.html"]
    assert all((results / link).exists() for link in links)
    assert "Take <code>exact</code> &amp; avoid &#34;x&#34;." in text
    assert "Solvers &lt;b&gt;" in text
    assert "2026-11-22 05:20" in text
    assert "seed 3" in text


def test_it_follows_the_reports(tmp_path):
    results = tmp_path / "results"
    for name in ("one", "two"):
        report(results / name, f"Report {name}")
        index.write_index(results)
        assert f"Report {name}" in (results / "index.html").read_text()


def test_no_other_folder_gets_one(tmp_path):
    report(tmp_path / "mine" / "solvers", "Solvers")
    assert index.write_index(tmp_path / "mine") is None
    assert not (tmp_path / "mine" / "index.html").exists()

"""What is said when figures cannot be saved; that they can is tested in a browser."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from moc_opt import figures
from moc_opt.errors import BrowserError, BrowserMissingError, MocOptError, ReportError, UnknownNameError
from moc_opt.report.export import browser_path, save_figures

FIGURES = {"one": figures.box_plots({"a": {"t": [1.0]}}, "y")}


def test_playwright_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "playwright.sync_api", None)
    with pytest.raises(BrowserError, match=r"pip install 'moc-opt\[figures\]'") as caught:
        save_figures(FIGURES, tmp_path)
    assert isinstance(caught.value, MocOptError)
    assert list(tmp_path.iterdir()) == []


def test_no_browser(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("playwright", reason="playwright is not installed")
    monkeypatch.delenv("MOC_OPT_BROWSER", raising=False)
    monkeypatch.setenv("PATH", "")
    monkeypatch.setenv("PLAYWRIGHT_BROWSERS_PATH", str(tmp_path / "none"))
    with pytest.raises(BrowserMissingError, match="apt-get install chromium"):
        save_figures(FIGURES, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_the_browser_that_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MOC_OPT_BROWSER", str(tmp_path / "none"))
    with pytest.raises(BrowserError, match="MOC_OPT_BROWSER"):
        browser_path()
    monkeypatch.setenv("MOC_OPT_BROWSER", sys.executable)
    assert browser_path() == sys.executable


def test_a_program_that_is_no_browser(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("playwright", reason="playwright is not installed")
    fake = tmp_path / "browser"
    fake.write_text("#!/bin/sh\nexit 3\n")
    fake.chmod(0o755)
    monkeypatch.setenv("MOC_OPT_BROWSER", str(fake))
    with pytest.raises(BrowserError, match="the browser failed") as caught:
        save_figures(FIGURES, tmp_path / "out")
    assert not isinstance(caught.value, BrowserMissingError)


def test_format_and_name_are_checked_first(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match="pdf, svg"):
        save_figures(FIGURES, tmp_path, ["png"])
    with pytest.raises(ReportError, match="without a folder"):
        save_figures({"../one": FIGURES["one"]}, tmp_path)

"""Save figures as SVG and PDF, with a headless browser."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Literal
from urllib.parse import unquote

import plotly.graph_objects as go
from plotly.offline import get_plotlyjs

from moc_opt.errors import BrowserError, BrowserMissingError, ReportError
from moc_opt.inputs.files import write_whole

if TYPE_CHECKING:
    from playwright.sync_api import Browser
    from playwright.sync_api import Page as BrowserPage

WIDTH_PX = 680
"""Default width of a figure [px], printed as 180 mm."""
NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "microsoft-edge")
CURE = (
    "install a browser (Debian, Ubuntu: apt-get install chromium; anywhere: python -m playwright install chromium), "
    "or set the environment variable MOC_OPT_BROWSER to a browser's name or path"
)
SHEET = "<!DOCTYPE html><style>@page{margin:0} body{margin:0} svg{display:block}</style><body></body>"


def save_figures(
    figures: Mapping[str, go.Figure], directory: str | os.PathLike[str],
    formats: Sequence[Literal["svg", "pdf"]] = ("svg", "pdf"),
) -> list[Path]:  # fmt: skip
    """Write each figure as DIRECTORY/NAME.FORMAT; return the files.

    Raise the errors of `browser`, or a ReportError if a file cannot be written.
    """
    for name in figures:
        if name != Path(name).name:
            raise ReportError(f"figure {name!r}: give a name without a folder")
    with browser() as chromium:
        page = chromium.new_page()
        page.route("**/*", lambda route: route.abort())  # no network access
        page.set_content(SHEET)
        page.add_script_tag(content=get_plotlyjs())
        drawn = {name: _drawn(page, figure) for name, figure in figures.items()}
    return [
        write_whole(Path(directory) / f"{name}.{kind}", contents[kind], "figure", ReportError)
        for name, contents in drawn.items() for kind in formats
    ]  # fmt: skip


@contextmanager
def browser() -> Iterator[Browser]:
    """Run a headless Chromium during the ``with`` block.

    Raise a BrowserMissingError if playwright or a browser is missing, and a BrowserError if the browser fails.
    """
    try:
        from playwright.sync_api import Error, sync_playwright
    except ImportError as error:
        raise BrowserMissingError(f"no playwright: pip install '.[figures]' in the clone, and {CURE}") from error
    chosen = os.environ.get("MOC_OPT_BROWSER")
    program = shutil.which(chosen) if chosen else next(filter(None, map(shutil.which, NAMES)), None)
    if chosen and program is None:
        raise BrowserError(f"MOC_OPT_BROWSER = {chosen!r} is no program: {CURE}")
    try:
        with sync_playwright() as playwright:
            program = program or playwright.chromium.executable_path
            if not Path(program).exists():
                raise BrowserMissingError(f"no Chromium or Chrome was found: {CURE}")
            chromium = playwright.chromium.launch(executable_path=program, args=["--no-sandbox", "--disable-gpu"])
            try:
                yield chromium
            finally:
                chromium.close()
    except Error as error:
        raise BrowserError(f"the browser failed: {str(error).splitlines()[0]}; {CURE}") from error


def _drawn(page: BrowserPage, figure: go.Figure) -> dict[str, bytes]:
    width = figure.layout.width or WIDTH_PX
    height = figure.layout.height or figure.layout.template.layout.height or 450
    url = page.evaluate(
        "([figure, size]) => Plotly.toImage(JSON.parse(figure), {format: 'svg', ...size})",
        [figure.to_json(), {"width": width, "height": height}],
    )
    svg = unquote(url.partition(",")[2])
    page.evaluate("svg => { document.body.innerHTML = svg }", svg)
    pdf = page.pdf(width=f"{width}px", height=f"{height}px", print_background=True, page_ranges="1")
    return {"svg": svg.encode(), "pdf": pdf}

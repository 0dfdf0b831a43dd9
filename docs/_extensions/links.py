"""Check every local link of the built site: a link to a missing page, picture or anchor is a warning."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path
from urllib.parse import unquote

from sphinx.application import Sphinx
from sphinx.util import logging

LINK = re.compile(r'(?:href|src)="([^"]+)"')
ELSEWHERE = re.compile(r"[a-z]+:|//")
REPORTS = "reports"  # not checked: standalone pages whose scripts make their anchors
SOURCES = "_modules"  # not checked: viewcode's links back to the documentation may have missing anchors


def broken(site: Path) -> list[tuple[str, str]]:
    """Return (page, link) for each broken local link in the pages below a folder."""
    found = []
    for page in sorted(site.rglob("*.html")):
        if page.relative_to(site).parts[0] in (REPORTS, SOURCES):
            continue
        for link in sorted(set(LINK.findall(page.read_text(encoding="utf-8")))):
            if not ELSEWHERE.match(link) and not _leads(page, unquote(link), site):
                found.append((page.relative_to(site).as_posix(), link))
    return found


def _leads(page: Path, link: str, site: Path) -> bool:
    path, _, place = link.partition("#")
    target = (page.parent / path.partition("?")[0]).resolve() if path else page
    target = target / "index.html" if target.is_dir() else target
    known = not place or target.suffix != ".html" or REPORTS in target.relative_to(site.resolve()).parts[:1]
    return target.is_file() and (known or place in _places(target))


@cache
def _places(page: Path) -> frozenset[str]:
    return frozenset(re.findall(r'\b(?:id|name)="([^"]+)"', page.read_text(encoding="utf-8")))


def _check(app: Sphinx, error: Exception | None) -> None:
    if error is None and app.builder.name == "html":
        _places.cache_clear()
        for page, link in broken(Path(app.outdir)):
            logging.getLogger(__name__).warning("%s: the link %s leads nowhere", page, link)


def setup(app: Sphinx) -> dict[str, bool]:
    """Check the links when the site is built, after the reports were copied into it."""
    app.connect("build-finished", _check, priority=900)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

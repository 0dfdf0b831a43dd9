"""Show plotly figures of the gallery, with one copy of plotly's script in the site: no other host is asked."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import plotly.io
from plotly.offline import get_plotlyjs
from sphinx.application import Sphinx

SCRIPT = "plotly.min.js"


class PageRenderer(plotly.io.base_renderers.MimetypeRenderer):  # type: ignore[misc]
    """Draws a figure as a `div` of a page that has plotly's script already."""

    def to_mimebundle(self, fig_dict: dict[str, Any]) -> dict[str, str]:
        """Return the figure as HTML."""
        options = {"responsive": True, "displaylogo": False}
        return {"text/html": plotly.io.to_html(fig_dict, include_plotlyjs=False, full_html=False, config=options)}


def _write_script(app: Sphinx) -> None:
    folder = Path(app.outdir) / "_static"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / SCRIPT).write_text(get_plotlyjs(), encoding="utf-8")


def _only_in_the_gallery(app: Sphinx, page: str, template: str, context: Any, tree: Any) -> None:
    if page.startswith("gallery/"):
        app.add_js_file(SCRIPT, priority=100)


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the renderer for the examples that the gallery runs, and the script for its pages."""
    plotly.io.renderers["page"] = PageRenderer()
    plotly.io.renderers.default = "page"
    app.connect("builder-inited", _write_script)
    app.connect("html-page-context", _only_in_the_gallery)
    return {"parallel_read_safe": False, "parallel_write_safe": True}

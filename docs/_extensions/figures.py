"""Show plotly figures of the gallery. The site has its own copy of plotly's script: nothing is loaded from a CDN."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import plotly.io
from plotly.offline import get_plotlyjs
from sphinx.application import Sphinx

SCRIPT = "plotly.min.js"


class PageRenderer(plotly.io.base_renderers.MimetypeRenderer):  # type: ignore[misc]
    """Draws a figure as plotly's script and a `div` in a page of `gallery/`. A theme would load the script too late."""

    def to_mimebundle(self, fig_dict: dict[str, Any]) -> dict[str, str]:
        """Return the figure as HTML."""
        options = {"responsive": True, "displaylogo": False}
        height = f"{fig_dict['layout'].get('height', 460)}px"
        drawn = plotly.io.to_html(
            fig_dict, include_plotlyjs=f"../_static/{SCRIPT}", full_html=False, config=options, default_height=height
        )
        return {"text/html": drawn}


def _write_script(app: Sphinx) -> None:
    folder = Path(app.outdir) / "_static"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / SCRIPT).write_text(get_plotlyjs(), encoding="utf-8")


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the renderer for the examples that the gallery runs, and put the script into the site."""
    plotly.io.renderers["page"] = PageRenderer()
    plotly.io.renderers.default = "page"
    app.connect("builder-inited", _write_script)
    return {"parallel_read_safe": False, "parallel_write_safe": True}

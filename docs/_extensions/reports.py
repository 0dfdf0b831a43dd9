"""Publish the reports of the benchmarks that were run in this checkout: ``{published-reports}`` lists them."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

from docutils import nodes
from docutils.parsers.rst import Directive
from sphinx.application import Sphinx

RESULTS = Path(__file__).resolve().parents[2] / "results"
PAGE = "report.html"


def found() -> list[Path]:
    """Return the folders of results that have a report, sorted by name."""
    return sorted(path.parent for path in RESULTS.glob(f"*/{PAGE}"))


class PublishedReports(Directive):
    """List the reports, each with the commit, seed and processor of its run."""

    def run(self) -> list[nodes.Node]:
        """Return the list, or a sentence that says how to make a report."""
        if not found():
            said = nodes.paragraph("", "There are none: ")
            command = "python -m benchmarks.solvers"
            said += [nodes.literal(command, command), nodes.Text(" makes one.")]
            return [said]
        listed = nodes.bullet_list()
        for folder in found():
            entry = nodes.paragraph()
            entry += nodes.reference("", folder.name, refuri=f"reports/{folder.name}/{PAGE}")
            entry += nodes.Text(_origin(folder))
            listed += nodes.list_item("", entry)
        return [listed]


def _origin(folder: Path) -> str:
    path = folder / "environment.json"
    if not path.is_file():
        return ""
    environment = json.loads(path.read_text(encoding="utf-8"))
    known = [f"{key} {environment[key]}" for key in ("commit", "seed", "cpu") if environment.get(key) is not None]
    return f" ({', '.join(known)})" if known else ""


def _copy(app: Sphinx, error: Exception | None) -> None:
    if error is None:
        for folder in found():
            target = Path(app.outdir) / "reports" / folder.name
            target.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(folder / PAGE, target / PAGE)


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directive, and copy the pages when the site is built."""
    app.add_directive("published-reports", PublishedReports)
    app.connect("build-finished", _copy)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

"""docs/reliability.md: what is promised, how each promise is tested, and the figures that a run of this benchmark gave.

The page is made from benchmarks/templates/reliability.md and docs/reliability.json alone.
`python -m benchmarks.faults --page` and `python -m benchmarks.fuzz --page` write both, each its own figures.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.common import markdown, output
from benchmarks.reliability.report import CASES, GOALS, SEEN, by_group, headline
from moc_opt.errors import ScenarioError
from moc_opt.report.tables import Column

PAGE = Path(__file__).resolve().parents[2] / "docs" / "reliability.md"

COUNTS = [
    Column("kind", "input"),
    *(Column(name, name, format=".0f") for name in ("cases", "accepted", "refused", "failed")),
]
TITLES = {
    "none": "no fault", "solver": "solver", "sensors": "sensors and packets", "plant": "plant and delay",
    "contact": "bumps and trocar", "camera": "camera",
}  # fmt: skip


def page(found: Mapping[str, Any]) -> str:
    """Make the page from the figures of a run (``cases``, ``goals``, ``environment``) and of the fuzzer (``fuzz``)."""
    cases, where = found["cases"], found["environment"]
    groups, sent = by_group(cases), found.get("fuzz")
    return markdown.render(
        "reliability.md", **where, headline=headline(cases, found["goals"]), fuzz=sent,
        goals=markdown.of_columns(GOALS, found["goals"]), seen=markdown.of_columns(SEEN, groups.get("solver", [])),
        sent=sent and markdown.of_columns(COUNTS, [{"kind": k, **sent["kinds"][k]} for k in sorted(sent["kinds"])]),
        groups=[(title, markdown.of_columns(CASES, groups[name])) for name, title in TITLES.items() if name in groups],
    )  # fmt: skip


def write_page(found: Mapping[str, Any], path: Path = PAGE) -> None:
    """Write the page, and beside it the figures that it was made from; those of another command stay as they are.

    Raises:
        ScenarioError: the figures of the faults are not there yet.
    """
    figures = path.with_suffix(".json")
    old = json.loads(figures.read_text(encoding="utf-8")) if figures.exists() else {}
    if "cases" not in {**old, **found}:
        raise ScenarioError(f"{figures}: no figures yet; run python -m benchmarks.faults --page first")
    output.write_json(figures, {**old, **found})
    # of the file, not of what it was written from: whoever reads it must come to the same page
    output.write_atomically(path, page(json.loads(figures.read_text(encoding="utf-8"))).encode())

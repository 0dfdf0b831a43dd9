"""results/index.html: links every report of a folder, made anew whenever a benchmark writes its report."""

from __future__ import annotations

import json
import re
from html import unescape
from pathlib import Path
from typing import Any

from moc_opt.report.document import beside, save_document
from moc_opt.report.document import render as rendered

NAME, FOLDER = "index.html", "results"
FIRST = ("solvers", "paper", "robots", "plan", "speed", "realtime", "faults")
"""Reports that come before all others, in this order."""
HEAD_CHARACTERS = 20_000
"""Of a report, in which its title and what it says first are found; what follows are figures."""


def write_index(folder: Path) -> Path | None:
    """Write the index of a folder of results; only of one that is called ``results``, or that has an index already.

    Args:
        folder: that holds a folder with a report.html for each benchmark.

    Returns:
        the page; None where the folder is none of ours.
    """
    path = folder / NAME
    if folder.resolve().name != FOLDER and not path.exists():
        return None
    return save_document(path, rendered("index.html", reports=reports(folder)), "index", lambda: "remove old reports")


def reports(folder: Path) -> list[dict[str, Any]]:
    """Return one row for each report below a folder: where it is, its title, what it says first, when it was made."""
    found = []
    for page in sorted(folder.glob("*/report.html"), key=_place):
        with page.open(encoding="utf-8", errors="replace") as file:
            head = file.read(HEAD_CHARACTERS)
        environment = _read(page.with_name("environment.json"))
        machine = environment.get("machine", {})
        found.append({
            "href": beside(f"{page.parent.name}/{page.name}"), "name": page.parent.name,
            "title": _of(r"<title>(.*?)</title>", head) or page.parent.name,
            "about": _of(r'<meta name="description" content="(.*?)">', head),
            "when": str(environment.get("when", ""))[:16].replace("T", " "),
            "commit": str(environment.get("commit") or "")[:10],
            "load": machine.get("load_1min"), "seed": environment.get("seed"),
        })  # fmt: skip
    return found


def _place(page: Path) -> tuple[int, str]:
    name = page.parent.name
    return FIRST.index(name) if name in FIRST else len(FIRST), name


def _of(pattern: str, head: str) -> str:
    match = re.search(pattern, head, re.DOTALL)
    return unescape(match[1]) if match else ""


def _read(path: Path) -> dict[str, Any]:
    """Return what lies beside a report; nothing where that is absent or no JSON: the index links the report anyway."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}

"""Put the results of finished studies into README.md and docs: python -m benchmarks.docs [RESULTS]

The text between ``<!-- NAME -->`` and ``<!-- /NAME -->`` becomes the part of RESULTS/NAME/report.md between its title
and its first section. The text between ``<!-- NAME: TITLE -->`` and its closing comment becomes section TITLE.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Sequence
from pathlib import Path

from moc_opt.inputs.files import write_whole

HOME = Path(__file__).parents[1]
BLOCK = re.compile(
    r"(?P<begin><!-- (?P<name>[\w-]+)(?:: (?P<title>[^>]+))? -->\n).*?"
    r"(?P<end><!-- /(?P=name)(?:: [^>]+)? -->)", re.DOTALL,
)


def block(folder: Path, title: str | None) -> str | None:
    """Return how a report was measured, and its section ``title`` (None: the part before the first section)."""
    if not (folder / "report.md").exists():
        return None
    parts = re.split(r"^## (.+)\n", (folder / "report.md").read_text(encoding="utf-8"), flags=re.MULTILINE)
    sections = dict(zip(parts[1::2], parts[2::2], strict=True))
    if title is not None and title not in sections:
        raise SystemExit(f"{folder}/report.md has no section {title!r}: it has {', '.join(sections)}")
    text = parts[0].split("\n", 1)[1] if title is None else sections[title]
    made = json.loads((folder / "environment.json").read_text(encoding="utf-8"))
    machine = made["machine"]
    command = " ".join(["python -m benchmarks." + made["study"], *made["arguments"]])
    return (
        f"Measured with `{command}` (seed {made['seed']}, {machine['cores']} cores, {machine['processor']}, load "
        f"{machine['load_1min']:.1f}, Python {machine['python']}):\n\n{text.strip()}\n"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    given = sys.argv[1:] if arguments is None else arguments
    results = Path(given[0]) if given else HOME / "results"
    for page in [HOME / "README.md", *sorted((HOME / "docs").glob("*.md"))]:
        before = page.read_text(encoding="utf-8")

        def fill(at: re.Match[str]) -> str:
            text = block(results / at["name"], at["title"])
            return at[0] if text is None else f"{at['begin']}{text}{at['end']}"

        after = BLOCK.sub(fill, before)
        if after != before:
            write_whole(page, after)
            print(page.relative_to(HOME))
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""What ``python -m benchmarks.realtime --page`` writes into docs/realtime.md, between the marks of its section."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.common import markdown
from benchmarks.latency.clock import PERCENTILES, TIMES, case_name, sentences

PAGE = Path(__file__).resolve().parents[2] / "docs" / "realtime.md"
SECTION = "realtime"


def page_text(summary: Mapping[str, Any], environment: Mapping[str, Any]) -> str:
    """Return every case's misses, stalls, times and errors as one table, and the sentences of the first screen."""
    machine, config = environment["machine"], environment["config"]
    said = (
        f"`python -m benchmarks.realtime --cycles {config['cycles']} --page` ({machine['cores']} cores, "
        f"{machine['processor']}, seed {environment['seed']}). Times in us: median / 99th / 99.99th percentile / worst."
    )
    heads = ["case", "cycles", "missed", "in 100,000", "plant stalled", *TIMES.values(), "stops"]
    rows = [
        [
            case_name(case), f"{found['cycles']:,}", f"{found['missed']}", _in_100000(found), f"{found['overruns']}",
            *(" / ".join(f"{found[f'{time}_{name}_us']:,.0f}" for name in PERCENTILES) for time in TIMES),
            f"{found['stopped']}", f"{found['rcm_max_mm']:.2f}",
        ] for case, found in summary["cases"].items()
    ]  # fmt: skip
    heads.append("RCM error, worst [mm]")
    return "\n\n".join([said, markdown.table(heads, rows), " ".join(sentences(summary))])


def _in_100000(found: Mapping[str, Any]) -> str:
    low, value, high = (1e5 * found[f"missed_share{end}"] for end in ("_low", "", "_high"))
    return f"{value:.2g} [{low:.2g}, {high:.2g}]"

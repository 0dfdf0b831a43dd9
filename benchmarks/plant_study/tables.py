"""The tables of ``python -m benchmarks.plant``: means with intervals, on the screen and in docs/plant.md."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.common import markdown
from benchmarks.paper_experiment.trials import MATCHED
from benchmarks.plant_study.runs import FIGURES, Config
from moc_opt.comparison.statistics import mean
from moc_opt.report.tables import Column, Table
from moc_opt.trace.ending import Ending

PAGE = Path(__file__).resolve().parents[2] / "docs" / "plant.md"


def summarise(config: Config, rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Map preset to "effect, controller" -> runs, those that broke off, and each figure with its interval."""
    summary: dict[str, Any] = {}
    for preset in config.presets:
        summary[preset] = {}
        for effect in config.effects:
            for controller in (MATCHED, config.solver):
                mine = [r for r in rows if (r["preset"], r["effect"], r["controller"]) == (preset, effect, controller)]
                group: dict[str, Any] = {
                    "runs": len(mine), "broke_off": sum(not Ending.of(r["ended"]).whole for r in mine),
                }  # fmt: skip
                for name in FIGURES:
                    values = [r[name] for r in mine if name in r]
                    if values:
                        group |= mean(values).entries(name)
                summary[preset][f"{effect}, {controller}"] = group
    return summary


def tables(summary: dict[str, Any]) -> list[Table]:
    """Make one table a preset, means over the runs that were completed."""
    first = [Column("group", "effect, controller"), Column("broke_off", "broke off", format="d")]
    return [
        Table(f"Preset {preset}", [*first, *FIGURES.values()], [{"group": name, **row} for name, row in groups.items()])
        for preset, groups in summary.items()
    ]


def page_text(summary: dict[str, Any], config: Config) -> str:
    """Return the tables with their intervals, for docs/plant.md."""
    trials_run = config.trials * len(config.tasks)
    lines = [f"`python -m benchmarks.plant --page` (seed {config.seed}, {trials_run} trials; mean, 95 % interval):"]
    heads = ["effect", "law", *(f"{column.title} [{column.unit}]" for column in FIGURES.values()), "broke off"]
    for preset, groups in summary.items():
        rows = [
            [*name.rsplit(", ", 1), *(_cell(row, key) for key in FIGURES), f"{row['broke_off']}/{row['runs']}"]
            for name, row in groups.items()
        ]
        lines += ["", f"Preset `{preset}`:", "", markdown.table(heads, rows)]
    return "\n".join(lines)


def _cell(row: dict[str, Any], name: str) -> str:
    if name not in row:
        return ""
    spec = FIGURES[name].format
    low, high = row[f"{name}_low"], row[f"{name}_high"]
    if low is None or not math.isfinite(low) or name == "torque_rate_rms_Nm_per_s":
        return f"{row[name]:{spec}}"  # of a single trial there is no interval
    return f"{row[name]:{spec}} [{low:{spec}}, {high:{spec}}]"

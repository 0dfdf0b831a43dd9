"""What the plant's runs show: each defect's cost, and from which calibration error on a moving elbow costs accuracy."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import plotly.graph_objects as go

from benchmarks.common import markdown
from benchmarks.common.answer import Answer, Picture
from benchmarks.paper_experiment.trials import MATCHED
from benchmarks.paper_experiment.verdict import ABOUT_FRAMES
from benchmarks.plant_study.runs import ERRORS, KINDS
from moc_opt.figures.style import SERIES, figure, label, rule
from moc_opt.report.page import Page
from moc_opt.report.tables import Column, Table
from moc_opt.study.statistics import mean, relative_changes, spread, too_few
from moc_opt.trace.meta import Ending

Rows = Sequence[Mapping[str, Any]]

ALL = "All figures of the sweep"
FRAMES = {"_error_model": "own", "_error_registered": "registered", "_error": "base"}
ENDS = FRAMES | {"_after": "after travel", "_again": "registered again"}
PARTS = {"tip": "tip", "rcm": "RCM"}
COLUMNS = {f"{part}{end}": f"{word}, {of}" for part, word in PARTS.items() for end, of in ENDS.items()}
FIGURES = [
    Column("mu_gain_percent", "mu", unit="%", format="+.1f", help="above DCAC on the same trials"),
    *(Column(f"{name}_mean_mm", COLUMNS[name], unit="mm", format=".3f") for name in ERRORS),
    Column("trocar_force_mean_N", "force", unit="N", format=".3f"),
    Column("torque_rate_rms_Nm_per_s", "chatter", unit="Nm/s", format=".0f"),
]
DEFAULT_SIZE = 0.2
"""Origins of the default plant [mm]."""
MOST_CHANGE_PERCENT, MOST_MM = 5.0, 0.1
"""The break-even: MOC's registered tip error exceeds DCAC's by more than this, by the interval's lower end; or this."""
EVENS = {
    "relative": f"over {MOST_CHANGE_PERCENT:g} % above DCAC from", "absolute": f"over {MOST_MM:g} mm from",
    "absolute_dcac": f"DCAC over {MOST_MM:g} mm from",
}  # fmt: skip
DEFINED = (
    f"Break-even, in the frame registered at the start: the calibration error from which MOC's mean tip error is more "
    f"than {MOST_CHANGE_PERCENT:g} % above DCAC's with the same gains, by the lower ends of the 95 % intervals of both "
    f"means; and that from which it is above {MOST_MM:g} mm; interpolated between the sizes of the sweep."
)
TRAVEL = (
    "After travel: over the ticks from the elbow's arrival on, in the frame registered at the start; registered again: "
    "over the same ticks, in the frame that is touched anew at the first of them."
)


# Each defect alone and together.


def effects_summary(rows: Rows) -> dict[str, Any]:
    """Map preset to "effect, controller" -> runs, those that broke off, and each figure with its interval."""
    groups: dict[str, dict[str, list[Mapping[str, Any]]]] = {}
    for row in rows:
        groups.setdefault(row["preset"], {}).setdefault(f"{row['effect']}, {row['controller']}", []).append(row)
    return {preset: {name: _means(mine) for name, mine in at.items()} for preset, at in groups.items()}


def _means(rows: Rows) -> dict[str, Any]:
    found: dict[str, Any] = {
        "runs": len(rows), "broke_off": sum(not Ending.of(row["ended"]).whole for row in rows),
    }  # fmt: skip
    for column in FIGURES:
        if values := [row[column.key] for row in rows if column.key in row]:
            found |= mean(values).entries(column.key)
    return found


def effects_tables(summary: Mapping[str, Any], written: Callable[..., object] = dict.get) -> list[Table]:
    """Make one table a preset, means over the runs that were completed; ``written`` takes a figure from its row."""
    columns = [Column("group", "effect, controller"), Column("broke_off", "broke off", format="d"), *FIGURES]
    return [
        Table(f"Preset {preset}", columns, [
            {"group": name, "broke_off": row["broke_off"], **{c.key: written(row, c.key) for c in FIGURES}}
            for name, row in groups.items()
        ])
        for preset, groups in summary.items()
    ]  # fmt: skip


def effects_markdown(summary: Mapping[str, Any], seed: int) -> str:
    """Return the tables with their intervals, for docs/plant.md."""
    runs = max((row["runs"] for groups in summary.values() for row in groups.values()), default=0)
    lines = [f"`python -m benchmarks.plant --page` (seed {seed}, {runs} trials; mean, 95 % interval):"]
    for table in effects_tables(summary, spread):
        lines += ["", f"{table.title}:", "", markdown.of_columns(table.columns, table.rows)]
    return "\n".join(lines)


# Sizes of the calibration error.


def sweep_summary(rows: Rows, solver: str) -> list[dict[str, Any]]:
    """Make one row a preset, kind and size: means under both, changes, and after the travel; size 0 in every kind."""
    found = []
    for preset in dict.fromkeys(row["preset"] for row in rows):
        for kind in KINDS:
            here = [row for row in rows if row["preset"] == preset and (row["kind"] == kind or row["size"] == 0.0)]
            for size in sorted({row["size"] for row in here}):
                mine = [row for row in here if row["size"] == size]
                found.append({"preset": preset, "kind": kind, "size": size, **_pairs(mine, solver)})
    return found


def _pairs(rows: Rows, solver: str) -> dict[str, Any]:
    """Compare MOC with DCAC over the trials that both have."""
    by = {(row["controller"], row["seed"]): row for row in rows}
    drawn = dict.fromkeys(row["seed"] for row in rows)
    found: dict[str, Any] = {"runs": len(drawn)}
    keys = {"mu": "mu_mean"} | {key: f"{key}_mean_mm" if key in ERRORS else key for key in COLUMNS}
    for name, key in keys.items():
        pairs = [
            (by[solver, seed][key], by[MATCHED, seed][key])
            for seed in drawn
            if all(key in by.get((one, seed), {}) for one in (solver, MATCHED))
        ]
        if pairs:
            moc, dcac = zip(*pairs, strict=True)
            change = relative_changes(moc, dcac)
            found |= mean(moc).entries(f"moc_{name}") | mean(dcac).entries(f"dcac_{name}")
            found |= change.entries(f"change_{name}") | {f"{name}_trials": len(pairs)}
    return found


def break_evens(summary: Rows) -> list[dict[str, Any]]:
    """Return for every preset and kind the sizes from which MOC's registered tip error is beyond each limit.

    ``relative``: the lower end of the change's interval is `MOST_CHANGE_PERCENT`; ``absolute``: the mean is `MOST_MM`;
    None where no size of these is.
    """
    name, found = "tip_error_registered", []
    for preset, kind in dict.fromkeys((row["preset"], row["kind"]) for row in summary):
        mine = [row for row in summary if (row["preset"], row["kind"]) == (preset, kind) and f"moc_{name}" in row]
        sizes = [row["size"] for row in mine]
        lows = [min(row[f"change_{name}_low"], row[f"change_{name}_of_ratios_low"]) for row in mine]
        trials = min((row[f"{name}_trials"] for row in mine), default=0)
        found.append({
            "preset": preset, "kind": kind, "trials": trials, "undecided": too_few(trials) or "",
            "relative": crossing(sizes, lows, MOST_CHANGE_PERCENT),
            "absolute": crossing(sizes, [row[f"moc_{name}"] for row in mine], MOST_MM),
            "absolute_dcac": crossing(sizes, [row[f"dcac_{name}"] for row in mine], MOST_MM),
        })  # fmt: skip
    return found


def crossing(sizes: Sequence[float], values: Sequence[float], limit: float) -> float | None:
    """Return where the values rise above a limit for good, interpolated; the first size where they begin above it."""
    last = max((k for k, value in enumerate(values) if not value > limit), default=-1)
    if last == len(values) - 1:
        return None
    if last < 0:
        return sizes[0]
    share = (limit - values[last]) / (values[last + 1] - values[last])
    return float(sizes[last] + share * (sizes[last + 1] - sizes[last]))


def sentences(rows: Rows) -> list[str]:
    """Return for each preset from which error on the elbow costs tip accuracy, and what registering again leaves."""
    said, evens = [], break_evens(rows)
    for preset in _presets(rows):
        origins, encoders = (next(one for one in evens if (one["preset"], one["kind"]) == (preset, kind))
                             for kind in ("origins", "encoders"))  # fmt: skip
        if few := origins["undecided"] or encoders["undecided"]:
            said.append(f"`{preset}`: {few}.")
            continue
        relative, absolute = (
            f"{_at(origins[key], 'mm')} of the joints' origins or {_at(encoders[key], 'mrad')} of the encoders"
            for key in ("relative", "absolute")
        )
        text = (
            f"`{preset}`: from {relative} on, moving the elbow costs more than {MOST_CHANGE_PERCENT:g} % of tip "
            f"accuracy in the patient's frame, and from {absolute} on the tip error there exceeds {MOST_MM:g} mm"
        )
        here = (preset, "origins", DEFAULT_SIZE)
        again = [row for row in rows if (row["preset"], row["kind"], row["size"]) == here and "moc_tip_again" in row]
        for row in again:
            text += (
                f"; with {DEFAULT_SIZE:g} mm it is {row['moc_tip_after']:.3f} mm once the elbow has travelled, and "
                f"registering again then leaves {row['moc_tip_again']:.3f} (DCAC: {row['dcac_tip_again']:.3f})"
            )
        said.append(f"{text} ({origins['trials']} trials).")
    return said


def _presets(rows: Rows) -> list[str]:
    return list(dict.fromkeys(row["preset"] for row in rows))


def _at(size: float | None, unit: str) -> str:
    return "more than was tried" if size is None else f"{size:.2g} {unit}"


def _cells(rows: Rows) -> list[dict[str, Any]]:
    """Return "DCAC/MOC" of every error, a row a preset, kind and size; size 0 once."""
    return [
        {
            "preset": row["preset"], "kind": row["kind"] if row["size"] else "nothing", "size": row["size"],
            "off": f"{row['kind']} {row['size']:g}" if row["size"] else "nothing",
            **{key: f"{row[f'dcac_{key}']:.3f}/{row[f'moc_{key}']:.3f}" for key in COLUMNS if f"moc_{key}" in row},
            "change": spread(row, "change_tip_error_registered"),
        }
        for row in rows
        if row["size"] or row["kind"] == next(iter(KINDS))
    ]  # fmt: skip


def answer(rows: Rows) -> Answer:
    """Make the first screen: the tip in its frames, and registered again, where the joints' origins are off."""
    shown = [
        {**row, "off": f"{row['preset']}, {row['size'] or 'nothing'}"}
        for row in _cells(rows)
        if row["kind"] in ("nothing", "origins")
    ]
    columns = [Column("off", "preset, mm off")]
    columns += [Column(f"tip{end}", of, unit="mm", section=ALL) for end, of in ENDS.items()]
    title = "Mean tip error under DCAC/MOC, where the joints' origins are off"
    says = "Preset {}: tip error in the frame registered at the start, with 95 % intervals over the trials."
    pictures = [Picture(error_figure(rows, one), says.format(one), f"calibration-{one}") for one in _presets(rows)]
    told = [*sentences(rows), ABOUT_FRAMES][:3]
    return Answer(told, Table(title, columns, shown, f"{DEFINED} {TRAVEL}"), pictures)


def error_figure(rows: Rows, preset: str) -> go.Figure:
    """Draw the registered tip error over the size of the origins' error: DCAC, MOC, and MOC registered again."""
    mine = [row for row in rows if (row["preset"], row["kind"]) == (preset, "origins") and "moc_tip_error" in row]
    drawn, colors = figure(), list(SERIES)
    for name, key, color, dash in (
        ("DCAC", "dcac_tip_error_registered", 0, "solid"), ("MOC", "moc_tip_error_registered", 1, "solid"),
        ("MOC after the travel, registered again", "moc_tip_again", 1, "dash"),
    ):  # fmt: skip
        known = [row for row in mine if key in row]
        drawn.add_scatter(
            x=[row["size"] for row in known], y=[row[key] for row in known], name=label(name), mode="lines+markers",
            line={"color": colors[color], "dash": dash},
            error_y={"type": "data", "symmetric": False, "array": [row[f"{key}_high"] - row[key] for row in known],
                     "arrayminus": [row[key] - row[f"{key}_low"] for row in known]},
        )  # fmt: skip
    drawn.update_xaxes(title_text="joints' origins off by [mm]")
    drawn.update_yaxes(title_text="mean tip error, registered frame [mm]", rangemode="tozero")
    rule(drawn, "y", MOST_MM, f"{MOST_MM:g} mm")
    return drawn


def page(rows: Rows, first: Answer, effects: Sequence[Table], environment: Mapping[str, Any]) -> Page:
    """Make the page."""
    made = Page("The plant", "what defects of the arm cost, and from which calibration error on a moving elbow does")
    first.begin(made)
    made.section(ALL)
    made.text(DEFINED)
    made.table(sweep_table(rows))
    if effects:
        made.section("Each defect alone and together")
    for table in effects:
        made.table(table)
    made.environment(environment)
    return made


def sweep_markdown(rows: Rows, seed: int) -> str:
    """Return the section of docs/plant.md."""
    runs = max((row["runs"] for row in rows), default=0)
    lines = [f"`python -m benchmarks.plant --page` (seed {seed}, {runs} trials; means, intervals of 95 %):", ""]
    lines += [*(f"- {said}" for said in sentences(rows)), "", f"{DEFINED} {TRAVEL}", ""]
    evens = [
        {**row, **{key: _at(row[key], KINDS[row["kind"]]) for key in EVENS}}
        for row in break_evens(rows)
        if not row["undecided"]
    ]
    columns = [Column("preset", "preset"), Column("kind", "off"), *(Column(key, name) for key, name in EVENS.items())]
    lines += [markdown.of_columns(columns, evens), ""] if evens else []
    table = sweep_table(rows)
    return "\n".join([*lines, f"{table.title}:", "", markdown.of_columns(table.columns, table.rows)])


def sweep_table(rows: Rows) -> Table:
    columns = [Column("preset", "preset"), Column("off", "off [mm, mrad]")]
    columns += [Column(key, title, unit="mm") for key, title in COLUMNS.items()]
    columns += [Column("change", "tip, registered, change", unit="%")]
    return Table("Mean errors under DCAC/MOC in every frame", columns, _cells(rows), f"{ABOUT_FRAMES} {TRAVEL}")

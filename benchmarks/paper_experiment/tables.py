"""The tables of ``python -m benchmarks.paper``, all from its numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.paper_experiment import ablation
from benchmarks.paper_experiment.figures import titles
from moc_opt.comparison.statistics import spread
from moc_opt.report.tables import Column, Table

Summary = Mapping[str, Any]

FIGURES = {
    "mu_mean": ("mu", "m^3", 4),
    "mu_gain_percent": ("gain", "%", 3),
    "tip_error_model_mean_mm": ("tip", "mm", 3),
    "tip_error_registered_mean_mm": ("registered tip", "mm", 3),
    "rcm_error_model_mean_mm": ("RCM", "mm", 3),
    "rcm_error_registered_mean_mm": ("registered RCM", "mm", 3),
    "rcm_error_mean_mm": ("RCM, true trocar", "mm", 3),
    "trocar_force_mean_N": ("force", "N", 3),
}
PHASE = [
    Column("controller", "controller"),
    Column("phase", "phase"),
    Column("share_of_ticks", "share", format=".2f", help="of the ticks of a trial"),
    Column("tip_error_model_mean_mm", "tip", unit="mm", help="by the robot's own kinematics"),
    Column("tip", "change", unit="%", help="against DCAC with the same gains at the same ticks, 95 % interval"),
    Column("ticks", "ticks", format=".0f", help="of all trials in this phase, the same for all controllers"),
    Column("rcm_error_model_mean_mm", "RCM", unit="mm", help="from the registered trocar, as the robot sees it"),
    Column("rcm", "change", unit="%"),
    Column("trocar_force_mean_N", "force", unit="N"),
    Column("force", "change", unit="%"),
]
VERDICT = [
    Column("controller", "controller"),
    Column("text", "claim"),
    Column("verdict", "verdict"),
    Column("own", "against DCAC, its own gains", unit="%", help="effect with its 95 % interval"),
    Column("matched", "MOC's gains", unit="%"),
    Column("damped", "MOC's gains, damped", unit="%"),
]
ABLATION = [
    Column("about", "entries"),
    Column("draw", "seed"),
    Column("trials", "trials", format="d"),
    Column("mu", "mu", unit="%", help="effect with its 95 % interval"),
    Column("tip", "tip", unit="%"),
    Column("rcm", "RCM", unit="%"),
    Column("holds", "claims confirmed"),
    Column("decides", "decides on"),
]
PROCEDURE = [
    Column("task", "task"),
    Column("ended", "ended"),
    Column("registration_error_mm", "trocar off", unit="mm", help="registered against true, after hands-on guiding"),
    Column("hand_force_max_N", "hand", unit="N", help="largest force of the hand"),
    Column("board_position_mm", "board off", unit="mm", help="as located by the camera, against the truth"),
    Column("board_angle_deg", "board off", unit="deg"),
    Column("waited_s", "waited", unit="s", help="for a board that could not be seen"),
    Column("tip_error_mean_mm", "tip", unit="mm", help="from the reference that the robot follows"),
    Column("path_deviation_mean_mm", "off the task", unit="mm", help="from the task as it truly lies on the phantom"),
    Column("rcm_error_mean_mm", "RCM", unit="mm", help="from the true incision"),
    Column("error", "error"),
]
GOAL = [
    Column("text", "goal"),
    Column("limit", "limit", digits=3),
    Column("value", "value", help="with its 95 % interval"),
    Column("reached", "reached"),
]


SHOWN = (
    "mu_fraction_of_bound", "mu_fraction_of_best_from_start", "mu_fraction_of_best", "torque_rate_rms_Nm_per_s",
    "broke_off", "oscillated",
)  # fmt: skip


def group_table(summary: Summary, group: str, about: str) -> Table:
    """Make the table of a group's controllers: means over the trials with their intervals."""
    columns = [Column("controller", "controller")]
    columns += [Column(key, title, unit=unit) for key, (title, unit, _) in FIGURES.items()]
    columns += [
        Column("mu_fraction_of_bound", "of bound", digits=3, better="high"),
        Column("mu_fraction_of_best_from_start", "of best from start", digits=3, better="high"),
        Column("mu_fraction_of_best", "of best", digits=3, better="high"),
        Column("torque_rate_rms_Nm_per_s", "chatter", unit="Nm/s", digits=3, better="low"),
        Column("broke_off", "broke off", format="d", better="low", help="stopped or failed; in no mean"),
        Column("oscillated", "oscillated", format="d", better="low", help="a joint shook; in the means"),
    ]
    names = titles(list(summary[group]))
    rows = [
        {
            **{name: entries.get(name) for name in SHOWN},
            "controller": names[controller],
            **{key: spread(entries, key, digits) for key, (_, _, digits) in FIGURES.items()},
        }
        for controller, entries in summary[group].items()
    ]
    return Table(
        f"Group {group}: {about}",
        columns,
        rows,
        "Mean over the trials, with its 95 % bootstrap interval; the gain is that of the mean mu. Tip and RCM "
        "without a further word: by the robot's own kinematics, from the registered trocar.",
    )


def interval_rows(
    rows: Sequence[Mapping[str, Any]], group: str, keys: Sequence[str], suffix: str
) -> list[dict[str, Any]]:
    """Return the rows of a group, with the controller's title and each key's value with its interval."""
    names = titles([row["controller"] for row in rows])
    return [
        {
            **row, "controller": names[row["controller"]],
            **{key: spread(row, f"{key}{suffix}") for key in keys},
        }
        for row in rows
        if row["group"] == group
    ]  # fmt: skip


def phase_table(rows: Sequence[Mapping[str, Any]], group: str) -> Table:
    """Show transient and steady state apart."""
    drawn = interval_rows(rows, group, ("tip", "rcm", "force"), "_change_percent")
    return Table(
        f"Group {group}: while an elbow travels, and in the steady state", PHASE, drawn,
        "Steady (phase `settled`): the ticks of a trial at which no controller with a third level has its elbow on the "
        "way to its optimum; the same ticks for all controllers. A trial counts by its ticks.",
    )  # fmt: skip


def verdict_table(rows: Sequence[Mapping[str, Any]], group: str) -> Table:
    """Make the table of the paper's claims."""
    drawn = interval_rows(rows, group, ("own", "matched", "damped"), "_percent")
    return Table(f"Group {group}: do the paper's claims hold?", VERDICT, drawn)


def goal_table(summary: Summary, group: str, solver: str) -> Table:
    """Make the table of the goals of the best MOC, and what they are from other starts."""
    away = {row["goal"]: row for row in summary.get("goals_elsewhere", [])}
    drawn = []
    for row in summary["goals"]:
        there = away.get(row["goal"], {})
        found = {"away": spread(there, "value"), "away_reached": there["reached"]} if there else {}
        drawn.append({**row, "value": spread(row, "value"), **found})
    columns = GOAL + ([Column("away", "random poses"), Column("away_reached", "reached")] if away else [])
    return Table(f"Goals: MOC with {solver}, group {group}", columns, drawn)


def ablation_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """Make the table of Table I with entries exchanged: one row a case and draw, the effect on every claim's metric."""
    drawn: dict[tuple[str, str], dict[str, Any]] = {}
    for row in rows:
        line = drawn.setdefault(
            (row["case"], row["draw"]),
            {"about": row["about"], "draw": row["draw"], "trials": row["trials"], "holds": [], "decides": []},
        )
        line[row["claim"]] = spread(row, "effect_percent")
        line["holds"] += [row["claim"]] if row["confirmed"] else []
        line["decides"] += [row["claim"]] if row.get("decides") else []
    lines = [
        {**line, "holds": ", ".join(line["holds"]), "decides": ", ".join(line["decides"])} for line in drawn.values()
    ]
    return Table("Table I with entries exchanged, against matched DCAC", ABLATION, lines, ablation.RULE)


def procedure_table(summary: Summary) -> Table:
    """Show the way from guiding to the end of the task."""
    rows = [{"task": task, **entries} for task, entries in summary["procedure"].items()]
    pictures = summary["board_pictures"]
    caption = (
        f"Single pictures of the board at random poses: seen in {100 * pictures['seen']:.0f} %, "
        f"off by {pictures['position_median_mm']:.2f} mm and {pictures['angle_median_deg']:.2f} deg (medians)."
    )
    return Table("The operative procedure, whole", PROCEDURE, rows, caption)

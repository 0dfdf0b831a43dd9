"""Show a run as table, JSON and sentences."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from moc_opt.figures.notation import Missing, Notation, missing, pretty_unit, pretty_units
from moc_opt.report.tables import Column, Table
from moc_opt.trace.meta import Ending
from moc_opt.trace.metrics import METRICS, Metric
from moc_opt.trace.trace import Trace, about, table

WHOLE_RUN = ("completed", "share_of_run")
METHOD = "mu_bound_method"  #: Entry of `Trace.meta` that says how the largest mu was found.
NEAR = 0.02  #: If mu is below the best mu by at most this share, it counts as best.

MATTER = (
    "mu_mean", "mu_gain_percent", "mu_fraction_of_best_from_start", "tip_error_model_mean_mm",
    "tip_error_registered_mean_mm", "tip_error_mean_mm", "rcm_error_model_mean_mm", "rcm_error_registered_mean_mm",
    "rcm_error_mean_mm", "rcm_error_max_mm", "trocar_force_max_N", "torque_rate_rms_Nm_per_s", "verified_solved",
    "silently_wrong", "solve_p50_us", "solve_p99_us", "deadline_misses",
)  # fmt: skip
"""The main metrics."""
VERDICTS = ("verified_solved", "silently_wrong")
ANOTHER_PROBLEM = (
    "Solvers nlp-* solve a nonlinear problem, but answers are judged by the linear problem. With the solutions of the "
    "two problems, the velocities of tip and wrist differ by up to about 1e-3 m/s. So answers of nlp-* count as "
    "neither verified nor wrong."
)


def is_nonlinear(solver: str) -> bool:
    """Return whether the solver solves a nonlinear problem. The metrics in `VERDICTS` then mean nothing."""
    return solver.startswith("nlp-")


def answers_another_problem(trace: Trace) -> bool:
    """Return whether the run's solver `is_nonlinear`."""
    return is_nonlinear(about(trace).get("solver", ""))


def part(trace: Trace) -> str:
    """Return the completed part of a run, such as " (first 0.6 s of 8.0 s)" ("" for a whole run)."""
    ending = Ending.of(str(trace.meta.get("ended")))
    if ending is Ending.PART:
        return " (a part)"
    ticks, planned, period = (trace.meta.get(name) for name in ("ticks", "ticks_planned", "period_s"))
    if ticks is None or planned is None or period is None or ticks >= planned:
        return ""
    braking = ", braking included" if ending is Ending.STOPPED else ""
    return f" (first {ticks * period:.1f} s of {planned * period:.1f} s{braking})"


def warnings(trace: Trace) -> list[str]:
    """Return one sentence per warning of the safety filter."""
    return [
        f"warning: {w['of']} was above {w['level']:g} {w['unit']}, first at t = {w['first_s']:.3f} s; "
        f"its maximum was {w['largest']:.3g} {w['unit']}"
        for w in trace.meta.get("warnings", [])
    ]


def replaced(trace: Trace) -> str:
    """Return how many answers were replaced ("at 412 of 4034 ticks: late 412"), or ""."""
    counts = {fault: of["count"] for fault, of in trace.meta.get("faults", {}).items()}
    if not counts:
        return ""
    total = sum(counts.values())
    most = " (more than half, so the metrics are not this solver's)" if 2 * total > len(trace) else ""
    return f"at {total} of {len(trace)} ticks{most}: {', '.join(f'{fault} {count}' for fault, count in counts.items())}"


def below_best(trace: Trace) -> str:
    """Say how far mean mu is below that of the best joint motion, or why this is unknown; "" if it counts as best."""
    found = table(trace.meta, "best_courses")
    if absent := found.get("absent"):
        return f"mean mu is not compared with the best joint motion from this start: {absent}"
    if not {"mu", "mu_best_from_start"} <= set(trace.columns):
        return ""
    below = 1.0 - float(trace.mu.mean()) / float(trace.mu_best_from_start.mean())
    if not below > NEAR:
        return ""
    end = found.get("end")
    said = f"mean mu is {100.0 * below:.1f} % below that of the best joint motion from this start"
    control = table(table(trace.meta, "scenario"), "control")
    if end is None or (control.get("law"), control.get("third_level")) != ("moc", "local"):
        return said
    left = 1.0 - float(trace.mu[-1]) / end["top_mu"]
    if left > NEAR:
        return f"{said}; at the end mu is still {100.0 * left:.1f} % below the nearest local maximum"
    if end["top_mu"] >= (1.0 - NEAR) * end["best_mu"]:
        return f"{said}; the run ends at the best pose, but had less mu before"
    top = f"at swivel {end['top_swivel_deg']:.0f} deg ({end['top_mu']:.3f} m³)"
    best = f"at {end['best_swivel_deg']:.0f} deg ({end['best_mu']:.3f} m³)"
    where = "before a joint limit" if end["at_limit"] else "at a local maximum"
    return f"{said}; the run ends {where} {top}, the best motion ends {best}"


def facts(trace: Trace) -> dict[str, str]:
    """Return arm, path, solver and other facts of the scenario, by name."""
    scenario = table(trace.meta, "scenario")
    law, control = about(trace).get("solver"), table(scenario, "control")
    known = {
        "arm": about(trace).get("robot"), "path": table(scenario, "task").get("path"),
        "gains": control.get("gains"), "controller" if law == "dcac" else "solver": law,
        "third level": None if law == "dcac" else control.get("third_level"),
        "course": control.get("course") or None, "seed": scenario.get("seed"),
        "controller's process": "runs apart, perhaps with another solver or gains" if "wire" in trace.meta else None,
    }  # fmt: skip
    return {word: str(value) for word, value in known.items() if value is not None}


def title_of(traces: Mapping[str, Trace]) -> str:
    """Return a title such as "lwr4, circle, default gains: dcac and exact"."""
    runs = [facts(trace) for trace in traces.values()]
    each = {word: listed([run[word] for run in runs if word in run]) for word in ("arm", "path", "gains")}
    laws = listed([run.get("controller") or run.get("solver") or name for name, run in zip(traces, runs, strict=True)])
    task = [each["arm"], each["path"], each["gains"] and f"{each['gains']} gains"]
    return ": ".join(filter(None, [", ".join(filter(None, task)), laws]))


def listed(names: Iterable[str]) -> str:
    """Return "a, b and c", each name once."""
    *first, last = dict.fromkeys(names) or [""]
    return f"{', '.join(first)} and {last}" if first else last


def run_tables(
    traces: Mapping[str, Trace], metrics: Mapping[str, Mapping[str, float]], *, first: bool = False,
    explained: bool = False,
) -> list[Table]:  # fmt: skip
    """Lay out the metrics of runs side by side.

    If any run ended early, each run has its own table. With ``first``, only the metrics in `MATTER` are shown. With
    ``first`` or ``explained``, a column gives the metrics' meanings.
    """
    if len(metrics) > 1 and any(part(traces[name]) for name in metrics):
        alone = ({name: values} for name, values in metrics.items())
        return [table for one in alone for table in run_tables(traces, one, first=first, explained=explained)]
    rows, said, many = dict[str, dict[str, Any]](), list[str](), len(metrics) > 1
    columns = [Column("metric", "metric"), *(Column(f"run {name}", name if many else "value") for name in metrics)]
    for name, values in metrics.items():
        for metric, (value, meaning) in _entries(traces[name], values, first).items():
            row = rows.setdefault(metric, {"metric": metric, "says": meaning})
            row |= {f"run {name}": value, "says": meaning if row["says"] == meaning else ""}
        other = answers_another_problem(traces[name]) and set(VERDICTS) & set(values)
        said += [*([ANOTHER_PROBLEM] if other else []), *warnings(traces[name])]
        title = ": ".join(filter(None, [f"{name}{part(traces[name])}", description(traces[name]) if first else ""]))
    columns += [Column("says", "meaning")] if first or explained else []
    return [Table(listed(metrics) if many else title, columns, list(rows.values()), "\n".join(dict.fromkeys(said)))]


def _entries(trace: Trace, metrics: Mapping[str, float], first: bool) -> dict[str, tuple[Any, str]]:
    of, other, count = part(trace), answers_another_problem(trace), replaced(trace)
    ended = str(trace.meta.get("ended", "unknown"))
    word, _, reason = ended.partition(": ") if first else (ended, "", "")
    ticks = f"{len(trace)} tick{'s' * (len(trace) != 1)}"
    entries: dict[str, tuple[Any, str]] = {"ended": (word, reason or f"after {ticks}")}
    entries |= {"solver replaced": (count, "")} if count else {}
    for metric, value in metrics.items():
        if first and metric not in MATTER:
            continue
        marked = f"{metric} (part)" if of and metric not in WHOLE_RUN else metric
        shown = missing(value) or Notation.of([value], digits=4)(value)
        shown = Missing(ANOTHER_PROBLEM) if other and metric in VERDICTS else shown
        entries[marked] = shown, "" if metric not in METRICS else _with_unit(METRICS[metric])
        if metric == "mu_fraction_of_bound" and METHOD in trace.meta:
            entries[METHOD] = str(trace.meta[METHOD]), "How the largest mu was found."
    return entries


def _with_unit(metric: Metric) -> str:
    if metric.unit in ("1", "percent") or f"[{metric.unit}]" in metric.about:
        return pretty_units(metric.about)
    return f"{metric.about.removesuffix('.')} [{pretty_unit(metric.unit)}]."


def description(trace: Trace) -> str:
    """Return `facts` as text: "arm lwr4, path circle, ..."."""
    return ", ".join(f"{word} {value}" for word, value in facts(trace).items())


def remarks(trace: Trace) -> list[str]:
    """Return sentences on refused answers, warnings and a low mean mu."""
    refused = [
        f"answer refused, {fault}: {of['count']} of {len(trace)} ticks, first at {of['first_at_s']:.3f} s: "
        f"{of['first']}"
        for fault, of in trace.meta.get("faults", {}).items()
    ]
    return list(filter(None, [*refused, *warnings(trace), below_best(trace)]))


def run_json(trace: Trace, metrics: Mapping[str, float]) -> dict[str, Any]:
    """Return a run's end, metrics, warnings and faults for JSON."""
    hidden = set(VERDICTS) & set(metrics) if answers_another_problem(trace) else set()
    first = {"part": part(trace).strip(" ()"), "solver_replaced": replaced(trace)}
    return {
        "ended": trace.meta.get("ended", "unknown"), **{key: text for key, text in first.items() if text},
        **metrics, **dict.fromkeys(hidden), **({METHOD: trace.meta[METHOD]} if METHOD in trace.meta else {}),
        "warnings": trace.meta.get("warnings", []), "faults": trace.meta.get("faults", {}),
    }  # fmt: skip

"""One run as a table and as JSON: how it ended comes first, and figures of a part say that they are one."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from moc_opt.figures.notation import Missing, Notation, missing, pretty_units
from moc_opt.report.tables import Column, Table
from moc_opt.trace.meta import Ending
from moc_opt.trace.metrics import METRICS
from moc_opt.trace.trace import Trace, about, table

WHOLE_RUN = ("completed", "share_of_run")
METHOD = "mu_bound_method"
"""How the largest mu was found: an entry of a trace's meta."""


MATTER: Mapping[str, str] = MappingProxyType({
    "mu_mean": "manipulability [m³]: how far the arm keeps from singular poses",
    "mu_gain_percent": "mean mu above that of DCAC (no third level) with the same gains and observer [%]; "
    "between third levels compare mu_mean",
    "mu_fraction_of_best_from_start": "mean mu over that of the best motion of the elbow from this start, 0 to 1",
    "tip_error_model_mean_mm": "tip from its path [mm], by the robot's own kinematics: what the controller can see and "
    "answer for",
    "tip_error_registered_mean_mm": "the same in the frame registered at the start: what the patient sees",
    "tip_error_mean_mm": "the same in the base frame: absolute accuracy, for whoever registers elsewhere",
    "rcm_error_model_mean_mm": "shaft from the registered trocar [mm], by the robot's own kinematics",
    "rcm_error_registered_mean_mm": "the same in the frame registered at the start",
    "rcm_error_mean_mm": "shaft from the true trocar [mm]: the registration's error is part of it",
    "rcm_error_max_mm": "shaft from the true trocar [mm], at most",
    "trocar_force_max_N": "force on the trocar [N], at most",
    "torque_rate_rms_Nm_per_s": "chatter of the torque [Nm/s]: compare it with that of DCAC or of another solver",
    "verified_solved": "ticks whose answer our own residuals find optimal",
    "silently_wrong": "ticks at which the solver called a wrong answer solved; 0 is right",
    "solve_p50_us": "time of a solve [us], median, on this machine",
    "solve_p99_us": "time of a solve [us], 99th percentile: one in a hundred takes longer",
    "deadline_misses": "ticks that took longer than the period, on this machine; of no meaning in lock-step",
})  # fmt: skip
"""Metrics to look at first, and their meaning."""


VERDICTS = ("verified_solved", "silently_wrong")
"""Metrics that say what the answers to the null-space subproblem are worth."""
ANOTHER_PROBLEM = (
    "nlp-* answer the nonlinear problem of the tick, about 1e-3 m/s off the linear one that is judged: neither "
    "verified nor wrong."
)


def answers_another_problem(trace: Trace, solver: str = "") -> bool:
    """Say whether the answers of a run are those of a nonlinear solver, which the judge's verdicts do not fit.

    Args:
        trace: of the run; its scenario names the solver.
        solver: its name, where another one was asked than the scenario names.
    """
    return (solver or about(trace).get("solver", "")).startswith("nlp-")


def part(trace: Trace) -> str:
    """Return " (first 0.6 s of 8.0 s)" of a run broken off, " (a part)" of a cut trace; empty where it is whole."""
    if Ending.of(str(trace.meta.get("ended"))) is Ending.PART:
        return " (a part)"
    ticks, planned = (trace.meta.get(name) for name in ("ticks", "ticks_planned"))
    period = trace.meta.get("period_s")
    if ticks is None or planned is None or period is None or ticks >= planned:
        return ""
    return f" (first {ticks * period:.1f} s of {planned * period:.1f} s)"


def warnings(trace: Trace) -> list[str]:
    """Return a sentence on each warning of the safety filter."""
    return [
        f"warning: {w['of']} was above {w['level']:g} {w['unit']} from t = {w['first_s']:.3f} s on, "
        f"{w['largest']:.3g} {w['unit']} at most"
        for w in trace.meta.get("warnings", [])
    ]


NEAR = 0.02
"""A run whose mean or final mu is at most this fraction below the best course is not spoken of."""


def below_best(trace: Trace) -> str:
    """Return a sentence on a run that stays below the best course from its start: by how much, and the reason."""
    told = trace.meta.get("best_courses", {})
    if told.get("absent"):
        return f"not compared with a best course: {told['absent']}"
    if "mu_best_from_start" not in trace.columns:
        return ""
    below = 1.0 - float(trace.mu.mean()) / float(trace.mu_best_from_start.mean())
    if not below > NEAR:
        return ""
    said, end = f"mean mu is {100.0 * below:.1f} % below the best course from this start", told.get("end")
    control = trace.meta.get("scenario", {}).get("control", {})
    if end is None or (control.get("law"), control.get("third_level")) != ("moc", "local"):
        return said
    there = f"at {end['best_swivel_deg']:.0f} deg ({end['best_mu']:.3f} m^3)"
    top = f"{end['top_swivel_deg']:.0f} deg ({end['top_mu']:.3f} m^3)"
    left = 1.0 - float(trace.mu[-1]) / end["top_mu"]
    if left > NEAR:
        return f"{said}; at its end it is still {100.0 * left:.1f} % below the local maximum uphill of it"
    if end["top_mu"] >= (1.0 - NEAR) * end["best_mu"]:
        return f"{said}; the local law ends at the best pose: the elbow took time to get there"
    if end["at_limit"]:
        return f"the local law is held by a joint limit: {said}; the way up ends at swivel {top}, the course {there}"
    return f"the local law is trapped: {said}; it ends at the local maximum at swivel {top}, the course {there}"


def in_short(metrics: Mapping[str, float]) -> str:
    """Return the main figures of a whole run in one sentence; those that are not there are left out."""
    gain, wrong = metrics.get("mu_gain_percent"), metrics.get("silently_wrong")
    said = [] if gain is None else [f"mean mu is {abs(gain):.1f} % {'below' if gain < 0.0 else 'above'} DCAC's"]
    frames = (("model", "by the robot's own kinematics"), ("registered", "in the registered frame"), ("", "absolute"))
    tips = [
        f"{metrics[name]:.2f} mm {words}"
        for frame, words in frames
        if (name := f"tip_error_{frame}_mean_mm".replace("__", "_")) in metrics
    ]
    said += [f"the tip is off its path by {', '.join(tips)} on average"] if tips else []
    if (off := metrics.get("rcm_error_max_mm")) is not None:
        said.append(f"the shaft at most {off:.2f} mm off the trocar")
    if wrong is not None:
        count = "no answer was" if wrong == 0 else "1 answer was" if wrong == 1 else f"{wrong:.0f} answers were"
        said.append(f"{count} silently wrong")
    return ", ".join(said)


def refusals(trace: Trace) -> list[str]:
    """Return a sentence on each kind of answer that the supervisor refused."""
    return [
        f"answer refused, {fault}: {of['count']} of {len(trace)} ticks, first at {of['first_at_s']:.3f} s: "
        f"{of['first']}"
        for fault, of in trace.meta.get("faults", {}).items()
    ]


def replaced(trace: Trace) -> str:
    """Return "412 of 4034 ticks: raised 400, late 12" where answers were replaced; empty where none was."""
    counts = {fault: of["count"] for fault, of in trace.meta.get("faults", {}).items()}
    if not counts:
        return ""
    total = sum(counts.values())
    most = "most of them; the figures are not this solver's: " if 2 * total > len(trace) else ""
    return f"at {total} of {len(trace)} ticks: {most}{', '.join(f'{fault} {count}' for fault, count in counts.items())}"


def asked(trace: Trace) -> str:
    """Say in a few words what was run; empty where the trace does not say."""
    scenario = table(trace.meta, "scenario")
    law, control = about(trace).get("solver"), table(scenario, "control")
    known = {
        "path": table(scenario, "task").get("path"), "controller" if law == "dcac" else "solver": law,
        "gains": control.get("gains"), "third level": None if law == "dcac" else control.get("third_level"),
        "course": control.get("course") or None, "seed": scenario.get("seed"),
    }  # fmt: skip
    return ", ".join(f"{word} {value}" for word, value in known.items() if value is not None)


def run_table(
    name: str, trace: Trace, metrics: Mapping[str, float], *, first: bool = False, explained: bool = False
) -> Table:
    """Lay out the metrics of one run, the ending in the first row, and in the second how often the solver was replaced.

    Of a run that was broken off the title says which part there is, and every figure is marked as one of that part.

    Args:
        name: of the run.
        trace: of the run.
        metrics: name -> value.
        first: those of `MATTER` alone, each with what it says, and what was run in the title.
        explained: all, each with what it is.
    """
    of = part(trace)
    ended = str(trace.meta.get("ended", "unknown"))
    word, _, reason = ended.partition(": ") if first else (ended, "", "")
    rows: list[dict[str, Any]] = [{"metric": "ended", "value": word, "says": reason or f"after {len(trace)} ticks"}]
    if replaced(trace):
        count, _, ticks = replaced(trace).removeprefix("at ").partition(" ")
        told = {"value": count, "says": ticks} if first or explained else {"value": replaced(trace)}
        rows.append({"metric": "solver replaced", **told})
    other = answers_another_problem(trace)
    for metric, value in metrics.items():
        if first and metric not in MATTER:
            continue
        marked = f"{metric} (part)" if of and metric not in WHOLE_RUN else metric
        shown = Missing(ANOTHER_PROBLEM) if other and metric in VERDICTS else _written(value)
        says = MATTER[metric] if first else pretty_units(METRICS[metric].about) if metric in METRICS else ""
        rows.append({"metric": marked, "value": shown, "says": says})
        if metric == "mu_fraction_of_bound" and METHOD in trace.meta:
            rows.append({"metric": METHOD, "value": str(trace.meta[METHOD]), "says": "How the largest mu was found."})
    columns = [Column("metric", "metric"), Column("value", "value")]
    columns += [Column("says", "what it says")] if first or explained else []
    said = [ANOTHER_PROBLEM] if other and set(VERDICTS) & set(metrics) else []
    title = f"{name}{of}: {asked(trace)}" if first and asked(trace) else f"{name}{of}"
    return Table(title, columns, rows, caption="\n".join([*said, *warnings(trace)]))


def _written(value: float) -> str | Missing:
    """Return one figure in its own notation: from millimetres to rounding errors, no single one reads well for all."""
    return missing(value) or Notation.of([value], digits=4)(value)


def run_json(trace: Trace, metrics: Mapping[str, float]) -> dict[str, Any]:
    """Return ``ended``, ``part`` of a run broken off, ``solver_replaced``, the metrics, and how they came about."""
    of = part(trace).strip(" ()")
    return {
        "ended": trace.meta.get("ended", "unknown"), **({"part": of} if of else {}),
        **({"solver_replaced": replaced(trace)} if replaced(trace) else {}), **metrics,
        **(dict.fromkeys(set(VERDICTS) & set(metrics)) if answers_another_problem(trace) else {}),
        **({METHOD: trace.meta[METHOD]} if METHOD in trace.meta else {}),
        "warnings": trace.meta.get("warnings", []),
        "faults": trace.meta.get("faults", {}),
    }  # fmt: skip

"""The goals of this project, beside what was measured."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

from moc_opt.comparison.statistics import Interval

Summary = Mapping[str, Mapping[str, Mapping[str, Any]]]


class Goal(NamedTuple):
    """One goal: reached when the measured value, or the worse end of its interval, is at most, or at least, so much."""

    what: str
    unit: str
    limit: float
    most: bool
    """True: at most ``limit``; False: at least."""
    measured: Callable[[Any], Any]
    """The value in a summary, a number or an `Interval`; LookupError where it was not measured."""


def _largest(part: str, metric: str) -> Callable[[Any], float]:
    return lambda s: max(found[metric] for found in s[part].values() if metric in found)


def _best_peer(s: Any) -> float:
    return min(found["tick_p50_us"] for found in s["peers"].values())


def _million(s: Any, metric: str) -> float:
    found = s["exact"]["recorded"]
    if found["batch"] != 1_000_000:
        raise LookupError("fewer were solved: what a million would take is not measured")
    return float(found[metric])


GOALS = {
    "tick_p50": Goal("tick with exact, from state to torque: median", "us", 25.0, True,
                     lambda s: s["tick"]["exact"]["tick_p50_us"]),
    "tick_p99_9": Goal("tick with exact: p99.9", "us", 100.0, True, lambda s: s["tick"]["exact"]["tick_p99_9_us"]),
    "loop_tick_p50": Goal("tick with exact inside the closed loop: median", "us", 25.0, True,
                          lambda s: s["loop"]["python"]["tick_p50_us"]),
    "loop_tick_p99_9": Goal("tick with exact inside the closed loop: p99.9", "us", 100.0, True,
                            lambda s: s["loop"]["python"]["tick_p99_9_us"]),
    "exact_p50": Goal("exact from Python, recorded subproblems: median", "us", 1.5, True,
                      lambda s: s["exact"]["recorded"]["solve_p50_us"]),
    "exact_any_n": Goal("exact from Python, random arms without structure, slowest n: median", "us", 1.5, True,
                        _largest("exact", "solve_p50_us")),
    "exact_primal": Goal("exact, any n: largest primal residual", "", 1e-13, True, _largest("exact", "primal_max")),
    "exact_natural": Goal("exact, any n: largest natural residual", "", 1e-13, True, _largest("exact", "natural_max")),
    "exact_batch": Goal("exact: a million recorded subproblems in one call, one thread", "s", 5.0, True,
                        lambda s: _million(s, "batch_one_thread_s")),
    "exact_batch_all": Goal("exact: the same, {threads} threads", "s", 5.0, True,
                            lambda s: _million(s, "batch_all_cores_s")),
    "adapters": Goal("slowest adapter over its library by hand", "", 1.05, True, _largest("adapters", "ratio")),
    "loop": Goal("closed loop, one core, over real time", "", 30.0, False, lambda s: s["loop"]["python"]["factor"]),
    "two_processes": Goal("two processes over one", "", 1.8, False,
                          lambda s: s["loop"]["two processes"]["speed_up"]),
    "import": Goal("import moc_opt", "s", 0.3, True, lambda s: s["setup"]["moc_opt"]["import_s"]),
    "first_tick": Goal("first tick of a new process, libraries loaded", "s", 2.0, True,
                       lambda s: s["setup"]["moc_opt"]["first_tick_s"]),
    "c_tick": Goal("tick in C, called from Python: median", "us", 5.0, True, lambda s: s["tick"]["c"]["tick_p50_us"]),
    "c_loop": Goal("closed loop with the tick in C, over real time", "", 60.0, False,
                   lambda s: s["loop"]["c"]["factor"]),
    "judged": Goal("whole run, with judging and the largest mu, over its loop", "", 1.3, True,
                   lambda s: s["loop"]["limit"]["judged_over_loop"]),
    "limit_python": Goal("loop over its limit: MuJoCo's steps and the tick in C", "", 4.0, True,
                         lambda s: s["loop"]["limit"]["python_over_limit"]),
    "limit_c": Goal("loop with the tick in C over the same limit", "", 2.0, True,
                    lambda s: s["loop"]["limit"]["c_over_limit"]),
    "peers": Goal("fastest installed peer's tick over ours", "", 4.0, False,
                  lambda s: _best_peer(s) / s["tick"]["exact"]["tick_p50_us"]),
    "peers_c": Goal("fastest installed peer's tick over ours in C", "", 4.0, False,
                    lambda s: _best_peer(s) / s["tick"]["c"]["tick_p50_us"]),
}  # fmt: skip
"""Key -> goal."""


def _tails(s: Any) -> str:
    tails = {name: found["tick_p99_9_us"] for name, found in s["tick"].items()}
    python = min(value for name, value in tails.items() if name != "c")
    return (
        f"the best solver here has {python:.0f} us, the tick in C {tails['c']:.0f}: interruptions by the operating "
        "system decide this figure"
    )


def _loop_tails(s: Any) -> str:
    return f"the tick alone has {s['tick']['exact']['tick_p99_9_us']:.0f} us: interruptions by the operating system"


def _around(s: Any) -> str:
    alone = s["tick"]["exact"]
    return (
        f"the control law alone takes {alone['tick_p50_us']:.1f} us, and {alone['tick_cold_p50_us']:.1f} after "
        "something else has run, as the plant's step does here; the rest is the call from compiled code and the safety "
        "filter"
    )


_REST = {
    "python": "references, sensors, recording, and the columns that follow from others",
    "c": "references, sensors, and the columns that follow from others",
}  # fmt: skip


def _plant(kind: str) -> Callable[[Any], str]:
    def said(s: Any) -> str:
        loop = s["loop"][kind]
        return (f"{loop['us_per_tick']:.0f} us a tick, {loop['tick_p50_us']:.0f} of them filter and controller, "
                f"{s['loop']['limit']['steps_us']:.0f} MuJoCo's steps; the rest is {_REST[kind]}")
    return said  # fmt: skip


def _slowest(part: str, metric: str, words: str) -> Callable[[Any], str]:
    def said(s: Any) -> str:
        name = max((name for name in s[part] if metric in s[part][name]), key=lambda name: float(s[part][name][metric]))
        return words.format(name=name, **s[part][name])
    return said  # fmt: skip


def _fastest(s: Any) -> str:
    name = min(s["peers"], key=lambda peer: float(s["peers"][peer]["tick_p50_us"]))
    return f"{name}: {s['peers'][name]['tick_p50_us']:.0f} us for the same job"


WHY: Mapping[str, Callable[[Any], str]] = MappingProxyType({
    "tick_p99_9": _tails, "loop_tick_p99_9": _loop_tails, "loop_tick_p50": _around, "loop": _plant("python"),
    "c_loop": _plant("c"), "limit_python": _plant("python"), "limit_c": _plant("c"), "peers": _fastest,
    "exact_any_n": _slowest("exact", "solve_p50_us", "{name}: without structure there is no shorter way than to "
                            "eliminate, {kernel_us:.2f} us of it compiled"),
    "adapters": _slowest("adapters", "ratio", "{name}: {adapter_p50_us:.1f} us, by hand {by_hand_p50_us:.1f}"),
})  # fmt: skip
"""Key -> why it is not reached, from the numbers of the same run."""


def reason(key: str, summary: Summary) -> str:
    """Return why a goal is not reached; "" where the numbers do not say."""
    try:
        return WHY[key](summary)
    except (LookupError, ValueError):  # a part that did not run
        return ""


def goal_verdicts(summary: Summary, goals: Mapping[str, Goal] = MappingProxyType(GOALS)) -> dict[str, dict[str, Any]]:
    """Map goal to what, unit, limit, value (None: not measured) and reached.

    Reached is "yes", "no", "open" where the value's interval holds the limit, or "not measured".
    """
    found: dict[str, dict[str, Any]] = {}
    threads = summary.get("exact", {}).get("recorded", {}).get("batch_threads", "all")
    for key, goal in goals.items():
        try:
            measured = goal.measured(summary)
        except (LookupError, ValueError):  # a part that did not run has no entries, and no largest of them
            measured = None
        found[key] = {
            "what": goal.what.format(threads=threads), "unit": goal.unit, "goal": goal.limit,
            "kind": "at most" if goal.most else "at least", **_verdict(goal, measured),
        }  # fmt: skip
    return found


def _verdict(goal: Goal, measured: Any) -> dict[str, Any]:
    if measured is None:
        return {"value": None, "reached": "not measured"}
    if not isinstance(measured, Interval):
        measured = Interval(float(measured), float(measured), float(measured), 1)
    within = [end <= goal.limit if goal.most else end >= goal.limit for end in (measured.low, measured.high)]
    found = {"value": measured.value, "reached": "yes" if all(within) else "open" if any(within) else "no"}
    return found if measured.low == measured.high else found | measured.entries("value")

"""The goals of ``python -m benchmarks.speed``: two of a new process, and five of times side by side in one run."""

from __future__ import annotations

from typing import Any

from benchmarks.common.goals import Goal

TICKS, PEERS, SOLVERS, LOOP = "Ticks", "Other libraries", "Solvers", "Loop"
"""Titles of the page's sections."""


def _batch(s: Any) -> float:
    found = s["batch"]["exact"]
    if found["batch"] < 1_000_000:
        raise LookupError("of fewer the start of the threads is a large part")
    return float(found["batch_two_threads_per_s"]) / 1e6


GOALS = {
    "first_torque": Goal(
        "new process: import to first torque", "s", 0.5, lambda s: s["setup"]["first_tick_s"],
        made_of=lambda s: "libraries {libraries_s:.2f}, model {model_s:.2f}, start and tick {start_and_tick_s:.2f} s"
        .format(**s["setup"]),
    ),
    "first_run": Goal(
        "new process: a first `moc-opt run`", "s", 10.0, lambda s: s["setup"]["first_run_s"]
    ),
    "exact": Goal(
        "exact from Python over daqp by hand", "", 0.12, lambda s: s["adapters"]["daqp"]["ratio_of_exact"],
        section=SOLVERS, made_of=lambda s: f"{s['adapters']['exact']['adapter_p50_us']:.2f} and "
        f"{s['adapters']['daqp']['by_hand_p50_us']:.2f} us",
    ),
    "batch": Goal(
        "exact, a batch on two threads", "million/s", 4.0, _batch, most=False, section=SOLVERS,
        made_of=lambda s: f"one thread {s['batch']['exact']['batch_one_thread_per_s'] / 1e6:.2f} million/s",
    ),
    "tick": Goal(
        "trimmed pink's tick over ours with exact", "", 12.0, lambda s: s["peers"]["pink-trimmed"]["times_ours"],
        most=False, section=PEERS, made_of=lambda s: f"{s['peers']['pink-trimmed']['tick_p50_us']:.0f} and "
        f"{s['tick']['exact']['tick_p50_us']:.1f} us",
    ),
    "c_tick": Goal(
        "moc_step in C: median", "us", 4.0, lambda s: s["tick"]["c"]["tick_p50_us"], section=TICKS,
        made_of=lambda s: f"p99.9 {s['tick']['c']['tick_p99_9_us']:.1f} us",
    ),
    "limit": Goal(
        "default run over its limit, MuJoCo's steps and moc_step", "", 3.0,
        lambda s: s["loop"]["limit"]["python_over_limit"], section=LOOP,
        made_of=lambda s: f"{s['loop']['python']['us_per_tick']:.1f} us a tick, filter and controller "
        f"{s['loop']['python']['tick_p50_us']:.1f} of them; MuJoCo {s['loop']['limit']['steps_us']:.1f}, C "
        f"{s['tick']['c']['tick_p50_us']:.1f} us",
    ),
}  # fmt: skip
"""Key -> goal."""

"""Several faults at once in a closed loop: the run completes, or the arm is stopped for a reason and is at rest."""

from __future__ import annotations

from typing import Any

import hypothesis.strategies as st
import numpy as np

from benchmarks.reliability.fuzz_case import Kind, Verdict, Wrong
from benchmarks.reliability.summary import AT_REST_RAD_PER_S
from moc_opt.robots import available_robots
from moc_opt.scenario import Scenario, Setup
from moc_opt.trace.ending import Ending

PRESSED_N = 35.0
"""Force, as a root mean square over 0.1 s, above which no run may have completed; the limit of the filter is 15 N."""

at_s = st.floats(0.05, 0.6)


def signed(least: float, most: float) -> st.SearchStrategy[float]:
    """Draw a number of this size and either sign."""
    return st.floats(least, most).flatmap(lambda size: st.sampled_from([-size, size]))


FAULTS: list[st.SearchStrategy[dict[str, Any]]] = [
    st.fixed_dictionaries({"encoder_bias_rad": st.floats(1e-6, 0.003), "encoder_noise_rad": st.floats(1e-6, 1e-4)}),
    st.fixed_dictionaries({"nan_at_s": at_s, "nan_ticks": st.integers(1, 1000)}),
    st.fixed_dictionaries({"jump_at_s": at_s, "jump_rad": signed(1e-3, 1.0)}),
    st.fixed_dictionaries({
        "frozen_at_s": at_s, "frozen_ticks": st.integers(1, 1000), "frozen_joint": st.none() | st.integers(0, 6),
        "frozen_velocity": st.sampled_from(["repeated", "zero"]), "forged_stamps": st.booleans(),
        "frozen_wrench": st.booleans(),
    }),
    st.fixed_dictionaries({
        "lag_at_s": at_s, "lag_growth": st.floats(0.01, 1.0), "forged_stamps": st.booleans(),
        "lag_joint": st.none() | st.integers(0, 6),
        "lag_ticks": st.integers(0, 60),
    }),
    st.fixed_dictionaries({"replay_at_s": at_s, "replay_ticks": st.integers(1, 200), "forged_stamps": st.booleans()}),
    st.fixed_dictionaries({
        "drift_at_s": at_s, "drift_rad_per_s": signed(1e-3, 0.1),
        "drift_velocity": st.sampled_from(["included", "apart"]),
    }),
    st.fixed_dictionaries({"drop_share": st.floats(1e-3, 1.0), "late_ticks": st.integers(0, 3)}),
    st.fixed_dictionaries({"bump_N": st.floats(1.0, 60.0), "bump_at_s": at_s, "bump_s": st.floats(0.01, 0.5)}),
    st.fixed_dictionaries({"payload_kg": st.floats(0.01, 1.0)}),
    st.fixed_dictionaries({"slip_m": st.floats(1e-3, 0.1), "slip_at_s": at_s}),
    st.fixed_dictionaries({
        "solver": st.sampled_from(["fail", "nan", "lie", "raise", "outside", "rig", "malformed", "hang"]),
        "solver_share": st.floats(0.01, 1.0),
    }),
]  # fmt: skip


def together(parts: list[dict[str, Any]]) -> dict[str, Any]:
    """Join the tables of several faults into one."""
    return {name: value for part in parts for name, value in part.items()}


runs = st.fixed_dictionaries({
    "seed": st.integers(0, 2**31), "faults": st.lists(st.one_of(FAULTS), min_size=1, max_size=4).map(together),
    "robot": st.fixed_dictionaries({"name": st.sampled_from(available_robots())}),
    "control": st.fixed_dictionaries({
        "preset": st.sampled_from(["tuned", "robust"]), "law": st.sampled_from(["moc", "dcac"]),
    }),
    "start": st.just({"swivel": "random"}), "plant": st.fixed_dictionaries({"delay_ticks": st.integers(0, 2)}),
})  # fmt: skip
"""Scenarios with one to four faults at once."""


def faulty_run(case: dict[str, Any]) -> Verdict:
    """Check a run with faults: "accepted" where it completes, "refused" where the arm was stopped.

    Raises:
        Wrong: a torque beyond its limit, a run that ended in no known way, an arm that moves after its stop, or a run
            that completed while the trocar was pressed.
    """
    scenario = Scenario(**case, duration_s=1.8, bound_samples=0, judge=False)
    setup = Setup(scenario)
    trace = setup.trace()
    ended = Ending.of(trace.meta["ended"])
    if not (np.abs(trace.tau_Nm) <= setup.robot.tau_max * (1.0 + 1e-12)).all():
        raise Wrong("a torque is beyond its limit")
    if ended is Ending.STOPPED:
        speed = float(np.abs(trace.v_rad_per_s[-1]).max())
        whole = trace.meta["ticks"] < trace.meta["ticks_planned"]  # else the run's end cut the stop
        if whole and not speed <= AT_REST_RAD_PER_S:
            raise Wrong(f"{trace.meta['ended']}: a joint goes at {speed:.3g} rad/s at the end of the stop")
        return "refused"
    if ended not in (Ending.COMPLETED, Ending.OSCILLATED):
        raise Wrong(f"ended: {trace.meta['ended']}")
    square = np.convolve((trace.trocar_force_N**2).sum(axis=1), np.full(50, 0.02), "valid").max()
    if not square <= PRESSED_N**2:
        raise Wrong(f"{trace.meta['ended']} with {np.sqrt(square):.0f} N at the trocar")
    return "accepted"


KINDS = {"faulty_run": Kind(faulty_run, runs)}

"""Whatever is handed to a public name, the answer is a result or an error of the package, never a traceback."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import moc_opt as mo

WRONG = [None, 7, -1, 1.5, "x", "none.toml", b"x", [], {}, object(), np.zeros(3), np.nan, True]
SCENARIO = mo.Scenario(duration_s=0.02, bound_samples=0)
TRACE = mo.Trace({"t_s": [0.0, 0.1], "mu": [0.2, 0.3]}, {"ended": "completed"})
ROBOT = mo.load_robot()
STATE = ROBOT.state(np.array(ROBOT.data.q_home))


def problem(**changed: object) -> mo.NullSpaceQP:
    data = {
        "J_tip": STATE.J_tip, "J_wrist": STATE.J_wrist, "v_tip": np.zeros(3), "v_wrist": np.zeros(3),
        "grad_mu": STATE.grad_mu, "lower": -ROBOT.v_max, "upper": ROBOT.v_max,
    }  # fmt: skip
    return mo.NullSpaceQP(**{**data, **changed})  # type: ignore[arg-type]


def planned(**asked: object) -> mo.Plan:
    return mo.plan(SCENARIO, **{"refined": False, "swivels": 16, "times": 3, **asked})  # type: ignore[arg-type]


CALLS: dict[str, Callable] = {
    "run scenario": mo.run, "run solver": lambda x: mo.run(SCENARIO, solver=x),
    "run watch": lambda x: mo.run(SCENARIO, watch=x), "run to": lambda x: mo.run(SCENARIO, to=x),
    "plan scenario": mo.plan,
    **{f"plan {name}": lambda x, name=name: planned(**{name: x})
       for name in ("objective", "times", "swivels", "margin_rad", "speed_share", "acceleration")},
    "compare solvers": lambda x: mo.compare(x, SCENARIO, 1),
    **{f"compare {name}": lambda x, name=name: mo.compare(["exact"], **{"scenario": SCENARIO, "trials": 1, name: x})
       for name in ("scenario", "trials", "seed", "watch")},
    "load_robot": mo.load_robot, "tool_length": lambda x: mo.load_robot("lwr4", tool_length=x),
    "tool_mass": lambda x: mo.load_robot("lwr4", tool_mass=x), "state": ROBOT.state, "mu_along": ROBOT.mu_along,
    "load_trace": mo.load_trace, "Trace columns": mo.Trace,
    "Trace meta": lambda x: mo.Trace({"a": [1.0]}, x), "between": lambda x: TRACE.between(x, 1.0),
    "head": TRACE.head, "select": TRACE.select, "plot": TRACE.plot, "plot name": lambda x: TRACE.plot(name=x),
    "plot beside": lambda x: TRACE.plot(beside=x), "save": TRACE.save,
    "summarize": mo.summarize, "summarize baseline": lambda x: mo.summarize(TRACE, x),
    "summarize phase": lambda x: mo.summarize(TRACE, phase=x),
    "load": mo.Scenario.load, "Scenario.save": SCENARIO.save, "change": lambda x: SCENARIO.change(task=x),
    **{f"Scenario {name}": lambda x, name=name: mo.Scenario(**{name: x}) for name in mo.Scenario.model_fields},
    "preset": lambda x: SCENARIO.change(control={"preset": x}),
    "create": mo.solvers.create, "create setting": lambda x: mo.solvers.create("exact", tolerance=x),
    **{f"problem {name}": lambda x, name=name: problem(**{name: x})
       for name in ("J_tip", "v_tip", "grad_mu", "lower", "c2", "regularization", "q")},
    "residuals x": lambda x: problem().residuals(x), "residuals y": lambda x: problem().residuals(np.zeros(7), x),
    "objective": lambda x: problem().objective(x),
}  # fmt: skip
TAKES_SECONDS = {"compare trials": (7,), "compare seed": (7,), "run watch": (None,)}


@pytest.mark.parametrize("name", CALLS)
def test_a_wrong_argument_is_an_error_of_the_package(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # where "x" can be written
    said = []
    for value in WRONG:
        if any(value is one for one in TAKES_SECONDS.get(name, ())):
            continue
        try:
            CALLS[name](value)
        except mo.MocOptError as error:
            said.append(str(error))
    assert len(said) >= 3
    assert all(0 < len(text) < 2000 for text in said)

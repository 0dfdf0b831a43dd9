"""With any value of an argument, a public function returns a result or raises a MocOptError."""

from collections.abc import Callable

import numpy as np
import pytest

import moc_opt as mo

WRONG = [None, 7, -1, 1.5, "x", "none.toml", b"x", [], {}, object(), np.zeros(3), np.nan, True]
SCENARIO = mo.Scenario(duration_s=0.004, bound_samples=0)
TRACE = mo.Trace({"t_s": [0.0, 0.1], "mu": [0.2, 0.3]}, {"ended": "completed"})
ROBOT = mo.load_robot()
STATE = ROBOT.state(np.array(ROBOT.data.q_home))
PARTS = {
    "J_tip": STATE.J_tip, "J_wrist": STATE.J_wrist, "v_tip": np.zeros(3), "v_wrist": np.zeros(3),
    "grad_mu": STATE.grad_mu, "lower": -ROBOT.v_max, "upper": ROBOT.v_max,
}  # fmt: skip
QP = mo.NullSpaceQP(**PARTS)


def each(call: Callable, *names: str, **usual: object) -> dict[str, Callable]:
    """Return {title: function}. Each function passes its argument to `call` under one of ``names``."""
    return {f"{call.__name__} {name}": lambda x, name=name: call(**{**usual, name: x}) for name in names}


CALLS: dict[str, Callable] = {
    "run scenario": mo.run, **each(mo.run, "solver", "to", scenario=SCENARIO), "plan scenario": mo.plan,
    **each(mo.plan, "times", "swivels", "margin_rad", "speed_share",
           scenario=SCENARIO, refined=False, swivels=16, times=3),
    **each(mo.compare, "solvers", "scenario", "trials", "seed", solvers=["exact"], scenario=SCENARIO, trials=1),
    "load_robot": mo.load_robot, **each(mo.load_robot, "tool_length", "tool_mass"),
    "state": ROBOT.state, "mu_along": ROBOT.mu_along,
    "load_trace": mo.load_trace, "Trace columns": mo.Trace, "Trace meta": lambda x: mo.Trace({"a": [1.0]}, x),
    "between": lambda x: TRACE.between(x, 1.0), "head": TRACE.head, "select": TRACE.select, "plot": TRACE.plot,
    **each(TRACE.plot, "name", "beside"), "save": TRACE.save,
    "summarize": mo.summarize, **each(mo.summarize, "baseline", trace=TRACE),
    "load": mo.Scenario.load, "Scenario.save": SCENARIO.save, "change": lambda x: SCENARIO.change(task=x),
    **each(mo.Scenario, *mo.Scenario.model_fields), "preset": lambda x: SCENARIO.change(control={"preset": x}),
    "create": mo.solvers.create, "create setting": lambda x: mo.solvers.create("exact", tolerance=x),
    **each(mo.NullSpaceQP, "J_tip", "v_tip", "grad_mu", "lower", "c2", "regularization", "q", **PARTS),
    "residuals x": QP.residuals, "residuals y": lambda x: QP.residuals(np.zeros(7), x), "objective": QP.objective,
}  # fmt: skip
TAKES_SECONDS = {
    "compare trials": (7,), "compare seed": (7,), "compare scenario": (None, {}), "run scenario": (None, {}),
}  # fmt: skip


@pytest.mark.parametrize("name", CALLS)
def test_wrong_argument_raises_only_errors_of_the_package(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # some calls write a file
    said = []
    for value in WRONG:
        if any(type(value) is type(one) and value == one for one in TAKES_SECONDS.get(name, ())):
            continue
        try:
            CALLS[name](value)
        except mo.MocOptError as error:
            said.append(str(error))
    assert len(said) >= 3
    assert all(0 < len(text) < 2000 for text in said)

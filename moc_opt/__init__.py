"""moc_opt: manipulability optimization control of a surgical arm.

Each public name is imported at its first use.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from moc_opt import solvers
    from moc_opt.errors import MocOptError
    from moc_opt.planning.plan import Plan
    from moc_opt.qp.problem import NullSpaceQP
    from moc_opt.robots.model import RobotModel, RobotState, load_robot
    from moc_opt.scenario import Scenario, run
    from moc_opt.scenario.planned import plan
    from moc_opt.study.compare import Comparison, compare
    from moc_opt.trace.metrics import summarize
    from moc_opt.trace.trace import Trace, load_trace

__version__ = "1.0.0"

_HOMES = {
    "Comparison": "study.compare", "MocOptError": "errors", "NullSpaceQP": "qp.problem", "Plan": "planning.plan",
    "RobotModel": "robots.model", "RobotState": "robots.model", "Scenario": "scenario",
    "Trace": "trace.trace", "compare": "study.compare", "load_robot": "robots.model",
    "load_trace": "trace.trace", "plan": "scenario.planned", "run": "scenario", "summarize": "trace.metrics",
}  # fmt: skip

__all__ = [
    "Comparison", "MocOptError", "NullSpaceQP", "Plan", "RobotModel", "RobotState", "Scenario", "Trace", "compare",
    "load_robot", "load_trace", "plan", "run", "solvers", "summarize",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name == "solvers":
        return importlib.import_module("moc_opt.solvers")
    if name not in _HOMES:
        raise AttributeError(f"module 'moc_opt' has no attribute {name!r}; public names: {', '.join(__all__)}")
    return getattr(importlib.import_module(f"moc_opt.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return __all__

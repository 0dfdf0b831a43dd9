"""Jobs for the tests of the studies' engine."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from moc_opt.errors import ScenarioError, UnknownNameError
from moc_opt.study.engine import alarm, report


def square(x: float, log: str = "") -> float:
    if log:
        with Path(log).open("a") as file:
            file.write(f"{x}\n")
    return x * x


def die(number: int = signal.SIGSEGV, after_s: float = 0.3) -> None:
    time.sleep(after_s)  # by then the pool knows which process has the job
    os.kill(os.getpid(), number)


def leave(status: int = 3, after_s: float = 0.3) -> None:
    time.sleep(after_s)
    os._exit(status)


def refuse() -> None:
    raise ScenarioError("[task] path = 'knot': no such path")


def throw(error: type[BaseException]) -> None:
    raise error


def fork_and_hang(file: str) -> None:
    child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
    Path(file).write_text(str(child.pid))
    time.sleep(60.0)


def eat_memory() -> int:
    return np.empty(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") * 4 // 5, dtype=np.uint8).size


def arrays(k: int) -> dict[str, Any]:
    return {"k": k, "column": np.arange(float(k))}


def slow_square(x: float) -> float:
    time.sleep(0.7)
    return float(x * x)


def steps(seconds: list[float], limit_s: float) -> int:
    for one in seconds:
        alarm(limit_s)
        time.sleep(one)
        report(one)
    return len(seconds)


def refuse_name() -> None:
    raise UnknownNameError("solver", "osqq", ["osqp"])


class NoWayBack:  # can be pickled, but not unpickled
    def __reduce__(self) -> Any:
        return os.path.join, (1, 2)


def odd_result() -> Any:
    return lambda: None

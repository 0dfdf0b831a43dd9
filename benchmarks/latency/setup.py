"""Set-up, in processes of its own: `import moc_opt`, and the first torque of a new process."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]

IMPORT = """
from time import perf_counter
begin = perf_counter()
import moc_opt
print('{"import_s": %r}' % (perf_counter() - begin))
"""

FIRST_TICK = """
from time import perf_counter
begin = perf_counter()
import moc_opt as mo
import numpy as np
from moc_opt.control import Controller, ControlSettings
loaded = perf_counter()
robot = mo.load_robot()
controller = Controller(robot, ControlSettings(), mo.solvers.create("exact"))
state = robot.state(robot.data.q_home)
tip_ref = np.array([state.tip, np.zeros(3), np.zeros(3)])
trocar = np.array([state.tip - 0.15 * state.tool_direction, np.zeros(3)])
built = perf_counter()
controller.start(state, tip_ref, trocar)
controller.tick(state, tip_ref, trocar)
done = perf_counter()
print('{"first_tick_s": %r, "libraries_s": %r, "model_s": %r, "start_and_tick_s": %r}' % (
    done - begin, loaded - begin, built - loaded, done - built))
"""


def setup_times(processes: int, advance: Callable[[str], None]) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return the medians [s] over fresh processes, and a row for each; one more comes first and fills the caches.

    ``import_s`` and ``first_tick_s`` count from the first line of the program; ``*_process_s`` are whole processes,
    the interpreter's own start and end included.
    """
    rows: list[dict[str, Any]] = []
    if processes == 0:
        return {}, rows
    for turn in range(1 + processes):
        for name, program in (("import", IMPORT), ("first_tick", FIRST_TICK)):
            begin = perf_counter()
            done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=ROOT)
            values = {**json.loads(done.stdout), f"{name}_process_s": perf_counter() - begin}
            advance(f"{name} in a new process")
            if turn:
                rows.append({"part": "setup", "name": name, "round": turn, **values})
    names = dict.fromkeys(key for row in rows for key in row if key.endswith("_s"))
    found = {key: float(np.median([row[key] for row in rows if key in row])) for key in names}
    return {"moc_opt": found}, rows

"""Write a replay and a manipulability map of MOC beside DCAC, as two HTML files.

python examples/replay.py [FOLDER]
"""

import sys
from pathlib import Path

import moc_opt as mo
from moc_opt.planning.swivel_map import manipulability_map
from moc_opt.report.map_page import add_map
from moc_opt.report.page import Page
from moc_opt.report.replay import Replay

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "results/replay")
trial = mo.Scenario(start={"swivel": 0.15}, bound_samples=60)
runs = {
    "MOC, exact": mo.run(trial),
    "MOC, rnn-printed": mo.run(trial.change(solver={"name": "rnn-printed", "settings": {}})),
    "DCAC (same gains)": mo.run(trial.change(control={"law": "dcac"})),
}
robot = mo.load_robot(trial.robot.name)
pair = {name: runs[name] for name in ("MOC, exact", "DCAC (same gains)")}
print(Replay(pair, robot).save(folder / "replay.html"))

page = Page("Where there was manipulability to gain", "one circle, three controllers")
add_map(page, manipulability_map(robot, runs))
print(page.save(folder / "map.html"))

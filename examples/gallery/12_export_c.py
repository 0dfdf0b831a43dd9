"""
The controller as C
===================

Write the controller and the safety filter of a scenario as C code, which allocates no memory.
"""

import tempfile
from pathlib import Path

import moc_opt as mo
from moc_opt.export import export_scenario

with tempfile.TemporaryDirectory() as folder:
    export_scenario(mo.Scenario(), folder)
    for path in sorted(Path(folder).iterdir()):
        print(f"{path.name:24s} {len(path.read_text().splitlines()):6d} lines")

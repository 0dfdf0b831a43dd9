"""Benchmarks: one command a file, its room beside it; `common` is what they share.

Timings are of one thread, so the libraries are told so before they load.
"""

import os
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"):
    os.environ.setdefault(_name, "1")

# So that `python -m benchmarks.NAME` finds the maintainers' commands too. Imports name their folder.
__path__.append(str(Path(__file__).with_name("maintenance")))

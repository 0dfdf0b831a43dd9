"""Studies that run in a checkout: every file is a command, ``python -m benchmarks.NAME``. `moc_opt.study` runs them.

Times are measured on one thread, so numerical libraries are limited to one thread before they load.
"""

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"):
    os.environ.setdefault(_name, "1")


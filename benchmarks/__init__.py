"""Studies that need a checkout: ``python -m benchmarks.NAME`` runs one.

The limit of one thread is set here, because numerical libraries read it when they load.
"""

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"):
    os.environ.setdefault(_name, "1")

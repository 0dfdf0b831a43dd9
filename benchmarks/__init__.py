"""Studies of a checkout: one command a file, ``python -m benchmarks.NAME``, on the engine of `moc_opt.study`.

Timings are of one thread, so the libraries are told so before they load.
"""

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"):
    os.environ.setdefault(_name, "1")


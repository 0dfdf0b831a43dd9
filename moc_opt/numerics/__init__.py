"""How small dense algebra is compiled: numba's entry points, and kernels that know no robot.

Read first: ``cache`` (``njit`` with a cache that no edit makes wrong), ``compiled`` (how a kernel is entered without
numba's checks at each call) and ``dense`` (products, solves). ``arrays`` makes an array read-only. Imports nothing of
ours; every room with kernels imports it.
"""

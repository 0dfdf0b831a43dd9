"""How small dense algebra is compiled: numba's entry points, and kernels that know no robot.

Read first: ``cache`` (``njit`` with a cache that no edit makes wrong), ``compiled`` (how a kernel is entered without
numba's checks at each call) and ``dense`` (products, solves). ``arrays`` has the type of all numbers and makes an
array read-only: it needs numpy alone, and every room may import it. Imports nothing of ours; every room with kernels
imports it.
"""

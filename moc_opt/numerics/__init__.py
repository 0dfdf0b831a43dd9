"""Compiled small dense algebra: numba's entry points, and kernels independent of any robot.

Read first: ``cache`` (``njit`` with a cache that no edit makes wrong), ``compiled`` (calls a kernel without
numba's checks of its arguments) and ``dense`` (products, solves). ``arrays`` has the type of all numbers and makes an
array read-only: it needs numpy alone, and every room may import it. Imports nothing of ours; every room with kernels
imports it.
"""

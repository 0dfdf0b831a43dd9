"""How small dense algebra is compiled: numba's entry points, and kernels that know no robot.

Read first: ``compiled`` (how a kernel is entered without numba's checks at each call) and ``dense``
(products, solves). ``simd`` gives kernels values of eight numbers; docs/speed.md has what each is worth.
Imports nothing of ours; model, control, solvers and sim import it.
"""

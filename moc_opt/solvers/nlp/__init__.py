"""One control period as a nonlinear program: ``nlp`` has mu itself in the cost instead of its gradient.

Its solvers ``nlp-sqp``, ``nlp-ipopt`` and ``nlp-fatrop`` are given the kinematics as CasADi functions, and
answer another problem than the linear one: the residuals of the linear one do not verify them
(docs/solvers.md).
"""

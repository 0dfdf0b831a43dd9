"""``exact``: the subproblem's optimum by elimination, without iterating towards a tolerance.

Read first: ``solver`` (settings, session, what a user calls), then ``elimination`` (rank, free columns, the
closed form for one freedom); ``polytope`` and ``projector`` answer with several freedoms. docs/method.md has
the mathematics.
"""

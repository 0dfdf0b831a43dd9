"""Recurrent neural networks as solvers.

``projection`` holds the paper's, as ``rnn`` (consistent sign, state of its own) and as ``rnn-printed``
(equation (2) to the letter). A network is a solver like any other: see ``moc_opt.solvers.base``.
"""

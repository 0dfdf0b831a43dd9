"""The findings on every arm: what `python -m benchmarks.robots` is made of.

``parts`` runs one trial and reads the rows, ``tables``, ``first_screen`` and ``report`` show them.
"""

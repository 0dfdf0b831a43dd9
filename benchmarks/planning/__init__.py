"""How much manipulability a path holds: what `python -m benchmarks.plan` is made of.

``parts`` computes, one function a part; ``goals`` says what is reached; ``tables`` and ``first_screen`` show it, and
``page`` writes docs/planning.md.
"""

"""Taking an arm into use: a vendor's URDF becomes a robot file, and a table says what holds for an arm.

Read first: ``new`` (URDF in, commented TOML and small URDF out) and ``check`` (freedoms, reach, limits, gains,
masses, and a verdict). ``vendor`` makes one chain (``tree``) of what a vendor wrote, ``bodies`` and ``limits`` mend
its numbers, ``shaft`` places tool and wrist point, ``home`` searches a pose to begin with, ``toml`` writes the
file, ``rates`` compares gains with inertia, ``command`` is the command line. Imports scenario, so that an arm is
judged by the task it will do; the command line alone imports this room.
"""

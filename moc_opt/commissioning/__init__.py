"""Commissioning an arm: make a robot file from a vendor's URDF, and check an arm.

Read first: ``new`` (URDF in, commented TOML and small URDF out) and ``check`` (freedoms, reach, limits, gains,
masses, and a verdict). ``vendor`` makes one chain (``tree``) of a vendor's URDF, ``bodies`` and ``limits`` correct
its numbers, ``shaft`` places tool and wrist point, ``home`` searches a pose to begin with, ``toml`` writes the
file, ``rates`` compares gains with inertia, ``command`` is the command line. Imports scenario, so that an arm is
judged by the task it will do; the command line alone imports this room.
"""

"""Adapters of QP libraries, one file each.

Read first: ``session`` (what all of them share), then ``piqp``, a short one. ``qpsolvers`` takes any library that it
finds, ``casadi_conic`` those of CasADi. ``buffers`` copies a subproblem into a library's arrays in one compiled call.
A library is imported when its solver is made: ``registry`` loads the file then.
"""

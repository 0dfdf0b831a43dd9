"""Taking an arm into use: what its task leaves it, and a pose to begin with.

Read first: ``home`` (searches a pose away from limits and singularities, with some manipulability to gain) and
``freedoms`` (how many freedoms tip and shaft leave, and which are idle). Imports scenario, so that an arm is judged by
the task it will do; the command line alone imports it.
"""

"""A study runs independent trials in other processes, and writes a table and a page of their results.

Read in this order: ``trials`` (runs a trial and makes one row of results), ``engine`` (processes, time limits,
crashes), ``kept`` (finished jobs on disk), ``results`` (the table of rows), ``statistics`` (means and changes with
intervals), ``show`` (the report), ``command`` (options and files), ``timing`` (the clock and the machine's load).
``compare`` is the study behind ``mo.compare``, and ``solvers`` is the study behind ``moc-opt solvers``.
docs/extending.md shows a study of 20 lines.
"""

from moc_opt.study.engine import Failed, Job, run
from moc_opt.study.kept import Kept

__all__ = ["Failed", "Job", "Kept", "run"]

"""Studies: many trials, each a function of a scenario and a seed, done in other processes and kept.

Read first: ``engine`` (does jobs: processes, time limits, crashes), then ``kept`` (what was finished stays) and
``statistics`` (means and changes with their intervals). docs/extending.md shows a study of 20 lines.
"""

from moc_opt.study.engine import Failed, Job, each, run
from moc_opt.study.kept import Kept

__all__ = ["Failed", "Job", "Kept", "each", "run"]

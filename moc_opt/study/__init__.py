"""Studies of independent trials in worker processes. docs/extending.md shows a study of 20 lines."""

from moc_opt.study.engine import Failed, Job, run
from moc_opt.study.kept import Kept

__all__ = ["Failed", "Job", "Kept", "run"]

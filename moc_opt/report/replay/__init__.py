"""A run in 3-D, in one HTML file that opens by itself: ``Replay({"exact": trace}, robot).save("replay.html")``."""

from moc_opt.report.replay.page import Replay
from moc_opt.report.runs import robot_of

__all__ = ["Replay", "robot_of"]

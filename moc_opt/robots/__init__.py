"""Robots: arms as data, models of arms, and inverse kinematics."""

from moc_opt.robots.loader import RobotData, about, available_robots, load_data

__all__ = ["RobotData", "about", "available_robots", "load_data"]

"""Robots as plain data: one URDF and one TOML file each."""

from moc_opt.robots.loader import RobotData, available_robots, load_data

__all__ = ["RobotData", "available_robots", "load_data"]

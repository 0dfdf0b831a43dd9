"""RobotModel and RobotState: kinematics and dynamics of an arm with its tool."""

"""The controller's model of the arm: kinematics and dynamics of a robot with its tool.

Read first: ``robot_model`` (``load_robot``, ``RobotModel.state(q, v)``) and ``robot_state`` (what a state
holds). ``kinematics_kernels``, ``dynamics_kernels`` and ``shaft_kernels`` are compiled, ``symbolic`` holds the
same as CasADi functions, ``inverse_kinematics`` finds a pose for a given tip, ``frames`` places links for
drawing. Imports robots and numerics; every room that needs an arm may import it, but solvers, sim and trace may
not. Nothing is loaded here: pinocchio and numba load with the module that needs them.
"""

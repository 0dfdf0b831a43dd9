"""Types of the extension module. The argument tables in python*.c and plant.c give the shapes of the arrays."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

OK: int
INFEASIBLE: int
DOUBTFUL: int
UNFINISHED: int
MAX_JOINTS: int

class Arm:
    # A serial chain of 1 to 16 joints. Each row of `joints` is a moc_joint (moc.h).
    def __new__(cls, joints: Array, points: Array, tool: Array, moves: Array, gravity: Array, /) -> Arm: ...
    def terms(self, q: Array, v: Array, /) -> Array: ...  # the packed moc_terms of one state
    def along(self, poses: Array, /) -> tuple[Array, Array, Array]: ...  # tips [m], wrists [m], and mu of many poses
    def tool_pose(self, q: Array, /) -> Array: ...  # the tool's axes x, y, z and its tip [m]
    # Search for a pose with the tip, or tip and wrist, at the target. Return its position error [m] and the pose.
    def nearest_pose(
        self, low: Array, high: Array, target: Array, q: Array, iterations: int, /
    ) -> tuple[float, Array]: ...
    # Fill s, poses and mus (plan_follow). Return the number of samples, and 1 if the curve is closed, else 0.
    def follow_curve(
        self, low: Array, high: Array, target: Array, q: Array, tangent: Array, step: float, s: Array, poses: Array,
        mus: Array, /,
    ) -> tuple[int, int]: ...
    # Move each start to a local maximum of mu, in place. mus gets the maximum, or -1 if no pose was found.
    def ascend(self, low: Array, high: Array, target: Array, starts: Array, mus: Array, /) -> None: ...

def solve_exact(record: Array, tolerance: float, /) -> tuple[int, Array, Array]: ...  # return status, x, y
# Solve many subproblems without the GIL. X, Y and status are filled.
def solve_exact_rows(records: Array, tolerance: float, X: Array, Y: Array, status: Array, /) -> None: ...
# Advance x and y in place. Return the status and the number of steps.
def step_network(
    record: Array, x: Array, y: Array, steps: int, h_x: float, h_y: float, k: float, scale: float, implicit: bool,
    rest: float, /,
) -> tuple[int, int]: ...
def desired_wrist(X: Array, dX: Array, trocar: Array, span: float, /) -> Array: ...  # N_d and dN_d as (2, 3)

class Law:
    # The control law and its memory. `numbers` are the fields of moc_law and moc_supervision.
    def __new__(cls, arm: Arm, **numbers: float | Array) -> Law: ...
    # Reset the memory. Return the packed terms of the arm, and the subproblem.
    def start(self, q: Array, v: Array, tip_ref: Array, trocar: Array, /) -> tuple[Array, Array]: ...
    def load(self, record: Array, Z: Array, /) -> None: ...  # replace the subproblem and the null-space basis
    # Return the residuals of an answer: primal, outside, natural, off, opposite (moc_residuals in shared.h).
    def judge(self, x: Array, /) -> tuple[float, float, float, float, float]: ...
    # Compute levels 1 and 2 (moc_begin). Return the packed terms of the arm, and the subproblem.
    def begin(
        self, q: Array, v: Array, tip_ref: Array, trocar: Array, x_d: Array | None, /
    ) -> tuple[Array, Array]: ...
    # Check the answer and add level 3 (moc_finish). Return the fault, the x that level 3 follows, and tau.
    def finish(self, known: int, claim: int, answer: Array, solve_us: float, /) -> tuple[int, Array, Array]: ...
    # A whole tick with the solver `exact`. Return status, fault, solve time [us], terms, and one array with subproblem,
    # x and y of `exact`, the x that level 3 follows, and tau. If solve_us is NaN, the solve time is measured.
    def step(
        self, q: Array, v: Array, tip_ref: Array, trocar: Array, x_d: Array | None, tolerance: float, solve_us: float,
        /,
    ) -> tuple[int, int, float, Array, Array]: ...
    def set_applied(self, tau: Array, /) -> None: ...  # tell the observer which torque acted last
    def memory(self) -> tuple[int, Array, Array]: ...  # number of rows of Z, Z, and the observer's r [Nm]

REASONS: tuple[str, ...]

class Guard:
    # The safety filter and its memory. `numbers` are the fields of moc_guard.
    def __new__(cls, arm: Arm, **numbers: float | Array) -> Guard: ...
    def start(self, q: Array, v: Array, stamp: int, /) -> None: ...
    # Check a measurement. Return the reason to stop, and the believed q and v.
    def believe(
        self, q: Array, v: Array, stamp: float, applied: Array | None, wrench: Array, trocar: Array | None, /
    ) -> tuple[int, Array, Array]: ...
    # Check the motion and limit tau in place. Return the reason to stop and the number of limited joints.
    def follow(
        self, q: Array, v: Array, record: Array | None, tip: Array | None, tip_ref: Array | None, before: Array,
        tau: Array, /,
    ) -> tuple[int, int]: ...
    def rest(self, before: Array, /) -> Array: ...  # the torque of a stop
    def hold(self, wrench: Array, /) -> Array: ...  # the friction of the brakes in a stop
    # Return the number of refused measurements in a row, and an array (3, 2). Its columns are RCM error and force. Its
    # rows are the mean square, the largest root mean square above the warning, and the tick of the first warning.
    def watched(self) -> tuple[int, Array]: ...

# Write the subproblem into a QP library's buffers. Return False if A has another number of rows.
def load(
    record: Array, five: bool, scale: float, signs: Array, P: Array, p: Array, A: Array, low: Array, high: Array,
    lower: Array, upper: Array, packed: Array, lift: Array, /,
) -> bool: ...
# One step of dynamic programming; see plan_stage in tools.h.
def advance(
    branches: int, q: Array, slack: Array, gain: Array, q_next: Array, slack_next: Array, value_next: Array,
    step: Array, crossing: Array, price: float, sorted: int, reach: float, /,
) -> Array: ...
# Functions of the simulated plant; see plant.c.
def shaft_wrench(
    tip: Array, wrist: Array, twist: Array, origin: Array, com: Array, trocar: Array, elapsed: float,
    stiffness: float, damping: float, wrench: Array, /,
) -> None: ...
def read_encoders(
    q: Array, v: Array, noise: Array, memory: Array, resolution: float, period: float, gain: float, exact: bool,
    reading: Array, /,
) -> None: ...

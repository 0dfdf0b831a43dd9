"""Types of the extension module; the tables of the C files have the shapes."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

OK: int
INFEASIBLE: int
DOUBTFUL: int
UNFINISHED: int
BAD_Q: int
BAD_V: int
MAX_JOINTS: int

class Arm:
    def __new__(cls, joints: Array, points: Array, tool: Array, moves: Array, gravity: Array, /) -> Arm: ...
    # A serial chain of 1 to 16 joints as data; rows of joints are moc_joint. Methods fill their last argument.
    # terms -> status: all terms of one state; along: tip, wrist [m] and mu of many poses; tool_pose: the tool's axes
    # x, y, z and its tip [m]; nearest_pose -> miss [m], follow_curve -> (count, end), ascend (in place): see tools.h.
    def terms(self, q: Array, v: Array, record: Array, /) -> int: ...
    def along(self, poses: Array, tips: Array, wrists: Array, mu: Array, /) -> None: ...
    def tool_pose(self, q: Array, pose: Array, /) -> None: ...
    def nearest_pose(
        self, low: Array, high: Array, target: Array, q: Array, iterations: int, best: Array, /
    ) -> float: ...
    def follow_curve(
        self, low: Array, high: Array, target: Array, q: Array, tangent: Array, step: float, s: Array, poses: Array,
        mus: Array, /,
    ) -> tuple[int, int]: ...
    def ascend(self, low: Array, high: Array, target: Array, starts: Array, mus: Array, /) -> None: ...

# solve_exact -> status; solve_exact_rows: without the lock, NaN where there is no answer; step_network -> (status,
# steps made); desired_wrist: N_d and dN_d (2, 3).
def solve_exact(record: Array, tolerance: float, x: Array, y: Array, /) -> int: ...
def solve_exact_rows(records: Array, tolerance: float, X: Array, Y: Array, status: Array, /) -> None: ...
def step_network(
    record: Array, x: Array, y: Array, steps: int, h_x: float, h_y: float, k: float, scale: float, implicit: bool,
    rest: float, /,
) -> tuple[int, int]: ...
def desired_wrist(X: Array, dX: Array, trocar: Array, span: float, out: Array, /) -> None: ...

class Law:
    def __new__(cls, arm: Arm, **numbers: float | Array) -> Law: ...
    # The law with its memory; numbers: the fields of moc_law and moc_supervision. start forgets all and writes the
    # subproblem into row; load takes another subproblem and null space for this tick; judge -> (primal, outside,
    # natural, off, opposite) of an answer to it, see answer.c; begin: levels 1 and 2, and the
    # subproblem; finish -> fault, x is what the arm follows; step -> (status, fault, us): begin, the exact solver and
    # finish, solve_us NaN or what replaces the clock, out: the subproblem's record, the solver's x and y, the x that
    # the arm follows, tau; set_applied replaces the last torque; memory -> rows of Z, and the observer's estimate [Nm].
    def start(self, record: Array, tip_ref: Array, trocar: Array, row: Array, /) -> None: ...
    def load(self, record: Array, Z: Array, /) -> None: ...
    def judge(self, x: Array, /) -> tuple[float, float, float, float, float]: ...
    def begin(
        self, record: Array, tip_ref: Array, trocar: Array, pull: Array | None, row: Array, /
    ) -> None: ...
    def finish(
        self, known: int, claim: int, answer: Array, solve_us: float, x: Array, tau: Array, /
    ) -> int: ...
    def step(
        self, record: Array, tip_ref: Array, trocar: Array, pull: Array | None, tolerance: float, solve_us: float,
        out: Array, /,
    ) -> tuple[int, int, float]: ...
    def set_applied(self, tau: Array, /) -> None: ...
    def memory(self, Z: Array, external: Array, /) -> int: ...

REASONS: tuple[str, ...]

class Guard:
    def __new__(cls, arm: Arm, **numbers: float | Array) -> Guard: ...
    # The safety filter with its memory; numbers: the fields of moc_guard. believe and follow -> reason (and joints
    # limited); rest: the torque of a damped stop; hold: friction of the brakes in it; watched -> measurements in a row
    # that were not believed, figures: mean squares of RCM error and force, largest roots, ticks of the first warnings.
    def start(self, q: Array, v: Array, stamp: int, /) -> None: ...
    def believe(
        self, q: Array, v: Array, stamp: float, applied: Array | None, wrench: Array, trocar: Array | None,
        believed: Array, /,
    ) -> int: ...
    def follow(
        self, q: Array, v: Array, record: Array | None, tip: Array | None, tip_ref: Array | None, before: Array,
        tau: Array, /,
    ) -> tuple[int, int]: ...
    def rest(self, before: Array, tau: Array, /) -> None: ...
    def hold(self, wrench: Array, friction: Array, /) -> None: ...
    def watched(self, figures: Array, /) -> int: ...

# Whether the subproblem has as many equality rows as these buffers, which hold it then; y6 = lift^T y.
def load(
    record: Array, five: bool, scale: float, signs: Array, P: Array, p: Array, A: Array, low: Array, high: Array,
    lower: Array, upper: Array, packed: Array, lift: Array, /,
) -> bool: ...
# One step of a value function; see tools.h.
def advance(
    branches: int, q: Array, slack: Array, gain: Array, q_next: Array, slack_next: Array, value_next: Array,
    step: Array, crossing: Array, price: float, value: Array, /,
) -> None: ...
# The simulated plant; see plant.c.
def shaft_wrench(
    tip: Array, wrist: Array, twist: Array, origin: Array, com: Array, trocar: Array, elapsed: float,
    stiffness: float, damping: float, wrench: Array, /,
) -> None: ...
def read_encoders(
    q: Array, v: Array, noise: Array, memory: Array, resolution: float, period: float, gain: float, exact: bool,
    reading: Array, /,
) -> None: ...

"""How many floating-point operations a step of the exported controller takes at most.

Every +, -, *, /, comparison and function of math.h on doubles counts as one. Of the generated equations CasADi's
instructions are counted, all of which run at every tick. Of the hand-written files each function below is the longest
way through the C function of the same name, its loops at their constant bounds; ``rows`` of the null space are taken
as n, which no arm has. What runs at a tick in which everything is at its worst at once is then the sum.
"""

from __future__ import annotations

from moc_opt.embedded.symbolic import Tick

SWEEPS = 50
"""of moc_retreat and moc_least_violation, as moc_answer.c and moc_fallback.c define it"""


def dot(m: int) -> int:
    """Count a sum of products."""
    return 2 * m


def all_finite(m: int) -> int:
    """Count a sum of products with zero, and its comparison."""
    return 2 * m + 1


def cholesky(m: int) -> int:
    """Count the factor of (m,m)."""
    return sum(2 * j + 3 + (m - j - 1) * (2 * j + 1) for j in range(m))


def solve_factored(m: int) -> int:
    """Count both triangles."""
    return 2 * m * (m - 1) + 4 * m


def third_level(n: int, rows: int) -> int:
    """Count moc_third_level, observer and torque limit of moc_tick_follow."""
    products = 2 * rows * n * dot(n) // 2 + rows * (rows + 1) * dot(n)
    return 5 * n + products + cholesky(rows) + solve_factored(rows) + 2 * n * rows + 2 + 4 * n


def residual_check(n: int, rows: int) -> int:
    """Count moc_compute_residuals."""
    violations = all_finite(n) + 6 * (dot(n) + 3) + 7 * n
    line = rows * (dot(n) + 2 * n) + dot(n) + 4
    return violations + line + n * (1 + 9 + 3 + 2 + 2 + 4 + 4) + 2 + n * (1 + 5 + 3) + 15


def retreat(n: int, rows: int) -> int:
    """Count moc_retreat with all its sweeps."""
    shortest = n * n * (12 + 2 * rows) + 12 * n + cholesky(n) + solve_factored(n)
    sweep = 1 + n * (1 + 2 + 2 * rows + 4 + 3 * rows + 3)
    return shortest + 2 * n * rows + SWEEPS * sweep + 1 + n * (2 * rows + 5)


def least_violation(n: int) -> int:
    """Count moc_least_violation with all its sweeps."""
    return n * (2 + 12) + 6 * (dot(n) + 1) + SWEEPS * n * (1 + 12 + 4 + 18) + all_finite(n)


def orthonormalise(n: int, rows: int) -> int:
    """Count moc_orthonormalise."""
    return sum(2 * (i * (dot(n) + 2 * n) + dot(n) + 1 + n) for i in range(rows))


def straight_elbow(n: int) -> int:
    """Count moc_eliminate, moc_kernel and moc_singular_answer."""
    pivot = 6 * n * 3 + 4 + 2 + 6 * (1 + 2 * n + 2) + n + 1
    kernel = n * 5 + orthonormalise(n, n)
    inside = n * 7 + 10
    corners = 2 + inside + 2 * n * (4 + 3 + 2 + 5 + 4 + inside) + n * (2 * n - 1) * (4 + 3 + 7 + 6 + inside)
    left_over = 6 * (1 + n * (2 + 5) + 2)
    laid_out = 2 * (dot(n) + 2 * n + dot(n) + 1) + n * 8 + 4
    rest = 8 * n + 2 * left_over + n * (5 + 2 * n + 12) + orthonormalise(n, 2) + laid_out + 6 * n + 2
    return 5 * pivot + kernel + rest + 2 * corners


def guard(n: int, gravity: int, tool_pose: int) -> int:
    """Count moc_guard, moc_motion, moc_replay, moc_incision, moc_safe_step's checks, and what only a stop needs."""
    believed = 1 + n * 10
    incision = tool_pose + 2 * (9 + 2) + 1 + 9 + 32 + 2 * 3 + 4 + 2 * 6
    readings = 2 + 6 * 3 + n * 31 + 12 + 6 + 3 * n + 2 * (2 * n + 6) + 14 + n * 17 + 2
    weighed = n * (dot(n) + 6) + n * 26
    walls = all_finite(n) + n * (4 + 2 * 6 + 12) + gravity + n * 12
    rest = gravity + all_finite(n) + n * 7
    checks = 7 * all_finite(n) + all_finite(6) + 4 * n + 6
    return believed + readings + weighed + incision + 3 * 4 + 5 + walls + rest + checks


def worst_path(tick: Tick) -> dict[str, int]:
    """Count the operations of the longest moc_safe_step by part, and their sum as "in all"."""
    n, rows = tick.n, tick.n if tick.rows else 0
    solves = any(field.name == "x" for field in tick.layout.report)
    parts = {
        "generated equations": tick.tick.n_instructions(),
        "third level": third_level(n, rows),
        "supervisor": residual_check(n, rows) + 12 if solves else 0,
        "fallback": max(retreat(n, rows), least_violation(n)) if solves else 0,
        "straight elbow": straight_elbow(n) if tick.rows else 0,
        "guard": guard(n, tick.gravity.n_instructions(), tick.tool_pose.n_instructions()),
    }
    return {**parts, "in all": sum(parts.values())}

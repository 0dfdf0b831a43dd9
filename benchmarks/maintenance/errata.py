"""What the paper prints and what is computed here: every row of the table with the number that shows it.

    python -m benchmarks.errata [--out docs/errata.md] [--check]

writes docs/errata.md; ``--check`` only says whether the page agrees with the numbers (exit status 1 if not). The
numbers come from 50 seeded poses of the LWR4+ and from two short runs; they carry two significant digits (those of the
runs one), and what is zero but for rounding is written as "below 1e-12", so that any machine computes the same page.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.common import cli
from benchmarks.common.markdown import render
from benchmarks.common.output import write_atomically
from benchmarks.maintenance.errata_numbers import (
    PAPER,
    Arm,
    gains_in_mu,
    idempotence,
    network,
    projectors,
    saddle,
    third_level,
    time_constants,
    torque_of_mu,
    true_lambdas,
)
from moc_opt.control.null_space import null_space

PAGE = Path(__file__).resolve().parents[2] / "docs" / "errata.md"


def number(value: float) -> str:
    """Write two significant digits; rounding errors all alike."""
    if abs(value) < 1e-12:
        return "below 1e-12"
    text = f"{float(f'{value:.2g}'):g}"
    mantissa, _, power = text.partition("e")
    return f"{mantissa}e{int(power)}" if power else text


def span(values: Sequence[float]) -> str:
    """Write the smallest and the largest."""
    low, high = number(min(values)), number(max(values))
    return low if low == high else f"{low} to {high}"


def _projector(arm: Arm) -> str:
    found = [(projectors(s), s) for s in arm.states]
    printed, dynamic, static = ([idempotence(ps[i]) for ps, _ in found] for i in range(3))

    def leak(i: int) -> list[float]:
        """Return the tip acceleration left of that of an unprojected torque."""
        return [
            float(
                np.linalg.norm(s.J_tip @ np.linalg.solve(s.M, ps[i]), 2)
                / np.linalg.norm(s.J_tip @ np.linalg.inv(s.M), 2)
            )
            for ps, s in found
        ]

    return (
        f"&#124;N N - N&#124;/&#124;N&#124; is {span(printed)} as printed, {number(max(dynamic))} (dynamic) and "
        f"{number(max(static))} (static); of the tip acceleration of an unprojected torque the printed one lets "
        f"{span(leak(0))} through, the dynamic one {number(max(leak(1)))}"
    )


def _wrist(arm: Arm) -> str:
    fifth = max(float(np.abs(s.J_wrist[:, 4:]).max()) for s in arm.states)
    least = min(float(np.abs(s.J_wrist[:, :4]).max(axis=0).min()) for s in arm.states)
    return (
        f"shape {arm.states[0].J_wrist.shape}; columns 5, 6 and 7 are {number(fifth)} (their axes meet in the wrist "
        f"centre), each of the others reaches {number(least)} m/rad or more"
    )


def _third(arm: Arm) -> str:
    found = [third_level(s) for s in arm.states]
    shape = tuple(reversed(null_space(arm.states[0].A).shape))
    factor = [float(value) for *_, inner in found for value in np.linalg.eigvalsh(inner) ** 2]
    still = [float(np.abs(s.A @ np.linalg.solve(s.M, N)).max()) for (N, *_), s in zip(found, arm.states, strict=True)]
    return (
        f"printed shape {shape}, which takes no joint vector; with the missing Z appended its "
        f"&#124;N N - N&#124;/&#124;N&#124; is {span([idempotence(P) for _, P, _ in found])} (with the inverse "
        f"{number(max(idempotence(N) for N, *_ in found))}) and its torque is {span(factor)} times the consistent "
        f"one, which accelerates tip and wrist by {number(max(still))} m/s^2 per unit"
    )


def _sign(arm: Arm) -> str:
    problems = [arm.subproblem(s, rho=1e-4, weight=100.0, speed=0.005) for s in arm.states[:8]]
    kept = max(float(network(qp, 10_000, 1.0).max()) for qp in problems)
    lost = min(float(network(qp, 1000, -1.0).min()) for qp in problems)
    return (
        f"after 10000 steps (c0 = c1 = 1, k = 0.5) the consistent sign meets the references to "
        f"{'better than 1e-5' if kept < 1e-5 else number(kept)} m/s; the printed one never comes nearer than "
        f"{number(lost)} m/s"
    )


def _gradient(arm: Arm) -> str:
    values = [np.linalg.eigvalsh(G + G.T) for G in (saddle(arm.subproblem(s)) for s in arm.states)]
    return (
        f"eigenvalues of grad F + grad F^T: the smallest {number(min(float(v[0]) for v in values))} in size, "
        f"the largest {span([float(v[-1]) for v in values])}"
    )


def _clock(arm: Arm) -> str:
    fastest, slowest = time_constants(arm)
    return f"time constants with eps = 1 s: {number(fastest)} s to {number(slowest)} s, against a tick of 0.002 s"


def _act(arm: Arm) -> str:
    gain = gains_in_mu()
    idle = "below 0.1" if abs(gain["rnn-printed"]) < 0.1 else number(gain["rnn-printed"])
    return (
        f"mu's share of the torque is at most {number(torque_of_mu(arm))} Nm; in one second at rest mu changes by "
        f"{idle} % with `rnn-printed`, by about {round(gain['exact'], -1):.0f} % with `exact`"
    )


def _lambda(arm: Arm) -> str:
    found = true_lambdas(arm)
    return (
        f"at the depths of the three virtual tasks the true lambda is {span(found)}, and the published force "
        f"{span([value / PAPER.rcm_lambda for value in found if PAPER.rcm_lambda])} times that of the true one"
    )


def _gains(arm: Arm) -> str:
    tables = arm.robot.data.gains
    parts = [
        f"{name.upper()}: K_X {tables[name]['K_X']:.0f}, K_N {tables[name]['K_N']:.0f} N/m, "
        f"D_X {tables[name]['D_X']:.0f}, D_N {tables[name]['D_N']:.0f} N s/m"
        for name in ("dcac", "moc")
    ]
    return f"{'; '.join(parts)}. `python -m benchmarks.paper` shows every claim with both"


ERRATA = {
    "projector": _projector, "wrist": _wrist, "third": _third, "sign": _sign, "gradient": _gradient, "clock": _clock,
    "act": _act, "lambda": _lambda, "gains": _gains,
}  # fmt: skip
"""Row of benchmarks/templates/errata.md -> the numbers that show it."""


def page(arm: Arm | None = None) -> str:
    """Make docs/errata.md, with numbers computed on the states of an arm."""
    arm = Arm.load() if arm is None else arm
    return render("errata.md", poses=len(arm.states), **{name: shown(arm) for name, shown in ERRATA.items()})


def write_page(given: argparse.Namespace) -> int:
    """Write the page, or with ``--check`` compare; status 1 where it does not agree."""
    text = page()
    if not given.check:
        write_atomically(given.out, text.encode())
        return 0
    if given.out.exists() and given.out.read_text(encoding="utf-8") == text:
        return 0
    print(f"{given.out} does not agree with the numbers: python -m benchmarks.errata writes it anew", file=sys.stderr)
    return 1


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the page, or check it; see `cli.run` for the exit status."""
    options = argparse.ArgumentParser(prog="python -m benchmarks.errata", description="Write docs/errata.md.")
    options.add_argument("--out", type=Path, default=PAGE, help="where the page is")
    options.add_argument("--check", action="store_true", help="compare only")
    return cli.run(options, write_page, arguments)


if __name__ == "__main__":
    sys.exit(main())

"""Other people's controllers at the same job: one file and one line of ``PEERS`` a library.

The job of one tick: tip on its reference, wrist on the line through the trocar, joint speeds within their limits,
and what freedom is left up the gradient of the manipulability. Every peer gets the data of the same arm, its fastest
solver, hard equalities where it takes them, and our compiled gradient where it has none of its own.
"""

from __future__ import annotations

import importlib
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

from benchmarks.baselines.base import Peer
from moc_opt.errors import UnknownNameError
from moc_opt.model.robot_model import RobotModel

PATIENCE_S = 60.0
ROOT = Path(__file__).resolve().parents[2]


class Library(NamedTuple):
    """Where a peer is found and how it is installed."""

    module: str
    factory: str
    package: str
    install: str
    extra: bool = True
    """Whether the extra ``peers``, and so ``make``, installs it; others were built by hand where they are listed."""


PEERS = {
    "tsid": Library(
        "benchmarks.baselines.tsid",
        "TSID",
        "tsid",
        "build it from source against the installed pinocchio; its wheel on PyPI lacks the library it links to",
        extra=False,
    ),
    "pink": Library("benchmarks.baselines.pink", "Pink", "pink", "pip install pin-pink"),
    "pink-trimmed": Library("benchmarks.baselines.pink", "PinkTrimmed", "pink", "pip install pin-pink"),
    "mink": Library("benchmarks.baselines.mink", "Mink", "mink", "pip install mink"),
}
"""Name -> where it is."""


def create(name: str, robot: RobotModel, period_s: float) -> Peer:
    """Set a peer up on the arm of ``robot``, for ticks of ``period_s``.

    Raises:
        UnknownNameError: there is no such peer.
    """
    if name not in PEERS:
        raise UnknownNameError("peer", name, PEERS)
    library = PEERS[name]
    factory = getattr(importlib.import_module(library.module), library.factory)
    peer: Peer = factory(robot, period_s)
    return peer


def missing(name: str) -> str | None:
    """Say why a peer cannot run here; None when it can.

    It is tried in a process of its own: a wheel that was built against another pinocchio ends the process that
    loads it, and that must not be the benchmark's.
    """
    library = PEERS[name]
    if find_spec(library.package) is None:
        return f"package {library.package!r} is not installed: {library.install}"
    command = [sys.executable, "-W", "ignore", "-m", "benchmarks.baselines.check", name]
    try:
        tried = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, cwd=ROOT)
    except subprocess.TimeoutExpired:
        return f"it did not do its job within {PATIENCE_S:g} s"
    if tried.returncode == 0:
        return None
    said = tried.stderr.strip().splitlines() or [f"its process ended with status {tried.returncode}"]
    return said[-1]

"""Other people's controllers at the same job: one file and one line of ``PEERS`` a library.

The job of one tick: tip on its reference, wrist on the line through the trocar, joint speeds within their limits,
and what freedom is left up the gradient of the manipulability. Every peer gets the data of the same arm, its fastest
solver, hard equalities where it takes them, and our compiled gradient where it has none of its own.
"""

from __future__ import annotations

import importlib
from importlib.util import find_spec
from typing import NamedTuple

from benchmarks.baselines import job
from moc_opt.errors import UnknownNameError
from moc_opt.robots.model import RobotModel, load_robot
from moc_opt.study import Failed, Job, run

PATIENCE_S = 60.0


class Library(NamedTuple):
    """Which class drives a library, by which package it is found, and how that is installed."""

    module: str
    factory: str
    package: str
    install: str

    @property
    def made(self) -> bool:
        """Whether `make` installs it, by the extra ``peers``; others are built by hand."""
        return self.install.startswith("pip install ")


PEERS = {
    "tsid": Library("tsid", "TSID", "tsid", "build it from source against the installed pinocchio; its wheel on PyPI "
                    "lacks the library it links to"),
    "pink": Library("pink", "Pink", "pink", "pip install pin-pink"),
    "pink-trimmed": Library("pink", "PinkTrimmed", "pink", "pip install pin-pink"),
    "mink": Library("mink", "Mink", "mink", "pip install mink"),
}  # fmt: skip


def create(name: str, robot: RobotModel, period_s: float) -> job.Peer:
    """Set a peer up on the arm of ``robot``, for ticks of ``period_s``.

    Raises:
        UnknownNameError: there is no such peer.
    """
    if name not in PEERS:
        raise UnknownNameError("peer", name, PEERS)
    library = PEERS[name]
    module = importlib.import_module(f"benchmarks.baselines.{library.module}")
    peer: job.Peer = getattr(module, library.factory)(robot, period_s)
    return peer


def missing(name: str) -> str | None:
    """Say why a peer cannot run here; None when it can.

    It is tried in a process of its own: a wheel that was built against another pinocchio ends the process that
    loads it, and that must not be the benchmark's.
    """
    library = PEERS[name]
    if find_spec(library.package) is None:
        return f"package {library.package!r} is not installed: {library.install}"
    (found,) = run([Job(check, (name,), PATIENCE_S)], workers=1)
    return str(found) if isinstance(found, Failed) else found


def check(name: str) -> str | None:
    """Let a peer do its job on the default arm, and say how it failed; None when it did not."""
    robot = load_robot()
    work = job.job(robot)
    return job.verdict(job.perform(create(name, robot, job.PERIOD_S), robot, work)[0], robot, work).failure

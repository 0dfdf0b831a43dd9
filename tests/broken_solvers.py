"""A plug-in with solvers that misbehave. Worker processes import it from the disk."""

from collections.abc import Mapping
from pathlib import Path

MODULE = """
import os, signal
from dataclasses import dataclass
from moc_opt.solvers.exact import Exact

@dataclass(frozen=True)
class Base:
    at: int = 3  # index, in a session, of the problem at which the solver misbehaves

    def supports(self, qp): return None
    def start(self, qp): return Session(self, Exact().start(qp))

class Session:
    def __init__(self, settings, exact):
        self.settings, self.exact, self.count = settings, exact, 0

    def solve(self, qp):
        if self.count == self.settings.at:
            self.settings.misbehave()
        self.count += 1
        return self.exact.solve(qp)

class Hangs(Base):
    name = "hangs"
    def misbehave(self):
        while True: pass

class Stuck(Hangs):
    name = "stuck"
    def start(self, qp): self.misbehave()

class Crashes(Base):
    name = "crashes"
    def misbehave(self): os.kill(os.getpid(), signal.SIGSEGV)

class Raises(Base):
    name = "raises"
    def misbehave(self): return 1 / 0

class Quits(Base):
    name = "quits"
    def supports(self, qp): raise SystemExit("no more")

class Once(Raises):
    name = "once"
    started = []
    def start(self, qp):
        self.started.append(1)
        if len(self.started) > 1:
            raise RuntimeError("only once")
        return super().start(qp)

class Untyped(Base):
    name = "untyped"
    def start(self, qp): return Untidy()

class Untidy:
    def solve(self, qp): return None
"""
NAMES = ("hangs", "stuck", "crashes", "raises", "quits", "once", "untyped")
POINTS = {name: name.capitalize() for name in NAMES}


def install(
    folder: Path, package: str = "broken_solvers_plugin", source: str = MODULE, points: Mapping[str, str] = POINTS
) -> Path:
    """Write a plug-in as pip would install it. `points` maps the name of each solver to its class."""
    info = folder / f"{package}-1.0.dist-info"
    info.mkdir(parents=True)
    (folder / f"{package}.py").write_text(source)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
    lines = [f"{name} = {package}:{made}" for name, made in points.items()]
    (info / "entry_points.txt").write_text("\n".join(["[moc_opt.solvers]", *lines, ""]))
    return folder

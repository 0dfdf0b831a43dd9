"""Names and options as an attacker writes them: what leaves a comment, a tag or a folder, and what writes or loads."""

from __future__ import annotations

import io
import os
import re
from contextlib import chdir, redirect_stdout
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import hypothesis.strategies as st
import numpy as np

from benchmarks.latency.solve import random_problems
from benchmarks.reliability.fuzz_case import ARM_TOML, ARM_URDF, Kind, Verdict, Wrong, arm, folder, refused
from benchmarks.reliability.fuzz_inputs import junk, numbers
from moc_opt.control import ControlSettings
from moc_opt.embedded import source
from moc_opt.embedded.support import TickSpec
from moc_opt.embedded.symbolic import Tick, build_tick
from moc_opt.errors import MocOptError, RobotError
from moc_opt.inputs import names as rule
from moc_opt.model.robot_model import RobotModel, load_robot
from moc_opt.qp.problem import NullSpaceQP
from moc_opt.report.page import Page
from moc_opt.report.tables import Column, Table
from moc_opt.scenario import Scenario
from moc_opt.solvers import available, create
from moc_opt.solvers.exact.solver import Exact
from moc_opt.solvers.options import ALLOWED

pieces = st.sampled_from([
    "*/", "/*", "//", "*\\\n/", "*??/\n/", "??/", "\\", "\\\n", "\n", "\r", "\x0b", "\x00", '"', "'", "<", ">", "&",
    "<script>alert(1)</script>", "</script>", "<img src=x onerror=alert(1)>", "&lt;", "&#60;", "`", "$title", "${n}",
    "../", "..", "/", "..\\", "~", "system(0);", "#include </etc/passwd>", '_Pragma("x")', "\u2028", "\u202e", "é",
    "</td>", "%s", "joint", "link_1", "a", " ", ".", ":", "-", "+", "_", "1", "[red]", "\x1b[2J", "a" * 101,
])  # fmt: skip
hostile_names = st.one_of(
    st.lists(pieces, min_size=1, max_size=4).map("".join), st.text(max_size=8),
    st.from_regex(r"[A-Za-z0-9_ .:+/-]{1,12}", fullmatch=True),
)  # fmt: skip
PLACES = ("joint", "link", "robot", "gains", "scenario", "solver", "task", "bumped")

names = st.tuples(st.sampled_from(PLACES), hostile_names)
"""Where a name stands, and the name."""

ABSENT = ("cvxopt", "ecos", "gurobi", "qpalm", "qpoases", "qpswift")
WRITING = st.sampled_from([
    "log_csv_filename", "write_data_filename", "log_file", "solution_file", "write_model_file", "dump", "dump_dir",
    "jit", "dump_in", "compiler", "verbose", "linear_solver", "backend", "initvals", "problem", "solver", "print_time",
    "factorized", "eps_bas", "__class__", "kinematics",
])  # fmt: skip


@st.composite
def options(draw: st.DrawFn) -> tuple[str, dict[str, Any]]:
    """Draw a solver, and options for the library behind it: half of the time none but those that may be set."""
    solver = draw(st.sampled_from([name for name in ALLOWED if not name.endswith(ABSENT)]))
    own = st.sampled_from(sorted(ALLOWED[solver]))
    values = st.one_of(st.floats(0.0, 1.0), st.booleans(), st.integers(0, 50))
    if draw(st.booleans()):
        other = st.sampled_from(sorted(set().union(*ALLOWED.values())))
        own = st.one_of(own, WRITING, other, st.text(max_size=8))
        values = st.one_of(values, st.sampled_from(["x.csv", "/tmp/x", "mkl"]), numbers, junk)
    return solver, draw(st.dictionaries(own, values, min_size=1, max_size=3))


def name(case: tuple[str, str]) -> Verdict:
    """Check a name: refused where it is read, or harmless; and no generator relies on that it was read by us."""
    place, text = case
    _comments(text)
    _pages(text)
    _files(text)
    try:
        robot = _read(place, text)
    except MocOptError as error:
        return refused(error)
    if not re.fullmatch(r"[A-Za-z0-9_](?:[A-Za-z0-9_ .:+/-]{0,98}[A-Za-z0-9_])?", text):
        raise Wrong(f"{text!r} was taken for a name of a {place}")
    if robot is not None and place in ("joint", "link"):
        robot.state(robot.data.q_home)
    return "accepted"


def option(case: tuple[str, dict[str, Any]]) -> Verdict:
    """Check options: refused by name, or the solver answers; and the current folder stays empty."""
    solver, given = case
    if available().get(solver, "absent") is not None:
        return "refused"
    brief: dict[str, Any] = {key: 20 for key in ("max_iter", "max_iters", "iter_limit") if key in ALLOWED[solver]}
    brief |= {"time_limit": 0.05} if solver.endswith("highs") else {}
    qp = _problem()
    with folder() as where, chdir(where), redirect_stdout(io.StringIO()):
        try:
            session = create(solver, options={**given, **brief}).start(qp)
        except MocOptError as error:
            return refused(error, any(repr(key)[1:-1][:40] in str(error) for key in given))
        else:
            if session.solve(qp).x.shape != (qp.n,):
                raise Wrong("no answer")
        finally:
            if os.listdir(where):
                raise Wrong(f"{solver} with {given} wrote {os.listdir(where)}")
    if not set(given) <= ALLOWED[solver]:
        raise Wrong(f"{sorted(set(given) - ALLOWED[solver])} passed")
    return "accepted"


def _read(place: str, text: str) -> RobotModel | None:
    """Read the name where it stands; None where there is no robot in it."""
    if place == "scenario":
        Scenario(name=text)
    elif place == "solver":
        Scenario(solver={"name": text, "settings": {text: 1}})
    elif place == "task":
        Scenario(task={"path": text, "sizes": {text: 1.0}})
    elif place == "bumped":
        Scenario(faults={"bump_N": 1.0, "bump_link": text})
    else:
        return _arm(place, text)
    return None


def _arm(place: str, text: str) -> RobotModel:
    toml, urdf = ARM_TOML, ARM_URDF
    try:
        quoted = quoteattr(text)
        (quoted + text).encode("utf-8")
    except UnicodeEncodeError as error:
        raise RobotError(f"{text!r} cannot stand in a file") from error
    basic = '"' + "".join(f"\\U{ord(c):08x}" for c in text) + '"'  # any text as TOML writes it
    if place == "joint":
        urdf = urdf.replace('"joint_3"', quoted)
    elif place == "link":
        urdf = urdf.replace('"link_3"', quoted)
    elif place == "robot":
        toml = toml.replace('name = "lwr4"', f"name = {basic}")
    else:
        toml = toml.replace("[gains.dcac]", f"[gains.{basic}]")
    with arm(toml, urdf) as path:
        return load_robot(path)


@cache
def _tick() -> Tick:
    return build_tick(TickSpec(load_robot(), ControlSettings(), Exact(), 0.002))


def _comments(text: str) -> None:
    """Check that the header's code is the same whatever the comments hold."""
    plain = code_of(source.header(_tick(), "a title", {"joints": "a, b"}))
    if code_of(source.header(_tick(), text, {text: text, "joints": f"a, {text}"})) != plain:
        raise Wrong(f"{text!r} leaves the comment")


def code_of(text: str) -> str:
    """Return what a C99 compiler is left with: trigraphs and joined lines resolved, comments taken out."""
    for mark, meant in zip("=/'()!<>-", "#\\^[]|{}~", strict=True):
        text = text.replace(f"??{mark}", meant)
    text = re.sub(r"\\[ \t]*(\r\n|\r|\n)", "", text)
    return re.sub(r"/\*.*?\*/|//[^\r\n]*|/\*.*", " ", text, flags=re.DOTALL)


class _Tags(HTMLParser):
    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: list[tuple[str, tuple[str, ...]]] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, tuple(key for key, _ in attrs)))


def _page(text: str) -> list[tuple[str, tuple[str, ...]]]:
    page = Page(text, text)
    page.headline(text)
    page.section(text)
    page.table(Table(text, [Column("name", text, help=text)], [{"name": text}]))
    page.environment({"solver": text, "deeper": {text: text}})
    return _Tags(page.html()).found


@cache
def _vocabulary() -> frozenset[tuple[str, tuple[str, ...]]]:
    return frozenset(tag for text in ("", "a", "a `b`\n\nc", "long " * 20, "1.5") for tag in _page(text))


def _pages(text: str) -> None:
    """Check that a page has no tag or attribute but those of pages about plain texts, and no more scripts."""
    found = _page(text)
    odd = {tag for tag in found if tag not in _vocabulary()}
    if odd or [tag for tag, _ in found].count("script") != [tag for tag, _ in _page("a")].count("script"):
        raise Wrong(f"{text!r} makes tags: {sorted(odd)}")


def _files(text: str) -> None:
    stem = rule.file_stem(text)
    if Path(stem).name != stem or stem.startswith(".") or not stem.isascii() or not 0 < len(stem) <= rule.MAX_LENGTH:
        raise Wrong(f"{text!r} would make the file {stem!r}")


@cache
def _problem() -> NullSpaceQP:
    return random_problems(7, 1, np.random.default_rng(0))[0]


KINDS = {"name": Kind(name, names), "option": Kind(option, options())}

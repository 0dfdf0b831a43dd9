"""Names from outside: what is one, and what becomes of any other text in a comment, a file's name or a page."""

import html
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import hypothesis.strategies as st
import pytest
from hypothesis import example, given, settings

from benchmarks.reliability.fuzz_names import code_of, hostile_names
from moc_opt.control import ControlSettings
from moc_opt.embedded.export import c_files
from moc_opt.embedded.support import TickSpec
from moc_opt.errors import RobotError, ScenarioError, SolverError
from moc_opt.inputs import names
from moc_opt.model.robot_model import RobotModel, load_robot
from moc_opt.robots import loader
from moc_opt.scenario import Scenario
from moc_opt.solvers import plugins
from moc_opt.solvers.exact.solver import Exact

FOLDER = Path(loader.__file__).parent
GOOD = [
    "a", "lwr4", "joint_1", "qpsolvers:daqp", "nlp-sqp", "exact+fail", "circle/0", "all of it", "_", "A1.b", "x" * 100,
]  # fmt: skip
BAD = [
    "", " ", "a ", " a", ".", "..", ".a", "a.", "a..b", "-a", "/a", "a/", "../a", "a\n", "a\nb", "a\\", "a??/", "*/",
    "/*", "a*b", 'a"b', "a'b", "a<b", "a>b", "a&b", "a;b", "a$b", "a`b", "a%b", "{a}", "[a]", "a=b", "é", "a\u2028b",
    "１", "\x00", "\x1b[2J", "x" * 101, "a\tb",
]  # fmt: skip


def test_what_a_name_is():
    for text in GOOD:
        assert names.checked(text) == text
    for text in BAD:
        with pytest.raises(ValueError, match="is no name: a name has 1 to 100 characters"):
            names.checked(text)
    assert not names.is_name(3)


@pytest.mark.parametrize("bad", ["a\\", "*/", "a\nb", "<b>", "../x", ""])
def test_every_place_where_a_name_is_read_checks_it(bad):
    for table in (
        {"name": bad}, {"solver": {"name": bad}}, {"task": {"path": bad}}, {"faults": {"bump_link": bad}},
        {"task": {"sizes": {bad: 1.0}}}, {"solver": {"settings": {bad: 1.0}}},
    ):  # fmt: skip
        with pytest.raises(ScenarioError, match="is no name"):
            Scenario(**table)
    data = load_robot().data
    for change in ({"name": bad}, {"joint_names": (bad, *data.joint_names[1:])}):
        with pytest.raises(RobotError, match="is no name"):
            replace(data, **change)
    with pytest.raises(SolverError, match="rename it"):
        plugins.factory_of(bad, [plugins.EntryPoint(bad, "math:sqrt", plugins.GROUP)])


PIECES = ["*/", "*\\\n/", "*??/\n/", "\\", "??/", "\n", "/*", "//", "*", "/", "?", "a", '"', "int x;", "\r", "é"]


@given(st.one_of(hostile_names, st.lists(st.sampled_from(PIECES), max_size=6).map("".join), st.text()))
@example("*\\\n/ int evil; /*")
@example("*??/\n/ int evil; /*")
@example("*/ int evil; /*")
@settings(max_examples=500, deadline=None, derandomize=True)
def test_no_text_leaves_its_comment(text):
    """Whatever the text: one line, printable ASCII, and no code is left where the comment was."""
    shown = names.in_comment(text)
    assert shown.isascii()
    assert shown.isprintable() or not shown
    assert not set(shown) & set("*?\\")
    assert code_of(f"int a;/* {shown} */int b;").split() == ["int", "a;", "int", "b;"]
    assert code_of(f"int a;/* {shown}*/int b;").split() == ["int", "a;", "int", "b;"]


@given(st.one_of(hostile_names, st.text()))
@settings(max_examples=500, deadline=None, derandomize=True)
def test_any_text_becomes_a_file_of_its_own_folder(text):
    stem = names.file_stem(text)
    assert Path("folder", stem).parent == Path("folder")
    assert stem.isascii()
    assert stem.isprintable()
    assert 0 < len(stem) <= names.MAX_LENGTH
    assert not stem.startswith(".")
    assert names.file_stem(stem) == stem


@given(st.one_of(hostile_names, st.text(st.characters(codec="utf-8", exclude_categories=["Cc"]))))
@settings(max_examples=300, deadline=None, derandomize=True)
def test_markdown_shows_any_text_as_it_is(text):
    """The live page's reader lets HTML through; why a run was stopped may be the text of a foreign exception."""
    shown = names.in_markdown(text)
    assert not set(shown) & set("<>*_`[]{}\\!|~$\"'\n")
    if text.isprintable():
        assert html.unescape(shown) == text


def test_a_solver_that_prints_code_is_only_a_comment(robot):
    """A solver of the user's own may show itself in any way; the header's code stays what it is."""

    class Talks(Exact):
        def __repr__(self):
            return "*/ int evil(void) { return 1; } /* *\\\n/ int worse; *??/\n/ int worst; /*"

    plain = c_files(TickSpec(robot, ControlSettings(), Exact(), 0.002))[1]
    _, texts = c_files(TickSpec(robot, ControlSettings(), Talks(), 0.002))
    assert code_of(texts["moc_tick.h"]) == code_of(plain["moc_tick.h"])
    assert texts["moc_tick.c"] == plain["moc_tick.c"]


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
@pytest.mark.parametrize("flags", [["-std=c99"], ["-std=gnu11"], ["-std=c99", "-trigraphs"]])
def test_a_compiler_sees_nothing_of_it(flags, tmp_path):
    """The three ways out of a comment, by the compiler itself; the raw text does get out, the written one does not."""
    ways = ["*/ evil /*", "*\\\n/ evil /*"] + (["*??/\n/ evil /*"] if flags != ["-std=gnu11"] else [])
    for way in ways:
        for text, seen in ((way, True), (names.in_comment(way), False)):
            source = tmp_path / "a.c"
            source.write_text(f"/* {text} */\nint fine;\n", encoding="utf-8")
            done = subprocess.run(["cc", *flags, "-E", "-P", str(source)], capture_output=True, text=True, check=True)
            assert ("evil" in done.stdout) is seen
            assert "int fine;" in done.stdout


HOSTILE_JOINTS = [
    "*/ int moc_evil; /*", "a*\\&#10;/ int moc_evil; /*", "*??/&#10;/ int moc_evil; /*", "a&quot;&lt;b&gt;",
]  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE_JOINTS)
def test_a_robot_file_with_code_for_a_name_is_refused_on_the_command_line(name, tmp_path):
    urdf = (FOLDER / "lwr4.urdf").read_text(encoding="utf-8").replace('"joint_3"', f'"{name}"')
    (tmp_path / "arm.urdf").write_text(urdf, encoding="utf-8")
    toml = (FOLDER / "lwr4.toml").read_text(encoding="utf-8").replace('"lwr4.urdf"', '"arm.urdf"')
    (tmp_path / "arm.toml").write_text(toml, encoding="utf-8")
    (tmp_path / "s.toml").write_text(
        'duration_s = 0.004\nbound_samples = 0\n[robot]\nname = "arm.toml"\n[control]\nbackend = "c"\n',
        encoding="utf-8",
    )
    done = subprocess.run(
        [sys.executable, "-m", "moc_opt", "run", "s.toml"], cwd=tmp_path, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 2
    assert "the name of a joint" in done.stderr
    assert "is no name" in done.stderr


def test_allowed_names_reach_the_header(robot):
    """What is allowed stands there as it is."""
    joints = tuple(f"arm/j {i}:a+b-c.d" for i in range(7))
    text = robot.data.urdf
    for old, new in zip(robot.data.joint_names, joints, strict=True):
        text = text.replace(f'"{old}"', f'"{new}"')
    other = RobotModel(replace(robot.data, joint_names=joints, urdf=text))
    _, texts = c_files(TickSpec(other, ControlSettings(), Exact(), 0.002))
    assert ", ".join(joints) in texts["moc_tick.h"]

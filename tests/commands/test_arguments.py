"""Files that the command line reads and writes, and how a command ends."""

import os
import subprocess
import sys

import pytest

import moc_opt as mo
from moc_opt.__main__ import main


@pytest.mark.parametrize(
    "arguments",
    [
        ("run", "a.toml", "--trace", "a.toml"), ("run", "a.toml", "--trace", "b", "--report", "./b"),
        ("report", "a.toml", "--out", "a.toml"), ("compare", "exact", "--scenario", "a.toml", "--out", "a.toml"),
        ("plan", "a.toml", "--out", "a.toml"), ("map", "x", "a.toml", "--out", "x/../a.toml"),
    ],
)  # fmt: skip
def test_what_is_read_is_not_written_over(arguments, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.toml").write_text("duration_s = 0.02\n", encoding="utf-8")
    assert main(list(arguments)) == 2
    assert "give another name" in capsys.readouterr().err
    assert (tmp_path / "a.toml").read_text(encoding="utf-8") == "duration_s = 0.02\n"
    assert [file.name for file in tmp_path.iterdir()] == ["a.toml"]


@pytest.mark.parametrize(("command", "name"), [
    (("run",), "loop"), (("run",), "a\0b"), (("report",), "x" * 300), (("replay",), "\ud800"), (("plan",), "."),
    (("robot", "new"), ""), (("compare", "exact"), "loop"),
])  # fmt: skip
def test_a_name_that_no_file_can_have_is_refused_in_a_line(command, name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "loop").symlink_to("loop")
    given = ["--scenario", name] if command[0] == "compare" else [name]
    out = [] if command[0] in ("run", "compare") else ["--out", "o.toml"]
    assert main([*command, *given, *out]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert len(said) > 15
    assert [file.name for file in tmp_path.iterdir()] == ["loop"]


def test_a_vendors_urdf_is_pointed_to_the_command_that_makes_a_robot_of_it(tmp_path, capsys):
    (tmp_path / "arm.urdf").write_text("<robot name='arm'/>", encoding="utf-8")
    assert main(["run", "--robot", str(tmp_path / "arm.urdf")]) == 2
    assert "`moc-opt robot new arm.urdf --out my.toml`" in capsys.readouterr().err


@pytest.mark.parametrize("arguments", [["run", "--sede=3"], ["solvers", "--list", "--quick"], []])
def test_an_unknown_option_is_refused_everywhere_but_in_the_study(arguments, capsys):
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
    assert (arguments or ["no command"])[-1] in capsys.readouterr().err


def test_the_version_is_printed(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["--version"])
    assert ended.value.code == 0
    assert capsys.readouterr().out == f"moc-opt {mo.__version__}\n"


def test_a_reader_that_closes_the_output_ends_the_command_quietly():
    reader, writer = os.pipe()
    os.close(reader)  # as `| head` is gone once it has what it wants
    with os.fdopen(writer, "wb") as closed:
        ended = subprocess.run([sys.executable, "-m", "moc_opt", "keys"], stdout=closed, stderr=subprocess.PIPE)
    assert (ended.returncode, ended.stderr) == (141, b"")


def test_another_broken_pipe_is_not_taken_for_the_outputs(monkeypatch, capfd):
    def broken(*_):
        raise BrokenPipeError("of a wire")

    monkeypatch.setattr("moc_opt.commands.pages.export_c", broken)
    with pytest.raises(BrokenPipeError, match="of a wire"):
        main(["export-c", "--out", "c"])

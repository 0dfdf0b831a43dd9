"""The parser and the table of what does each command: none is missing, none too many."""

import argparse
import inspect

import pytest

from moc_opt.commands.parser import WORK, make_parser, work_of


def commands():
    """Name -> parser of every command."""
    (found,) = [a for a in make_parser()._actions if isinstance(a, argparse._SubParsersAction)]
    return found.choices


def test_every_command_has_its_function_and_every_function_its_command():
    assert set(commands()) == set(WORK)


@pytest.mark.parametrize("command", WORK)
def test_a_function_takes_the_parsed_options_alone(command):
    work = work_of(command)
    assert len(inspect.signature(work).parameters) == 1
    assert work.__doc__, "it says what it returns"


@pytest.mark.parametrize("command", [name for name in WORK if name != "solvers"])
def test_every_argument_says_what_it_is(command):
    hidden = [a.dest for a in commands()[command]._actions if not a.help and a.dest not in ("scenario", "public")]
    assert [dest for dest in hidden if dest not in ("robot_command",)] == []

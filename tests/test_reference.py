"""The reference: every public name has an example that runs, and every method of one stands in an example."""

import doctest
import inspect
import re
from pathlib import Path

import numpy as np
import pytest

import moc_opt as mo

ROOT = Path(__file__).resolve().parent.parent
DIRECTIVE = re.compile(r"^\.\. auto(function|class|exception):: ([\w.]+)$\n((?:   :.*\n)*)", re.MULTILINE)
ENTRIES = {
    name: (kind, options) for kind, name, options in DIRECTIVE.findall((ROOT / "docs/reference.md").read_text("utf-8"))
}


def found(name):
    """Return what a dotted name of the reference stands for."""
    module, _, attribute = name.rpartition(".")
    return getattr(__import__(module, fromlist=[attribute]), attribute)


def text(one):
    return inspect.getdoc(one) or ""


def methods(name):
    """Name -> method of a class, of those that the reference shows; a property has its shape and unit instead."""
    kind, options = ENTRIES[name]
    if kind != "class" or ":members:" not in options or ":undoc-members:" in options:
        return {}
    listed = re.search(r":members: (.+)", options)
    own = {
        member: of for member, of in vars(found(name)).items()
        if not member.startswith("_")
        and (isinstance(of, classmethod) or inspect.isfunction(of))
    }  # fmt: skip
    return {member: of for member, of in own.items() if listed is None or member in listed[1].split(", ")}


def test_every_public_name_is_an_entry():
    public = {name: getattr(mo, name) for name in mo.__all__ if name != "solvers"}
    public |= {name: getattr(mo.solvers, name) for name in mo.solvers.__all__}
    described = [found(entry) for entry in ENTRIES]
    assert [name for name, one in public.items() if one not in described] == []


@pytest.mark.parametrize("name", ENTRIES)
def test_a_public_name_has_an_example_with_an_outcome(name):
    examples = doctest.DocTestParser().get_examples(text(found(name)))
    assert any(example.want for example in examples)


@pytest.mark.parametrize("name", [name for name in ENTRIES if methods(name)])
def test_every_method_stands_in_an_example(name):
    shown = "".join(
        example.source
        for one in (found(name), *methods(name).values())
        for example in doctest.DocTestParser().get_examples(text(one))
    )
    assert {member for member in methods(name) if not re.search(rf"(\.|\bdef ){member}\(", shown)} == set()


@pytest.mark.parametrize("name", ENTRIES)
def test_the_examples_run(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    runner, said = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS), []
    for title, one in {name: found(name), **methods(name)}.items():
        case = doctest.DocTestParser().get_doctest(text(one), {"mo": mo, "np": np}, title, None, 0)
        runner.run(case, out=said.append)
    assert runner.summarize(verbose=False).failed == 0, "".join(said)

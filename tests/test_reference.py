"""The reference: every public name, and every method of one, stands in an example: its own, which runs, or a page's."""

import doctest
import inspect
import re
from pathlib import Path

import numpy as np
import pytest

import moc_opt as mo

ROOT = Path(__file__).resolve().parent.parent
DIRECTIVE = re.compile(r"^\.\. auto(function|class|exception):: ([\w.]+)$\n((?:   :.*\n)*)", re.MULTILINE)
PAGES = "".join(
    path.read_text("utf-8")
    for path in (ROOT / "README.md", *(ROOT / "docs").glob("*.md"), *(ROOT / "examples").rglob("*.py"))
    if path.name != "reference.md"
)
ENTRIES = {
    name: (kind, options) for kind, name, options in DIRECTIVE.findall((ROOT / "docs/reference.md").read_text("utf-8"))
}


def found(name):
    """Return what a dotted name of the reference stands for."""
    module, _, attribute = name.rpartition(".")
    return getattr(__import__(module, fromlist=[attribute]), attribute)


def methods(name):
    """Name -> method of a class, of those that the reference shows; a property has its shape and unit instead."""
    kind, options = ENTRIES[name]
    if kind != "class" or ":members:" not in options or ":undoc-members:" in options:
        return {}
    listed = re.search(r":members: (.+)", options)
    return {
        member: of for member, of in vars(found(name)).items()
        if not member.startswith("_") and (isinstance(of, classmethod) or inspect.isfunction(of))
        and (listed is None or member in listed[1].split(", "))
    }  # fmt: skip


def test_every_public_name_is_an_entry():
    public = {name: getattr(mo, name) for name in mo.__all__ if name != "solvers"}
    public |= {name: getattr(mo.solvers, name) for name in mo.solvers.__all__}
    described = [found(entry) for entry in ENTRIES]
    assert [name for name, one in public.items() if one not in described] == []


@pytest.mark.parametrize("name", ENTRIES)
def test_a_public_name_and_its_methods_stand_in_an_example_and_its_own_runs(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    runner, said, shown = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS), [], PAGES
    for title, one in {name: found(name), **methods(name)}.items():
        text = inspect.getdoc(one) or ""
        case = doctest.DocTestParser().get_doctest(text, {"mo": mo, "np": np}, title, None, 0)
        shown += "".join(example.source for example in case.examples)
        runner.run(case, out=said.append)
    assert runner.summarize(verbose=False).failed == 0, "".join(said)
    assert len(shown) > len(PAGES) or name.rpartition(".")[2] in PAGES
    assert {member for member in methods(name) if not re.search(rf"(\.|\bdef ){member}\(", shown)} == set()

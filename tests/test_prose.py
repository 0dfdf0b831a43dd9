"""Docstrings of public functions begin with what the function does, in the imperative."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
FILES = [path for top in ("moc_opt", "benchmarks") for path in sorted((ROOT / top).rglob("*.py"))]

# A first word that is not here is no verb, or one more: add it.
VERBS = re.compile(
    r"""
    add|adopt|advance|align|answer|append|apply|ask|attach|average|be|begin|bound|
    bring|build|call|carry|change|check|choose|climb|close|collect|combine|compare|
    compile|compute|copy|correct|count|create|cut|decide|derive|describe|do|draw|end|
    estimate|evaluate|exchange|export|express|fill|film|find|fit|flatten|fold|follow|
    forget|generate|give|go|hand|hash|hold|import|improve|inject|iterate|join|judge|
    keep|kill|lay|let|list|load|look|lower|make|map|mark|maximise|mean|measure|minimize|
    move|name|note|open|order|orthogonalise|pack|parse|pass|perform|place|plan|play|prepare|
    print|project|push|put|raise|rank|read|record|reflect|refuse|register|remember|
    remove|replace|request|reset|restore|return|round|run|sample|save|say|scan|seal|search|see|
    send|set|show|sleep|solve|split|start|step|stop|store|subtract|sum|summarise|sweep|take|
    tell|thin|time|try|turn|update|use|wait|warm|weight|wrap|write|yield
    """,
    re.VERBOSE,
)
NOUNS = ("property", "metric")
"""Decorators of what is told by a noun: attributes, and metrics, whose docstring is their description."""


def public(node: ast.AST) -> Iterator[ast.FunctionDef]:
    """Functions of a module and methods of its classes that others call."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.FunctionDef):
            decorators = " ".join(ast.unparse(each) for each in child.decorator_list)
            if not child.name.startswith("_") and not any(word in decorators for word in (*NOUNS, "setter")):
                yield child
        elif isinstance(child, ast.ClassDef | ast.If):
            yield from public(child)


def nouns(source: str) -> list[str]:
    """First lines that begin with no verb."""
    lines = [(ast.get_docstring(each) or "").partition("\n")[0] for each in public(ast.parse(source))]
    return [line for line in lines if line and not _imperative(line)]


def _imperative(line: str) -> bool:
    first = re.split(r"[^A-Za-z]", line)[0]
    return first[:1].isupper() and VERBS.fullmatch(first.lower()) is not None


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_public_docstrings_begin_with_a_verb(path: Path) -> None:
    assert nouns(path.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize("line", ["The rate.", "Returns the rate.", "mu alone.", "(n,) speeds.", "return it.", "A x."])
@pytest.mark.parametrize("frame", ['def f():\n    """{}"""', 'class C:\n    def f(self):\n        """{}"""'])
def test_a_noun_is_seen(frame: str, line: str) -> None:
    assert nouns(frame.format(line)) == [line]


@pytest.mark.parametrize(
    "source",
    [
        'def f():\n    """Return the rate.\n\n    The rest.\n    """', 'def _f():\n    """The rate."""',
        'class C:\n    @property\n    def f(self):\n        """The rate."""',
        '@metric("mm")\ndef f(trace):\n    """The error."""',
    ],
)  # fmt: skip
def test_what_is_right_or_hidden_passes(source: str) -> None:
    assert nouns(source) == []

"""The mutants of a module: cosmic-ray's operators, less those that could change nothing or break everything."""

from __future__ import annotations

import ast
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from moc_opt.errors import MocOptError

_ARITHMETIC = ("Add", "Sub", "Mul", "Div")
_INTO = {"Add": _ARITHMETIC, "Sub": _ARITHMETIC, "Mul": _ARITHMETIC, "Div": _ARITHMETIC,
         "FloorDiv": _ARITHMETIC, "Mod": _ARITHMETIC, "Pow": _ARITHMETIC}  # fmt: skip
_ORDER = ("Eq", "NotEq", "Lt", "LtE", "Gt", "GtE")
# Bit operators between floats and orderings of `is` raise at once: killing them would prove nothing.
OPERATORS = (
    *(f"ReplaceBinaryOperator_{a}_{b}" for a, into in _INTO.items() for b in into if a != b),
    *(f"ReplaceComparisonOperator_{a}_{b}" for a in _ORDER for b in _ORDER if a != b),
    "ReplaceComparisonOperator_Is_IsNot", "ReplaceComparisonOperator_IsNot_Is",
    "ReplaceUnaryOperator_USub_UAdd", "ReplaceUnaryOperator_Delete_Not", "AddNot", "ReplaceTrueWithFalse",
    "ReplaceFalseWithTrue", "ReplaceAndWithOr", "ReplaceOrWithAnd", "ReplaceBreakWithContinue",
    "ReplaceContinueWithBreak", "ExceptionReplacer", "NumberReplacer", "ZeroIterationForLoop",
)  # fmt: skip
_AUGMENTED = {"+=": "-=", "-=": "+=", "*=": "/=", "/=": "*="}


class MutationError(MocOptError, ValueError):
    """No mutants can be made or judged."""


@dataclass(frozen=True)
class Mutant:
    """One error in one line.

    Attributes:
        module: dotted name.
        operator: of cosmic-ray, or "ReplaceAugmented".
        occurrence: which of the operator's places in the module.
        line: number of the line, from 1.
        before, after: that line, without its indentation.
        source: the whole module with the error in it.
    """

    module: str
    operator: str
    occurrence: int
    line: int
    before: str
    after: str
    source: str

    def row(self) -> dict[str, Any]:
        """Return what a summary says of it."""
        return {"line": self.line, "operator": self.operator, "before": self.before, "after": self.after}


def module_file(root: Path, module: str) -> Path:
    """Find the source of a dotted name.

    Raises:
        MutationError: there is none.
    """
    path = root.joinpath(*module.split(".")).with_suffix(".py")
    if not path.is_file():
        raise MutationError(f"module {module!r}: no file {path}; give a dotted name such as moc_opt.control.rcm")
    return path


@dataclass(frozen=True)
class Place:
    """Where an operator can act: its ``occurrence``-th place in a module."""

    module: str
    operator: str
    occurrence: int


def places(root: Path, module: str) -> list[Place]:
    """List every place of every operator, in order.

    Raises:
        MutationError: no such module, or cosmic-ray is not installed.
    """
    text = module_file(root, module).read_text(encoding="utf-8")
    idle, found = _idle_lines(text), []
    for name in OPERATORS:
        for k, line in enumerate(_lines(text, name)):
            if line not in idle:
                found.append(Place(module, name, k))
    return [*found, *(Place(module, "ReplaceAugmented", k) for k in range(len(_augmented(text))))]


def mutant(root: Path, place: Place) -> Mutant | None:
    """Make the error at that place; None where it leaves the same program, or no valid one."""
    text = module_file(root, place.module).read_text(encoding="utf-8")
    if place.operator == "ReplaceAugmented":
        return _made(place, text, _augmented(text)[place.occurrence])
    from cosmic_ray.mutating import mutate_code

    return _made(place, text, mutate_code(text, _operator(place.operator), place.occurrence))


def sample(root: Path, found: Sequence[Place], count: int, rng: np.random.Generator) -> list[Mutant]:
    """Draw ``count`` mutants without replacement, ordered by module and line; all where there are not so many."""
    drawn: list[Mutant] = []
    for k in rng.permutation(len(found)):
        made = mutant(root, found[k]) if len(drawn) < count else None
        if made is not None:
            drawn.append(made)
    return sorted(drawn, key=lambda one: (one.module, one.line, one.operator, one.occurrence))


@cache
def _operator(name: str) -> Any:
    try:
        from cosmic_ray.plugins import get_operator
    except ImportError as error:
        raise MutationError(f"cosmic-ray is not installed: pip install 'moc-opt[mutation]' ({error})") from error
    return get_operator(f"core/{name}")()


def _lines(text: str, name: str) -> list[int]:
    """Return the line of each of the operator's places."""
    operator = _operator(name)
    return [start[0] for node in _nodes(text) for start, _ in operator.mutation_positions(node)]


@cache
def _nodes(text: str) -> list[Any]:
    from cosmic_ray.ast import ast_nodes, get_ast

    return list(ast_nodes(get_ast(text)))


def _augmented(text: str) -> list[str]:
    """Return ``+=`` into ``-=`` and the like, which cosmic-ray leaves alone."""
    lines, found = text.splitlines(keepends=True), []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.AugAssign):
            k = node.target.end_lineno or node.lineno
            line = lines[k - 1]
            start = (node.target.end_col_offset or 0) + 1
            into = _AUGMENTED.get(line[start : start + 2])
            if into is not None:
                found.append("".join([*lines[: k - 1], line[:start] + into + line[start + 2 :], *lines[k:]]))
    return found


def _made(place: Place, text: str, code: str | None) -> Mutant | None:
    if code is None:
        return None
    try:
        if ast.dump(ast.parse(code)) == ast.dump(ast.parse(text)):
            return None
    except SyntaxError:
        return None
    old, new = text.splitlines(), code.splitlines()
    line = next(k for k, (a, b) in enumerate(zip(old, new, strict=False)) if a != b)
    before, after = old[line].strip(), new[line].strip()
    return Mutant(
        place.module, place.operator, place.occurrence, line=line + 1, before=before, after=after, source=code
    )


def _idle_lines(text: str) -> set[int]:
    """Return the lines of decorators, which hold options of the compiler, and of what introduces a signature's `*`."""
    idle: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            for decorator in node.decorator_list:
                idle |= set(range(decorator.lineno, (decorator.end_lineno or decorator.lineno) + 1))
        if isinstance(node, ast.FunctionDef) and node.args.kwonlyargs:
            idle |= set(range(node.lineno, node.body[0].lineno))
    return idle

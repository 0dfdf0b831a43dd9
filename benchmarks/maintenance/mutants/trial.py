"""One mutant before the tests, in a process of its own; nothing is written into the tree.

The mutated text stands in for the module when it is imported. Its kernels, and those of every module that imports
it, run as plain Python: a kernel from numba's cache would still be the one before the mutation.
"""

from __future__ import annotations

import ast
import importlib.abc
import importlib.util
import os
import sys
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from benchmarks.common.processes import Crashed, Hung, Raised, Worker

OURS = ("moc_opt", "benchmarks", "tests")
COMPILERS = ("numba", "moc_opt.numerics.cache")
"""Modules that ``njit`` comes from."""
_LIBRARIES = (
    "numpy", "scipy.linalg", "scipy.optimize", "numba", "pinocchio", "casadi", "mujoco", "pydantic", "pytest",
    "hypothesis.strategies", "qpsolvers", "pyarrow.parquet",
)  # fmt: skip


@dataclass
class Outcome:
    """What the tests said.

    Attributes:
        result: "survived", "killed" or "timed out".
        by: the test that failed.
        seconds: of wall clock.
        tests: name -> (passed, seconds) of those that ran.
    """

    result: str
    by: str = ""
    seconds: float = 0.0
    tests: dict[str, tuple[bool, float]] = field(default_factory=dict)


@cache
def _imports(root: Path) -> dict[str, Collection[str]]:
    """Return every module of the project -> those that it imports; read once."""
    trees: dict[str, ast.Module] = {}
    for top in OURS:
        for path in (root / top).rglob("*.py"):
            parts = path.relative_to(root).with_suffix("").parts
            name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
            trees[name] = ast.parse(path.read_text(encoding="utf-8"))
    return {name: _imported(tree, trees.keys()) for name, tree in trees.items()}


def dependents(root: Path, module: str) -> frozenset[str]:
    """Return the module, and every module of the project that imports it, over any number of steps."""
    found, grown = {module}, True
    while grown:
        more = {name for name, used in _imports(root).items() if found.intersection(used)} - found
        found, grown = found | more, bool(more)
    return frozenset(found)


TAKEN_BY_KERNELS = ("moc_opt.qp.layout", "moc_opt.qp.reduction")
"""Modules of plain functions that `moc_opt.qp.equalities` hands to kernels."""


def may_hold(root: Path, module: str, line: int) -> frozenset[str]:
    """Return the modules whose compiled kernels may hold what stands in that line of a module.

    All that ``dependents`` finds; none where a module without ``njit`` has the line in a function: a kernel takes
    constants and kernels from other modules, and compiles no plain function but those of ``TAKEN_BY_KERNELS``.
    """
    path = root.joinpath(*module.split(".")).with_suffix(".py")
    tree = ast.parse(path.read_text(encoding="utf-8"))
    inside = any(
        isinstance(node, ast.FunctionDef) and node.lineno <= line <= (node.end_lineno or line) for node in tree.body
    )
    compiles = any(name.startswith(COMPILERS) for name in _imported(tree, ()))
    if inside and not compiles and module not in TAKEN_BY_KERNELS:
        return frozenset()
    return dependents(root, module)


def _imported(tree: ast.Module, ours: Collection[str]) -> set[str]:
    """Return our modules that a module names in an import: of `from a import b`, a.b where that is one, else a."""
    found: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            whole = {alias.name: f"{node.module}.{alias.name}" for alias in node.names}
            found |= {path if path in ours else node.module for path in whole.values()}
    return found


def run_tests(
    root: Path, module: str, source: str | None, plain: Collection[str], tests: Sequence[str], limit_s: float, *,
    keep_going: bool = False,
) -> Outcome:  # fmt: skip
    """Run tests against a mutated module, at most ``limit_s``.

    Args:
        source: its text; None: as it is.
        plain: modules whose kernels run as plain Python.
        tests: files or single tests, as pytest names them; they run in this order.
        keep_going: run all of them, also after one that failed.
    """
    begin = time.monotonic()
    try:
        with Worker(preload=_LIBRARIES) as worker:
            asked = (root, module, source, plain, tests, keep_going)
            ((by, ran),) = worker.stream(_run, *asked, patience_s=limit_s, first_s=0.0)
    except Hung:
        return Outcome("timed out", seconds=time.monotonic() - begin)
    except Crashed:
        return Outcome("killed", "the process ended", time.monotonic() - begin)
    except Raised as error:  # a mutant may throw anything, at any place
        by, ran = f"{error}"[:200], []
    found = {name: (passed, spent) for name, passed, spent in ran}
    return Outcome("killed" if by else "survived", by, time.monotonic() - begin, found)


def _run(
    root: Path, module: str, source: str | None, plain: Collection[str], tests: Sequence[str], keep_going: bool
) -> Iterator[tuple[str, list[tuple[str, bool, float]]]]:
    """Run the tests, in a worker: the first that failed, and (name, passed, seconds) of all that ran."""
    import pytest

    silence = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1, 2):
        os.dup2(silence, stream)
    os.chdir(root)
    sys.path.insert(0, str(root))
    for name in [name for name in sys.modules if name.split(".")[0] in OURS]:
        del sys.modules[name]
    _interpret(plain)
    if source is not None:
        sys.meta_path.insert(0, _Mutated(module, source, root))
    log = _Log(tests)
    options = ["-q", "-p", "no:cacheprovider", "-p", "no:xdist", "-p", "no:cov", *([] if keep_going else ["-x"])]
    files = list(dict.fromkeys(test.split("::")[0] for test in tests))
    code = pytest.main([*options, *files], plugins=[log])
    yield log.failed or ("" if code in (0, 5) else f"pytest ended with {int(code)}"), log.rows


class _Log:
    """Picks the tests, and notes what became of them."""

    def __init__(self, tests: Sequence[str]) -> None:
        self._place = {name: k for k, name in enumerate(tests)}
        self.rows: list[tuple[str, bool, float]] = []
        self.failed = ""

    def pytest_sessionstart(self) -> None:
        from hypothesis import Phase, settings

        # The first wrong example is enough: a smaller one would be looked for in vain.
        quick = settings(settings.get_profile("repeatable"), phases=(Phase.explicit, Phase.generate))
        settings.register_profile("mutation", quick)
        settings.load_profile("mutation")

    def pytest_collection_modifyitems(self, items: list[Any]) -> None:
        def place(item: Any) -> int | None:
            return self._place.get(item.nodeid, self._place.get(item.nodeid.split("::")[0]))

        kept = [item for item in items if place(item) is not None]
        items[:] = sorted(kept, key=lambda item: place(item) or 0)

    def pytest_collectreport(self, report: Any) -> None:
        if report.failed:
            self.failed = self.failed or f"{report.nodeid} (import)"

    def pytest_runtest_logreport(self, report: Any) -> None:
        if report.failed:
            self.failed = self.failed or report.nodeid
        if report.when == "call" or report.outcome != "passed":
            self.rows.append((report.nodeid, report.passed, report.duration))


class _Mutated(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Loads one module from a text."""

    def __init__(self, module: str, source: str, root: Path) -> None:
        self._module, self._source = module, source
        self._path = root.joinpath(*module.split(".")).with_suffix(".py")

    def find_spec(self, name: str, path: Any, target: ModuleType | None = None) -> ModuleSpec | None:
        if name != self._module:
            return None
        return importlib.util.spec_from_loader(name, self, origin=str(self._path))

    def exec_module(self, module: ModuleType) -> None:
        module.__file__ = str(self._path)
        exec(compile(self._source, str(self._path), "exec"), module.__dict__)


def _interpret(modules: Iterable[str]) -> None:
    """Let ``njit`` leave the kernels of these modules as they are, with what our code asks of a kernel."""
    import numba

    compiled, plain = numba.njit, set(modules)

    def njit(*given: Any, **options: Any) -> Any:
        def decorate(function: Any) -> Any:
            if function.__module__ not in plain:
                return compiled(**options)(function)
            function.py_func = function
            function.compile = lambda kinds: None
            function.get_overload = lambda kinds: _code(function)
            return function

        return decorate(given[0]) if given and callable(given[0]) else decorate

    numba.njit = njit


def _code(function: Callable[..., Any]) -> Callable[..., Any]:
    """Stand in for machine code, which takes no notice that an array is read-only.

    The kernels that the function calls do: they would be compiled for each mixture, and some cannot be.
    """

    def code(*given: Any) -> Any:
        return function(*(
            each.copy() if isinstance(each, np.ndarray) and not each.flags.writeable else each for each in given
        ))  # fmt: skip

    return code

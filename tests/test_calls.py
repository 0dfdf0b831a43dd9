"""Calls are read at the place where they stand: beyond six arguments they name what they hand over."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
MOST = 6
TAKEN_BY_KERNELS = ROOT / "moc_opt" / "qp" / "layout.py"
"""Plain functions that kernels are made of."""


def compiled(node: ast.AST) -> bool:
    """Whether it is a kernel, in which the order of arguments is that of the machine code."""
    decorators = [ast.unparse(entry) for entry in node.decorator_list] if isinstance(node, ast.FunctionDef) else []
    return any("njit" in text or text == "inlined" for text in decorators)


def trees() -> dict[Path, ast.Module]:
    files = [path for top in ("moc_opt", "benchmarks") for path in (ROOT / top).rglob("*.py")]
    return {path: ast.parse(path.read_text(encoding="utf-8")) for path in files if path != TAKEN_BY_KERNELS}


def named(module: ast.Module) -> set[str]:
    """Functions and classes of a module, as others call them: those that take any number of arguments aside."""
    found = set()
    for node in module.body:
        if isinstance(node, ast.ClassDef):
            makers = [each for each in node.body if isinstance(each, ast.FunctionDef) and each.name == "__init__"]
            found |= set() if any(maker.args.vararg for maker in makers) else {node.name}
        elif isinstance(node, ast.FunctionDef) and not compiled(node) and not node.args.vararg:
            found.add(node.name)
    return found


def long_calls(module: ast.Module, ours: set[str]) -> list[str]:
    """Calls of these names with more than six arguments by place; kernels, and other packages' functions, aside."""
    found, waiting = [], list(module.body)
    imports = [node for node in ast.walk(module) if isinstance(node, ast.Import)]
    foreign = {alias.asname or alias.name for node in imports for alias in node.names}
    ours = ours - {node.name for node in module.body if compiled(node) and isinstance(node, ast.FunctionDef)}
    for node in waiting:  # grows while it is walked
        if compiled(node):
            continue
        waiting += ast.iter_child_nodes(node)
        if isinstance(node, ast.Call) and len(node.args) > MOST:
            name = ast.unparse(node.func)
            owner, _, last = name.rpartition(".")
            if last in ours and owner != "self" and owner.partition(".")[0] not in foreign:
                found.append(f"line {node.lineno}: {name} with {len(node.args)}")
    return found


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("def f(a, b, c, d, e, g, h): ...\nf(1, 2, 3, 4, 5, 6, 7)", 1),
        ("class f: ...\ndef g():\n    return [f(1, 2, 3, 4, 5, 6, 7)]", 1),
        ("def f(a, b, c, d, e, g, h): ...\nf(1, 2, 3, 4, 5, 6, h=7)", 0),
        ("def f(*all): ...\nf(1, 2, 3, 4, 5, 6, 7)", 0),
        ("@njit(cache=True)\ndef f(a, b, c, d, e, g, h): ...\nf(1, 2, 3, 4, 5, 6, 7)", 0),
    ],
)
def test_a_long_call_is_seen(text, count):
    module = ast.parse(text)
    assert len(long_calls(module, named(module))) == count


def test_no_call_hands_over_more_than_six_arguments_by_their_place():
    found = trees()
    ours = set.union(*map(named, found.values()))
    wrong = [f"{path.relative_to(ROOT)}: {call}" for path, tree in found.items() for call in long_calls(tree, ours)]
    assert not wrong, "\n".join(wrong)

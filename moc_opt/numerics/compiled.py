"""A short way into compiled kernels, for calls that are repeated at every tick."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cached_property
from typing import Any, TypeVar

from llvmlite import ir
from numba import bool_, float64, int8, int64, types
from numba.core import cgutils
from numba.extending import intrinsic, overload

VECTOR, MATRIX = float64[::1], float64[:, ::1]
"""Contiguous arrays of one and two dimensions."""
INDICES, FLAGS = int64[::1], bool_[:, ::1]
"""The same of integers and of truth values."""
CUBE, BYTES = float64[:, :, ::1], int8[::1]
REAL, INTEGER = float64, int64


def named(record: type[tuple[Any, ...]], *kinds: Any) -> Any:
    """Return the kind of a ``NamedTuple`` whose fields have these kinds: a kernel takes it as one argument."""
    return types.NamedTuple(kinds, record)


class CompiledKernel:
    """A kernel's machine code for arguments of fixed kinds, without numba's look at their types at every call.

    That look costs some 30 ns an argument, and three times as much where an array is read-only. The code still
    refuses what is no array and numbers of another size, but takes dimension, dtype and contiguous memory for granted:
    hand it only arrays that this package has made or checked itself.

    Args:
        kernel: an ``njit`` function.
        kinds: numba types of its arguments, in order.
    """

    def __init__(self, kernel: Any, *kinds: Any) -> None:
        self._kernel, self._kinds = kernel, kinds

    @cached_property
    def code(self) -> Callable[..., Any]:
        """The machine code; compiled, or read from the cache, when it is first asked for, not when imported."""
        self._kernel.compile(self._kinds)
        code: Callable[..., Any] = self._kernel.get_overload(self._kinds)
        return code


Lent = TypeVar("Lent")


@intrinsic  # type: ignore[untyped-decorator]
def _lend(typing_context: Any, array: Any) -> Any:
    def lend_one(context: Any, builder: Any, kind: Any, given: Any) -> Any:
        if not isinstance(kind, types.Array):
            return given
        made = context.make_array(kind)(context, builder, given)
        made.meminfo = cgutils.get_null_value(made.meminfo.type)
        return made._getvalue()

    def lend(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        if isinstance(array, types.Array):
            return lend_one(context, builder, array, given[0])
        parts = zip(array.types, cgutils.unpack_tuple(builder, given[0]), strict=True)
        return context.make_tuple(builder, array, [lend_one(context, builder, *part) for part in parts])

    return array(array), lend


def borrowed(array: Lent) -> Lent:
    """Return the same array for use inside a kernel, without a share in its memory; in Python, the array itself.

    Of a named tuple, the same one with all its arrays borrowed.

    A kernel counts references to every array that it is given, views or hands on, each time with a locked
    instruction, which costs more than most arithmetic there. What is borrowed, and every view of it, is not counted.
    Its owner has to outlive it: borrow arguments, which the caller holds, and never hand a borrowed array back.
    """
    return array


@overload(borrowed, strict=False)
def _borrowed(array: Any) -> Callable[..., Any] | None:
    return (lambda array: _lend(array)) if isinstance(array, types.Array | types.BaseNamedTuple) else None


@intrinsic  # type: ignore[untyped-decorator]
def _call(typing_context: Any, function: Any, first: Any, second: Any) -> Any:
    def emit(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        kind = ir.FunctionType(ir.VoidType(), [ir.IntType(64)] * 2)
        builder.call(builder.inttoptr(given[0], kind.as_pointer()), given[1:])
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, types.int64), emit


def call(function: int, first: int, second: int) -> None:
    """Call the C function ``void f(void *, void *)``, inside a kernel or in Python; all three are addresses.

    Both objects have to outlive the call: an address keeps nothing alive.
    """
    ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p)(int(function))(int(first), int(second))


@intrinsic  # type: ignore[untyped-decorator]
def _ask(typing_context: Any, function: Any, given: Any) -> Any:
    def emit(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        pointers = cgutils.unpack_tuple(builder, values[1])
        kind = ir.FunctionType(ir.IntType(32), [ir.IntType(64)] * len(pointers))
        answer = builder.call(builder.inttoptr(values[0], kind.as_pointer()), pointers)
        return builder.sext(answer, ir.IntType(64))

    return types.int64(types.int64, given), emit


def ask(function: int, given: tuple[int, ...]) -> int:
    """Call the C function ``int f(void *, ...)``, inside a kernel or in Python; all are addresses, as for ``call``."""
    kind = ctypes.CFUNCTYPE(ctypes.c_int, *[ctypes.c_void_p] * len(given))
    return int(kind(int(function))(*map(int, given)))


@overload(ask, strict=False)
def _asked(function: Any, given: Any) -> Callable[..., Any]:
    return lambda function, given: _ask(function, given)


@overload(call, strict=False)
def _called(function: Any, first: Any, second: Any) -> Callable[..., Any]:
    return lambda function, first, second: _call(function, first, second)

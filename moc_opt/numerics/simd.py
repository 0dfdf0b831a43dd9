"""Eight numbers at a time, for kernels on vectors so short that a loop costs more than the arithmetic in it.

Rows of a matrix whose width is a multiple of eight are taken in pieces: ``load(M, i, c)`` is M[i, c : c + 8] as one
value, which fills one register where the processor has such (AVX-512), two or four where it has not. Pieces, or
a piece and a number, are added, subtracted, multiplied and divided entry by entry; products may be fused into sums.
Places are taken as they are, inside the matrix or not. All functions but ``width`` work in compiled code only.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import float64, int64, types
from numba.core import cgutils
from numba.core.typeconv import Conversion
from numba.extending import intrinsic, lower_builtin, lower_cast, models, register_model, type_callable
from numba.np.arrayobj import populate_array

from moc_opt.numerics.cache import njit

COUNT = 8
_EIGHT, _INDEX, _BYTE = ir.VectorType(ir.DoubleType(), COUNT), ir.IntType(64), ir.IntType(8)
_FUSED = ("contract", "nsz")

Build = Callable[[Any, Any, Any, Any], Any]
Typed = tuple[Any, Build]


class SimdType(types.Type):  # type: ignore[misc]
    """numba's type of eight numbers; a single number is spread over all of them where they are asked for."""

    def __init__(self) -> None:
        super().__init__(name="simd")

    def can_convert_from(self, typing_context: Any, other: Any) -> Any:
        """A number can be taken for eight equal ones."""
        return Conversion.promote if isinstance(other, _TERM) else None


SIMD = SimdType()
_TERM = (SimdType, types.Integer, types.Float)


@register_model(SimdType)
class _Model(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _EIGHT)


@lower_cast(types.Integer, SimdType)  # type: ignore[untyped-decorator]
@lower_cast(types.Float, SimdType)  # type: ignore[untyped-decorator]
def _cast(context: Any, builder: Any, given: Any, wanted: Any, value: Any) -> Any:
    return _spread(builder, context.cast(builder, value, given, float64))


@njit(cache=True)
def width(n: int) -> int:
    """The smallest multiple of eight that is not below n."""
    return (n + COUNT - 1) // COUNT * COUNT


@intrinsic  # type: ignore[untyped-decorator]
def load(typing_context: Any, M: Any, i: Any, c: Any) -> Typed:
    """M[i, c : c + 8] of a contiguous matrix."""

    def build(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        return builder.load(_place(context, builder, signature.args[0], *given), align=8)

    return SIMD(M, int64, int64), build


@intrinsic  # type: ignore[untyped-decorator]
def store(typing_context: Any, M: Any, i: Any, c: Any, value: Any) -> Typed:
    """M[i, c : c + 8] = value."""

    def build(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        builder.store(given[3], _place(context, builder, signature.args[0], *given[:3]), align=8)
        return context.get_dummy_value()

    return types.void(M, int64, int64, SIMD), build


@intrinsic  # type: ignore[untyped-decorator]
def part(typing_context: Any, vector: Any, at: Any, count: Any) -> Typed:
    """vector[at : at + count] of a contiguous vector, then zeros; what lies beyond is not read. All eight at most."""

    def build(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        place, inside = _begin(context, builder, signature.args[0], *given)
        kind = ir.FunctionType(_EIGHT, [place.type, ir.IntType(32), inside.type, _EIGHT])
        read = cgutils.get_or_insert_function(builder.module, kind, "llvm.masked.load.v8f64.p0")
        return builder.call(read, [place, ir.Constant(ir.IntType(32), 8), inside, _constant([0.0] * COUNT)])

    return SIMD(vector, int64, int64), build


@intrinsic  # type: ignore[untyped-decorator]
def keep(typing_context: Any, vector: Any, at: Any, count: Any, value: Any) -> Typed:
    """vector[at : at + count] = value, of which no more than ``count`` numbers are written."""

    def build(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        place, inside = _begin(context, builder, signature.args[0], *given[:3])
        kind = ir.FunctionType(ir.VoidType(), [_EIGHT, place.type, ir.IntType(32), inside.type])
        write = cgutils.get_or_insert_function(builder.module, kind, "llvm.masked.store.v8f64.p0")
        builder.call(write, [given[3], place, ir.Constant(ir.IntType(32), 8), inside])
        return context.get_dummy_value()

    return types.void(vector, int64, int64, SIMD), build


@intrinsic  # type: ignore[untyped-decorator]
def stack(typing_context: Any, rows: Any, columns: Any) -> Typed:
    """A matrix in the caller's own frame, gone when it returns: asking for memory costs as much as a short sum."""

    def build(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        return _framed(context, builder, signature.return_type, list(given))

    return types.Array(float64, 2, "C")(int64, int64), build


@intrinsic  # type: ignore[untyped-decorator]
def stack_indices(typing_context: Any, count: Any) -> Typed:
    """Integers in the caller's own frame, gone when it returns."""

    def build(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        return _framed(context, builder, signature.return_type, list(given))

    return types.Array(int64, 1, "C")(int64), build


@intrinsic  # type: ignore[untyped-decorator]
def zeros(typing_context: Any) -> Typed:
    """Eight zeros."""
    return SIMD(), lambda context, builder, signature, given: _constant([0.0] * COUNT)


@intrinsic  # type: ignore[untyped-decorator]
def unit(typing_context: Any, k: Any) -> Typed:
    """1 at place k, 0 elsewhere; all 0 where k is not one of 0 to 7."""

    def build(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        here = builder.icmp_signed("==", _numbered(), _spread(builder, given[0]))
        return builder.select(here, _constant([1.0] * COUNT), _constant([0.0] * COUNT))

    return SIMD(int64), build


@intrinsic  # type: ignore[untyped-decorator]
def magnitude(typing_context: Any, a: Any) -> Typed:
    """|a|."""

    def build(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        return builder.call(
            cgutils.get_or_insert_function(
                builder.module, ir.FunctionType(_EIGHT, [_EIGHT]), "llvm.fabs.v8f64"
            ),
            given,
        )

    return SIMD(SIMD), build


@intrinsic  # type: ignore[untyped-decorator]
def above(typing_context: Any, a: Any, b: Any, x: Any, y: Any) -> Typed:
    """x where a > b, else y."""

    def build(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        a, b, x, y = given
        return builder.select(builder.fcmp_ordered(">", a, b), x, y)

    return SIMD(SIMD, SIMD, SIMD, SIMD), build


@intrinsic  # type: ignore[untyped-decorator]
def larger(typing_context: Any, a: Any, b: Any) -> Typed:
    """The larger of a and b at every place."""
    return SIMD(SIMD, SIMD), lambda context, builder, signature, given: _larger(builder, *given)


@intrinsic  # type: ignore[untyped-decorator]
def lesser(typing_context: Any, a: Any, b: Any) -> Typed:
    """The lesser of a and b at every place."""
    return SIMD(SIMD, SIMD), lambda context, builder, signature, given: _lesser(builder, *given)


@intrinsic  # type: ignore[untyped-decorator]
def largest(typing_context: Any, a: Any) -> Typed:
    """The largest of the eight numbers."""
    return float64(SIMD), lambda context, builder, signature, given: _folded(builder, given[0], _larger)


@intrinsic  # type: ignore[untyped-decorator]
def least(typing_context: Any, a: Any) -> Typed:
    """The least of the eight numbers."""
    return float64(SIMD), lambda context, builder, signature, given: _folded(builder, given[0], _lesser)


@intrinsic  # type: ignore[untyped-decorator]
def total(typing_context: Any, a: Any) -> Typed:
    """The sum of the eight numbers."""
    return float64(SIMD), lambda context, builder, signature, given: _folded(builder, given[0], _sum)


@intrinsic  # type: ignore[untyped-decorator]
def first(typing_context: Any, a: Any, value: Any) -> Typed:
    """The first place where a is equal to the value, 8 where there is none."""

    def build(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        equal = builder.fcmp_ordered("==", given[0], _spread(builder, given[1]))
        bits = builder.zext(builder.bitcast(equal, _BYTE), _INDEX)
        return builder.cttz(builder.or_(bits, ir.Constant(_INDEX, 1 << COUNT)), ir.Constant(ir.IntType(1), 1))

    return int64(SIMD, float64), build


def _entrywise(operation: Any, name: str) -> None:
    """``a operation b`` where one of them, or both, are such. (``overload`` would compile a function for each.)"""

    @type_callable(operation)  # type: ignore[untyped-decorator]
    def typer_of(typing_context: Any) -> Any:
        return lambda a, b: (
            SIMD if SIMD in (a, b) and isinstance(a, _TERM) and isinstance(b, _TERM) else None
        )

    @lower_builtin(operation, SimdType, SimdType)  # type: ignore[untyped-decorator]
    @lower_builtin(operation, SimdType, types.Number)  # type: ignore[untyped-decorator]
    @lower_builtin(operation, types.Number, SimdType)  # type: ignore[untyped-decorator]
    def lower(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        a, b = (context.cast(builder, *of, SIMD) for of in zip(given, signature.args, strict=True))
        return getattr(builder, name)(a, b, flags=_FUSED)


_entrywise(operator.add, "fadd")
_entrywise(operator.sub, "fsub")
_entrywise(operator.mul, "fmul")
_entrywise(operator.truediv, "fdiv")


def _place(context: Any, builder: Any, kind: Any, M: Any, i: Any, c: Any) -> Any:
    array = context.make_array(kind)(context, builder, M)
    row = builder.mul(i, builder.extract_value(array.shape, 1))
    return builder.bitcast(builder.gep(array.data, [builder.add(row, c)]), _EIGHT.as_pointer())


def _begin(context: Any, builder: Any, kind: Any, vector: Any, at: Any, count: Any) -> tuple[Any, Any]:
    """Where eight numbers of a vector begin, and which of them lie within ``count``."""
    array = context.make_array(kind)(context, builder, vector)
    place = builder.bitcast(builder.gep(array.data, [at]), _EIGHT.as_pointer())
    return place, builder.icmp_signed("<", _numbered(), _spread(builder, count))


def _framed(context: Any, builder: Any, kind: Any, shape: list[Any]) -> Any:
    """An array without an owner in the frame of the function that is being compiled."""
    size = shape[0] if len(shape) == 1 else builder.mul(*shape)
    data = builder.alloca(context.get_value_type(kind.dtype), size=size)
    data.align = 8 * COUNT
    strides = [_INDEX(8)] if len(shape) == 1 else [builder.mul(shape[1], _INDEX(8)), _INDEX(8)]
    array = context.make_array(kind)(context, builder)
    populate_array(array, data=data, shape=shape, strides=strides, itemsize=_INDEX(8), meminfo=None)
    return array._getvalue()


def _constant(values: list[Any]) -> Any:
    kind = ir.DoubleType() if isinstance(values[0], float) else _INDEX
    return ir.Constant(ir.VectorType(kind, len(values)), [ir.Constant(kind, value) for value in values])


def _numbered() -> Any:
    return _constant(list(range(COUNT)))


def _spread(builder: Any, value: Any) -> Any:
    """Eight times one number."""
    nothing = ir.Constant(ir.VectorType(value.type, COUNT), ir.Undefined)
    once = builder.insert_element(nothing, value, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(once, nothing, _indices([0] * COUNT))


def _indices(places: list[int]) -> Any:
    kind = ir.IntType(32)
    return ir.Constant(ir.VectorType(kind, len(places)), [ir.Constant(kind, place) for place in places])


def _folded(builder: Any, value: Any, pair: Callable[[Any, Any, Any], Any]) -> Any:
    """The halves joined entry by entry until one number is left."""
    half = COUNT // 2
    while half:
        nothing = ir.Constant(value.type, ir.Undefined)
        lower, upper = (
            builder.shuffle_vector(value, nothing, _indices(list(range(start, start + half))))
            for start in (0, half)
        )
        value, half = pair(builder, lower, upper), half // 2
    return builder.extract_element(value, ir.Constant(ir.IntType(32), 0))


def _larger(builder: Any, a: Any, b: Any) -> Any:
    return builder.select(builder.fcmp_ordered(">", a, b), a, b)


def _lesser(builder: Any, a: Any, b: Any) -> Any:
    return builder.select(builder.fcmp_ordered("<", a, b), a, b)


def _sum(builder: Any, a: Any, b: Any) -> Any:
    return builder.fadd(a, b, flags=_FUSED)

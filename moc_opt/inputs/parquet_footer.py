"""What a Parquet file asks for, read from its footer before any library is given it.

pyarrow's view of a column's metadata ends the whole process where a damaged footer holds sizes that do not fit each
other, so the few numbers that a check of size needs are read here: strictly, in time that grows with the footer's
length alone. A footer is one struct of Thrift's compact protocol
(https://github.com/apache/thrift/blob/master/doc/specs/thrift-compact-protocol.md), its fields those of
https://github.com/apache/parquet-format/blob/master/src/main/thrift/parquet.thrift.
"""

from __future__ import annotations

import os
from typing import Any, BinaryIO, NamedTuple

MAGIC = b"PAR1"
MOST_FOOTER = 2**27
"""Bytes: 100 columns in 4000 row groups have some 6e7."""
# Noise does not shrink, a constant does, by this much at most: beyond it a file is made to fill the memory.
_SHRINKS, _SMALL = 2000, 2**26
_DEEPEST = 16
_STOP, _TRUE, _FALSE, _BYTE, _I16, _I32, _I64, _DOUBLE, _BINARY, _LIST, _SET, _MAP, _STRUCT = range(13)

# A struct is {number of a field: what it is}, a list [what its entries are]. Every list that the format knows stands
# here: the reader of the library takes the entries for what the format says, whatever the list itself says of them.
_KEY_VALUES: Any = [{}]
_CHUNK = {
    2: [_I32], 3: [_BINARY], 5: _I64, 6: _I64, 8: _KEY_VALUES, 13: [{}], 16: {2: [_I64], 3: [_I64]}, 17: {2: [_I32]},
}  # fmt: skip
_GROUP = {1: [{3: _CHUNK, 8: {2: {1: [_BINARY]}}}], 3: _I64, 4: [{}]}
_FILE = {2: [{}], 3: _I64, 4: [_GROUP], 5: _KEY_VALUES, 7: [{}]}
_BYTES = {_TRUE: 1, _FALSE: 1, _BYTE: 1, _DOUBLE: 8}


class Demand(NamedTuple):
    """What a file says it holds."""

    rows: int
    row_groups: int
    columns: int
    bytes: int
    """Of all columns: eight for every value, or as many as they have unpacked where that is more."""


def demand_of(file: BinaryIO, most: int) -> Demand:
    """Read what a Parquet file asks for: a few bytes of a repeated value can stand for terabytes.

    Args:
        file: open for reading bytes, at any place.
        most: bytes that its columns may have, unpacked.

    Raises:
        ValueError: damaged, no Parquet file, or made to fill the memory.
    """
    size = file.seek(0, os.SEEK_END)
    if size < 12:
        raise ValueError(f"{size} bytes are no Parquet file")
    file.seek(size - 8)
    end = file.read(8)
    length = int.from_bytes(end[:4], "little")
    if end[4:] != MAGIC:
        raise ValueError("it does not end as a Parquet file does")
    if not 0 < length <= min(size - 12, MOST_FOOTER):
        raise ValueError(f"a footer of {length} bytes in {size}")
    file.seek(size - 8 - length)
    try:
        footer, read = _struct(file.read(length), 0, _FILE)
    except IndexError as error:
        raise ValueError("its footer is cut short") from error
    if read != length:
        raise ValueError(f"a footer of {length} bytes, of which {read} are used")
    asked = _demand(footer)
    if asked.bytes > min(most, max(_SMALL, _SHRINKS * size)):
        raise ValueError(f"{size} bytes that ask for {asked.bytes}")
    return asked


def _demand(footer: dict[int, Any]) -> Demand:
    groups = _of(footer, 4)
    chunks = [_of(_of(chunk, 3), part) for group in groups for chunk in _of(group, 1) for part in (5, 6)]
    rows = [_of(footer, 3), *(_of(group, 3) for group in groups)]
    if min(rows + chunks) < 0 or rows[0] != sum(rows[1:]):
        raise ValueError("numbers of rows or bytes that no file has")
    asked = sum(max(8 * values, unpacked) for values, unpacked in zip(chunks[::2], chunks[1::2], strict=True))
    return Demand(rows[0], len(groups), len(chunks) // 2, asked)


def _of(struct: dict[int, Any], field: int) -> Any:
    if field not in struct:
        raise ValueError(f"field {field} of the footer is missing")
    return struct[field]


def _struct(data: bytes, at: int, known: dict[int, Any], depth: int = 0) -> tuple[dict[int, Any], int]:
    """Read the known fields of a struct, and read over the others; returns them and the place behind it."""
    found: dict[int, Any] = {}
    last = 0
    while head := data[at]:
        at += 1
        step, kind = head >> 4, head & 15
        if step:
            field = last + step
        else:
            field, at = _integer(data, at)
        if not last < field < 2**15:
            raise ValueError("a field that comes twice, or before its turn")
        last = field
        wanted = known.get(field)
        # A field of another type than the format says is read over by the library, too.
        if wanted is not None and kind == _kind(wanted):
            found[field], at = _value(data, at, kind, wanted, depth)
        elif kind not in (_TRUE, _FALSE):  # which are in the head
            _, at = _value(data, at, kind, None, depth)
    return found, at + 1


def _value(data: bytes, at: int, kind: int, known: Any, depth: int) -> tuple[Any, int]:
    """Read a value; ``known`` as in `_FILE`, None: it is read over."""
    if _I16 <= kind <= _I64:
        return _integer(data, at)
    if kind == _BINARY:
        size, at = _varint(data, at)
        return None, at + _fitting(size, data, at)
    if depth > _DEEPEST:
        raise ValueError("structs nested too deep")
    if kind == _STRUCT:
        return _struct(data, at, known or {}, depth + 1)
    if kind in (_LIST, _SET):
        size, inner, at = data[at] >> 4, data[at] & 15, at + 1
        if size == 15:
            size, at = _varint(data, at)
        if known and inner != _kind(known[0]):
            raise ValueError(f"a list of type {inner}, where the format has another")
        entries = []
        for _ in range(_fitting(size, data, at)):
            entry, at = _value(data, at, inner, known and known[0], depth + 1)
            if known:
                entries.append(entry)
        return entries, at
    if kind == _MAP:
        size, at = _varint(data, at)
        kinds, at = (data[at], at + 1) if size else (0, at)
        for _ in range(_fitting(size, data, at)):
            _, at = _value(data, at, kinds >> 4, None, depth + 1)
            _, at = _value(data, at, kinds & 15, None, depth + 1)
        return None, at
    if kind not in _BYTES:
        raise ValueError(f"type {kind}, which is none")
    return None, at + _BYTES[kind]


def _kind(known: Any) -> Any:
    return _STRUCT if type(known) is dict else _LIST if type(known) is list else known


def _integer(data: bytes, at: int) -> tuple[int, int]:
    number, at = _varint(data, at)
    return (number >> 1) ^ -(number & 1), at


def _varint(data: bytes, at: int) -> tuple[int, int]:
    number = data[at]
    if number < 128:
        return number, at + 1
    number &= 127
    for shift in range(7, 70, 7):
        at += 1
        number |= (data[at] & 127) << shift
        if data[at] < 128:
            return number, at + 1
    raise ValueError("a number of more than 64 bits")


def _fitting(size: int, data: bytes, at: int) -> int:
    """Return a number of bytes, or of entries of a byte at least, that are still to come."""
    if size > len(data) - at:
        raise ValueError(f"{size} bytes or entries, where {len(data) - at} bytes are left")
    return size

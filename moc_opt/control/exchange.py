"""Shared memory between a control loop and a solver's process: one request, one answer, both of fixed size.

Each side writes one slot and reads the other. A slot begins and ends with the number of the request: the writer sets
``begin``, then the contents, then ``end``; a reader copies what lies between and takes it where both numbers still
agree (a seqlock). Neither side waits for the other, and no object is pickled. The memory is an anonymous file: no other
process can open it by name, and a kill leaves nothing behind.
"""

from __future__ import annotations

import fcntl
import mmap
import os
from typing import NamedTuple

import numpy as np

from moc_opt.errors import printable
from moc_opt.numerics.arrays import Array
from moc_opt.qp.problem import row_length
from moc_opt.solvers.base import Solution, Status

START, SOLVE = range(2)
"""Kinds of request: a session for problems like this one, or the answer to this one."""
ANSWERED, RAISED, MALFORMED, REFUSED = range(4)
"""Kinds of answer."""
OBSERVES = "observes"
"""Text of the answer to ``START`` if the session observes the measured velocity."""
MOST_TEXT = 1000
"""Largest length of a message [bytes]."""

_STATUSES = tuple(Status)
_BEGIN, _END, _COMMAND, _OBSERVES = range(4)  # of a request's head
_KIND, _STATUS, _ITERATIONS, _HAS_DUALS, _LENGTH = range(2, 7)  # of an answer's head, after begin and end


def _layout(n: int) -> np.dtype[np.void]:
    return np.dtype([
        ("request", np.int64, 4), ("row", np.float64, row_length(n)), ("v", np.float64, n),
        ("answer", np.int64, 7), ("x", np.float64, n), ("y", np.float64, 6), ("text", np.uint8, MOST_TEXT),
        ("memory", np.int64, 1),
    ])  # fmt: skip


def size(n: int) -> int:
    """Compute the bytes of the memory for n joints."""
    return _layout(n).itemsize


class Request(NamedTuple):
    """A request of the loop; the arrays are copies."""

    number: int
    command: int
    row: Array
    v: Array | None
    """(n,) measured velocity [rad/s] for a session that observes it."""


class Answer(NamedTuple):
    """The answer to a request; x and y are copies."""

    number: int
    """Number of the request."""
    kind: int
    solution: Solution
    text: str


class Exchange:
    """Both slots, in the memory behind a file descriptor of at least ``size(n)`` bytes."""

    def __init__(self, fd: int, n: int) -> None:
        self._block = np.frombuffer(mmap.mmap(fd, size(n)), dtype=_layout(n), count=1)[0]
        self._request, self._row, self._v = (self._block[name] for name in ("request", "row", "v"))
        self._answer, self._x, self._y = (self._block[name] for name in ("answer", "x", "y"))
        self._text, self._memory = self._block["text"], self._block["memory"]

    def post(self, number: int, command: int, row: Array, v: Array | None = None) -> None:
        """Write a request over the one before."""
        head = self._request
        head[_BEGIN] = number
        head[_COMMAND], self._row[:] = command, row
        head[_OBSERVES] = v is not None
        if v is not None:
            self._v[:] = v
        head[_END] = number

    def request(self, after: int) -> Request | None:
        """Return the newest request; None where it is not newer than number ``after``."""
        while True:
            number = int(self._request[_END])
            if number <= after:
                return None
            found = Request(
                number, int(self._request[_COMMAND]), self._row.copy(),
                self._v.copy() if self._request[_OBSERVES] else None,
            )  # fmt: skip
            if self._request[_BEGIN] == number:
                return found

    def give(self, number: int, kind: int, solution: Solution, text: str = "") -> None:
        """Write the answer to a request over the one before."""
        head, said = self._answer, text.encode(errors="replace")[:MOST_TEXT]
        head[_BEGIN] = number
        head[_KIND], head[_STATUS] = kind, _STATUSES.index(solution.status)
        head[_ITERATIONS], head[_HAS_DUALS] = solution.iterations, solution.y is not None
        self._x[:] = solution.x
        if solution.y is not None:
            self._y[:] = solution.y
        head[_LENGTH], self._text[: len(said)] = len(said), np.frombuffer(said, dtype=np.uint8)
        head[_END] = number

    @property
    def answered(self) -> int:
        """Number of the newest request that has its answer."""
        return int(self._answer[_END])

    def answer(self, first: int) -> Answer | None:
        """Return the newest answer; None where it is to a request before number ``first``, or is being written.

        The contents come from another process: a status, length or kind out of range is never used as an index.
        """
        head = self._answer
        number = self.answered
        if number < first:
            return None
        status = _STATUSES[int(head[_STATUS]) % len(_STATUSES)]
        y = self._y.copy() if head[_HAS_DUALS] else None
        solution = Solution(self._x.copy(), y, status, int(head[_ITERATIONS]) & 0x7FFFFFFF)
        length = min(max(int(head[_LENGTH]), 0), MOST_TEXT)
        text = printable(bytes(self._text[:length]).decode(errors="replace")) if length else ""
        found = Answer(number, int(head[_KIND]), solution, text)
        return found if head[_BEGIN] == number else None

    @property
    def memory(self) -> int:
        """Bytes of memory that the solver's process had after its last answer."""
        return int(self._memory[0])

    @memory.setter
    def memory(self, found: int) -> None:
        self._memory[0] = found


def shared_file(contents: bytes, n: int) -> int:
    """Make an anonymous file: the memory for n joints, and ``contents`` after it; return its descriptor."""
    fd = os.memfd_create("moc_opt session", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
    os.pwrite(fd, contents, size(n))
    # Sealed: if one process made the file shorter, the other one would die of SIGBUS at its next access.
    fcntl.fcntl(fd, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW | fcntl.F_SEAL_SEAL)
    return fd

"""Cases in a process of their own: 2 GiB of addresses, and a death or a hang is a failure like any other."""

from __future__ import annotations

import os
import resource
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

from benchmarks.common.processes import Crashed, Hung, Raised, Worker, beat

MEMORY_BYTES = 2 * 2**30
"""Of the address space: with one thread for linear algebra all libraries together take 0.8 GiB of it."""
GRACE_S = 60.0
"""Beyond a case's limit, in which Python itself would have ended it: a library hangs."""
START_S = 600.0
"""In which the libraries are loaded and the kernels compiled."""
MOST_DEATHS = 3

Found = tuple[Counter[str], list[str]]
Explore = Callable[[str, int, int, Callable[[], Any]], Found]


def limited(explore: Explore, kind: str, cases: int, seed: int, done: Callable[[], Any], limit_s: float) -> Found:
    """Return ``explore(kind, cases, seed, done)`` from a process with limits; again with another seed after a death.

    Returns:
        as ``explore``; a process that died, or said nothing for ``limit_s`` and a minute, is a failure.
    """
    verdicts: Counter[str] = Counter()
    failures: list[str] = []
    counted = 0

    def count() -> None:
        nonlocal counted
        counted += 1
        done()

    with Worker(fresh=True) as worker:
        while verdicts.total() < cases and len(failures) < MOST_DEATHS:
            counted, drawn = 0, seed + 1000 * len(failures)
            try:
                ((found, more),) = worker.stream(
                    _explore, explore, kind, cases - verdicts.total(), drawn,
                    patience_s=limit_s + GRACE_S, first_s=START_S, on_beat=count,
                )  # fmt: skip
                return verdicts + found, failures + more
            except Raised as raised:
                raise (raised.__cause__ or raised) from None
            except (Hung, Crashed) as death:
                verdicts["accepted"] += counted  # those before it ended well, in one way or the other
                failures.append(f"Death: {death}, after {counted} cases of seed {drawn}")
    return verdicts, failures


def _explore(explore: Explore, kind: str, cases: int, seed: int) -> Iterator[Found]:
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    os.environ["ARROW_DEFAULT_MEMORY_POOL"] = "system"  # which gives back what one case has taken
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    yield explore(kind, cases, seed, beat)

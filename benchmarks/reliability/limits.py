"""Cases in a process of their own: 2 GiB of addresses, and a death or a hang is a failure like any other."""

from __future__ import annotations

import multiprocessing
import os
import resource
from collections import Counter
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

MEMORY_BYTES = 2 * 2**30
"""Of the address space: with one thread for linear algebra all libraries together take 0.8 GiB of it."""
GRACE_S = 60.0
"""Beyond a case's limit, in which Python itself would have ended it: a library hangs."""
START_S = 600.0
"""In which the libraries are loaded and the kernels compiled."""
MOST_DEATHS = 3

Explore = Callable[[str, int, int, Callable[[], Any]], tuple[Counter[str], list[str]]]


def limited(
    explore: Explore, kind: str, cases: int, seed: int, done: Callable[[], Any], limit_s: float
) -> tuple[Counter[str], list[str]]:
    """``explore(kind, cases, seed, done)`` in a process with limits; done again with another seed after a death.

    Returns:
        as ``explore``; a process that died, or said nothing for ``limit_s`` and a minute, is a failure.
    """
    verdicts: Counter[str] = Counter()
    failures: list[str] = []
    context = multiprocessing.get_context("spawn")
    while verdicts.total() < cases and len(failures) < MOST_DEATHS:
        ours, theirs = context.Pipe(duplex=False)
        left = cases - verdicts.total()
        process = context.Process(target=_work, args=(explore, kind, left, seed + 1000 * len(failures), theirs))
        process.start()
        theirs.close()
        counted, found = 0, None
        try:
            while found is None and ours.poll(limit_s + GRACE_S if counted else START_S):
                said = ours.recv()
                if said is None:
                    counted += 1
                    done()
                else:
                    found = said
            why = "hung"
        except EOFError:
            process.join()
            why = f"died with status {process.exitcode}"
        if found is None:
            process.kill()
            process.join()
            verdicts["accepted"] += counted  # those before it ended well, in one way or the other
            failures.append(f"Death: the process {why} after {counted} cases of seed {seed + 1000 * len(failures)}")
        else:
            process.join()
            verdicts += found[0]
            return verdicts, failures + found[1]
    return verdicts, failures


def _work(explore: Explore, kind: str, cases: int, seed: int, pipe: Connection) -> None:
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    os.environ["ARROW_DEFAULT_MEMORY_POOL"] = "system"  # which gives back what one case has taken
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    pipe.send(explore(kind, cases, seed, lambda: pipe.send(None)))

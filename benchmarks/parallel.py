"""The same job on much data, several processes at a time: for runs whose times are not what is measured."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import Any, TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


def run_parallel(
    work: Callable[[Item], Result], items: Sequence[Item], processes: int, done: Callable[[], Any]
) -> list[Result]:
    """``work`` on every item, results in the order of the items.

    Args:
        work: a function of a module; items and results must pickle.
        items: what to work on.
        processes: 1 works in this process.
        done: called after each item.
    """
    if processes < 2 or len(items) < 2:
        results = []
        for item in items:
            results.append(work(item))
            done()
        return results
    # Fresh interpreters: a fork would copy the state of libraries that run threads of their own.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(processes, len(items)), mp_context=context) as pool:
        futures = {pool.submit(work, item): place for place, item in enumerate(items)}
        found: dict[int, Result] = {}
        try:
            for future in as_completed(futures):
                found[futures[future]] = future.result()
                done()
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    return [found[place] for place in range(len(items))]

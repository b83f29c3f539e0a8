"""Work in threads: one block of an array for each core, by functions that release Python's global lock."""

import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from functools import cache

CORES = max(len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1, 1)
"""Cores that this process may use."""

_state = threading.local()


def run_in_threads(work: Callable[[slice], None], count: int, least: int) -> None:
    """Work on all items in this thread, or in one thread per core if there are more than `least`.

    Each item is worked on by itself, so that the result does not depend on the number of cores.

    Args:
        work: is given the items of a block; several blocks at a time. Calls of this function from it use one thread.
        count: number of items.
        least: number of items up to which threads cost more than they save: to hand over a block takes 0.05 ms.
    """
    n = min(CORES, count) if count > least and not getattr(_state, "is_working", False) else 1
    blocks = [slice(count * k // n, count * (k + 1) // n) for k in range(n)]
    if n > 1:
        tasks = [_threads().submit(_work, work, block) for block in blocks[1:]]
        try:
            _work(work, blocks[0])
        finally:
            wait(tasks)
        for task in tasks:
            task.result()
    elif count:
        work(blocks[0])


def _work(work: Callable[[slice], None], block: slice) -> None:
    _state.is_working = True
    try:
        work(block)
    finally:
        _state.is_working = False


@cache
def _threads() -> ThreadPoolExecutor:
    """Return the threads of this process: new ones would get their memory from the system each time."""
    return ThreadPoolExecutor(max(CORES - 1, 1), "scan-cell")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_threads.cache_clear)  # a fork has no threads of its parent

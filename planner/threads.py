"""Work in threads: one part of an array for each core, by functions that release Python's global lock."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

CORES = max(len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1, 1)
"""Cores that this process may use."""


def run_in_threads(work: Callable[[slice], None], count: int, least: int) -> None:
    """Work on all items in this thread, or in one thread per core if there are more than `least`.

    Each item is worked on by itself, so that the result does not depend on the number of cores. Threads live for one
    call, so that the process may be forked afterwards; to start one takes 0.1 ms.

    Args:
        work: is given the items of a part; several parts at a time.
        count: number of items.
        least: number of items up to which threads cost more than they save.
    """
    parts = min(CORES, count) if count > least else 1
    slices = [slice(count * part // parts, count * (part + 1) // parts) for part in range(parts)]
    if parts > 1:
        with ThreadPoolExecutor(parts - 1) as pool:
            tasks = pool.map(work, slices[1:])
            work(slices[0])
            list(tasks)
    elif count:
        work(slices[0])

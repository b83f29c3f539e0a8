"""How long a piece of work takes: the best of a few runs, on the wall clock and in processor time.

The best, because whatever else a machine does only ever adds. Processor time counts all cores and not what other
programs do; the wall clock is what a person waits for. The first run warms up what is loaded or compiled once.
"""

from collections.abc import Callable
from time import perf_counter, process_time
from typing import TypeVar

T = TypeVar("T")

_ENOUGH_S = 6.0  # after so much processor time no further run is begun


def best_of(work: Callable[[], T], repeats: int) -> tuple[T, dict[str, float]]:
    """Result of a work and its seconds: "work" on the wall clock, "processor" over all cores.

    Args:
        work: a function of nothing that gives the same result each time.
        repeats: runs at most; fewer where they take long.
    """
    wall: list[float] = []
    busy: list[float] = []
    while True:
        start, used = perf_counter(), process_time()
        result = work()
        wall.append(perf_counter() - start)
        busy.append(process_time() - used)
        if len(wall) >= repeats or sum(busy) > _ENOUGH_S:
            return result, {"work": min(wall), "processor": min(busy)}

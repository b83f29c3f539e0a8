"""Duration of a function: the best of a few runs, in wall-clock time and in processor time.

The best run counts, because other load only adds time. Processor time includes all cores and excludes other programs;
the wall clock is the waiting time of a user. The first run loads and compiles code once.
"""

from collections.abc import Callable
from time import perf_counter, process_time
from typing import TypeVar

T = TypeVar("T")

_ENOUGH_S = 6.0  # no further run begins after this processor time


def best_of(work: Callable[[], T], repeats: int) -> tuple[T, dict[str, float]]:
    """Return the result of a function and its seconds: "work" on the wall clock, "processor" over all cores.

    Args:
        work: function without arguments that returns the same result each time.
        repeats: largest number of runs; fewer if they take long.
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

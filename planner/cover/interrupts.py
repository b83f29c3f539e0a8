"""Ctrl-C: heard during calls into compiled solvers that do not listen to it, and taken as the end of a search.

Python's handler of a signal runs when the main thread is back in Python. HiGHS lets go of the interpreter while it
works, so it is run in a thread of its own and the main thread waits in Python, where the signal reaches it at once. The
thread is abandoned then: it ends at the solver's own limits, or with the process.
"""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

from planner.cover.budget import Budget

Result = TypeVar("Result")


def interruptible(call: Callable[[], Result]) -> Result:
    """The result of a call, or the `KeyboardInterrupt` that came while it ran."""
    results: list[Result] = []
    errors: list[BaseException] = []

    def run() -> None:
        try:
            results.append(call())
        except BaseException as error:  # handed to the caller, whatever it is
            errors.append(error)

    thread = threading.Thread(target=run, name="solver", daemon=True)
    thread.start()
    thread.join()
    if errors:
        raise errors[0]
    return results[0]


@contextmanager
def ends_search(budget: Budget) -> Iterator[None]:
    """Ctrl-C inside the block leaves it and ends the search, which still has its best: no work is left then.

    A subclass of `KeyboardInterrupt` is a kill, not a wish for a result, and goes on to the caller.
    """
    try:
        yield
    except KeyboardInterrupt as stop:
        if type(stop) is not KeyboardInterrupt:
            raise
        budget.interrupted = True

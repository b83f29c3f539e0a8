"""Ctrl-C during calls into compiled solvers that do not listen to it.

Python's handler of a signal runs when the main thread is back in Python. HiGHS lets go of the interpreter while it
works, so it is run in a thread of its own and the main thread waits in Python, where the signal reaches it at once. The
thread is abandoned then: it ends at the solver's own limits, or with the process.
"""

import threading
from collections.abc import Callable
from typing import TypeVar

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

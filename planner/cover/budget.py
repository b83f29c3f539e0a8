"""What a search may spend, what is known so far, and Ctrl-C: the one place where a search is ended.

Work is counted in *touched matrix entries* plus a charge for each step and each simplex iteration, not in seconds: the
same seed and budget then give the same plan on every machine. A current core does `WORK_PER_SECOND` units in about a
second. The wall clock is only a guard; when it stops a search, `time_limited` says so and the promise of identical
results is void.

The incumbent is kept here and not in the solver, so that whoever holds the budget still has the best cover when a
solver is interrupted.
"""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

import numpy as np

from planner.errors import PlannerError
from planner.values import Ints

EFFORT_PER_SECOND = 500_000_000
"""Units that one core does in about a second; a budget of so many seconds is this many times that."""

DEFAULT_EFFORT = 1_000_000_000
"""Default budget of a selection: about two seconds; most end long before."""

LARGE = 5_000_000
"""Entries of a matrix from which on budgets grow with it: of what large ones get, half goes before the search (the
canonical form, the first choice, reductions)."""

LARGE_PACE = 1.25
"""What work on a larger one costs: no cache holds it."""

UNLIMITED_EFFORT = 10**15
"""A budget that only a clock ends."""

Result = TypeVar("Result")


def scaled_effort(work: int, n_entries: int) -> int:
    """A budget meant for matrices of up to `LARGE` entries, in proportion more for one of more."""
    return work * max(n_entries, LARGE) // LARGE


class Budget:
    """Work left, the clock, and the best choice and bound found so far (of the problem that is searched).

    Attributes:
        limit: work that may be spent.
        spent: work spent.
        time_limited: whether the wall clock stopped a search.
        interrupted: whether the user did (Ctrl-C).
        best: columns of the best choice so far; None before the first.
        objective: its objective (`Sets.objective`), the smaller the better.
        lower_bound: no choice has a smaller one.
        tolerance: objectives that differ by no more count as equal.
        pace: what is charged for a unit of work.
    """

    def __init__(
        self,
        limit: int = DEFAULT_EFFORT,
        time_limit_s: float | None = None,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        if limit < 0:
            raise PlannerError(f"the budget is {limit} units of work; it must be zero or above")
        if time_limit_s is not None and not time_limit_s >= 0:
            raise PlannerError(f"the time limit is {time_limit_s} s; it must be zero or above, or None")
        self.limit = limit
        self.spent = 0
        self.time_limited = False
        self.interrupted = False
        self.best: Ints | None = None
        self.objective = 0
        self.lower_bound = 0
        self.tolerance = 0
        self.pace = 1.0
        self._clock = clock
        self._deadline = None if time_limit_s is None else clock() + time_limit_s

    @property
    def left(self) -> int:
        """Work that is left; none once the user has interrupted."""
        return 0 if self.interrupted else max(self.limit - self.spent, 0)

    @property
    def seconds_left(self) -> float | None:
        """Seconds until the guard fires; None without a guard."""
        return None if self._deadline is None else max(self._deadline - self._clock(), 0.0)

    @property
    def proven(self) -> bool:
        """Whether the best choice is as good as the lower bound: nothing is left to search."""
        return self.best is not None and self.objective - self.tolerance <= self.lower_bound

    def spend(self, work: int) -> bool:
        """Book work and say whether the search may go on (work left, clock not run out, best not proven)."""
        self.spent += int(work * self.pace)
        if self._deadline is not None and self._clock() >= self._deadline:
            self.time_limited = True
            return False
        return self.left > 0 and not self.proven

    def offer(self, columns: Ints, objective: int) -> bool:
        """Keep a choice if it is better than the best so far."""
        if self.best is not None and objective >= self.objective:
            return False
        self.best, self.objective = np.array(columns, dtype=np.int64), objective
        return True

    def prove(self, lower_bound: int) -> None:
        """Note that no choice has a smaller objective."""
        self.lower_bound = max(self.lower_bound, lower_bound)

    def begin(self, tolerance: int = 0, lower_bound: int = 0) -> None:
        """Forget choice and bound: another problem is searched from here on, with what is left of work and time."""
        self.best, self.objective = None, 0
        self.tolerance, self.lower_bound = tolerance, lower_bound

    @contextmanager
    def portion(self, share: float) -> Iterator[None]:
        """Inside the block only this share of the work, and of the time, that is left may be spent."""
        limit, deadline = self.limit, self._deadline
        self.limit = self.spent + int(self.left * share)
        if deadline is not None:
            now = self._clock()
            self._deadline = now + share * max(deadline - now, 0.0)
        try:
            yield
        finally:
            self.limit, self._deadline = limit, deadline

    @contextmanager
    def ended_by_ctrl_c(self) -> Iterator[None]:
        """Ctrl-C inside the block leaves it and ends the search, which still has its best: no work is left then.

        A subclass of `KeyboardInterrupt` is a kill, not a wish for a result, and goes on to the caller.
        """
        try:
            yield
        except KeyboardInterrupt as stop:
            if type(stop) is not KeyboardInterrupt:
                raise
            self.interrupted = True


def interruptible(call: Callable[[], Result]) -> Result:
    """The result of a call into a compiled solver, or the `KeyboardInterrupt` that came while it ran.

    Python's handler of a signal runs when the main thread is back in Python. HiGHS lets go of the interpreter while it
    works, so it is run in a thread of its own and the main thread waits in Python, where the signal reaches it at once.
    The thread is abandoned then: it ends at the solver's own limits, or with the process.
    """
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

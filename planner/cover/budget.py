"""Effort budget of a solve: counted computing, Ctrl-C, and the incumbent.

Effort is counted in *touched matrix entries* plus a charge for each step and each simplex iteration, not in seconds:
equal seeds and budgets give equal plans on every machine. A current core does `EFFORT_PER_SECOND` units in about a
second.

The incumbent is kept here and not in the solver: if a solver is interrupted, the owner of the budget still has it.
"""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

import numpy as np

from planner.errors import PlannerError
from planner.interrupts import deferred_interrupt, raise_interrupt
from planner.values import Ints

EFFORT_PER_SECOND = 500_000_000
"""Units that one core does in about a second."""

DEFAULT_EFFORT = 1_000_000_000
"""Default budget of a selection: about two seconds; most selections end long before."""

LARGE = 5_000_000
"""Entries of a matrix from which budgets grow with it. For large matrices half of the effort precedes the search
(canonical form, first selection, reductions)."""

LARGE_PACE = 1.25
"""Charge of a unit of effort on a larger matrix, which does not fit into the CPU cache."""

_POLL_S = 0.1  # time between two questions for Ctrl-C while a compiled solver runs

Result = TypeVar("Result")


def scaled_effort(effort: int, n_entries: int) -> int:
    """Scale a budget for matrices of up to `LARGE` entries in proportion to a larger number of entries."""
    return effort * max(n_entries, LARGE) // LARGE


class Budget:
    """Remaining effort, and the incumbent and lower bound of the problem that is being solved.

    Attributes:
        limit: effort that may be spent.
        spent: effort spent.
        interrupted: whether Ctrl-C stopped a search.
        incumbent: columns of the best selection so far; None before the first.
        objective: its objective (`CoverInstance.objective`), which is minimised.
        lower_bound: lower bound on the objective of any selection.
        tolerance: difference up to which objectives count as equal.
        pace: charge of a unit of effort.
    """

    def __init__(self, limit: int = DEFAULT_EFFORT) -> None:
        if limit < 0:
            raise PlannerError(f"the budget is {limit} units of effort; it must be zero or above")
        self.limit = limit
        self.spent = 0
        self.interrupted = False
        self.incumbent: Ints | None = None
        self.objective = 0
        self.lower_bound = 0
        self.tolerance = 0
        self.pace = 1.0

    @property
    def remaining(self) -> int:
        """Remaining effort; none after Ctrl-C."""
        return 0 if self.interrupted else max(self.limit - self.spent, 0)

    @property
    def is_proven(self) -> bool:
        """Whether the incumbent is optimal: it meets the lower bound."""
        return self.incumbent is not None and self.objective - self.tolerance <= self.lower_bound

    def spend(self, effort: int) -> bool:
        """Charge effort; return whether to go on (effort remains, the incumbent is not proven)."""
        raise_interrupt()
        self.spent += int(effort * self.pace)
        return self.remaining > 0 and not self.is_proven

    def offer(self, columns: Ints, objective: int) -> bool:
        """Make a selection the incumbent if it is better; return whether it is."""
        if self.incumbent is not None and objective >= self.objective:
            return False
        self.incumbent, self.objective = np.array(columns, dtype=np.int64), objective
        return True

    def raise_lower_bound(self, lower_bound: int) -> None:
        """Set the lower bound if it is higher than the known one."""
        self.lower_bound = max(self.lower_bound, lower_bound)

    def begin(self, tolerance: int = 0, lower_bound: int = 0) -> None:
        """Begin with another problem: forget incumbent and bound, keep the remaining effort."""
        self.incumbent, self.objective = None, 0
        self.tolerance, self.lower_bound = tolerance, lower_bound

    @contextmanager
    def portion(self, share: float) -> Iterator[None]:
        """Limit the block to a share of the remaining effort."""
        limit = self.limit
        self.limit = self.spent + int(self.remaining * share)
        try:
            yield
        finally:
            self.limit = limit

    @contextmanager
    def stopped_by_interrupt(self) -> Iterator[None]:
        """Leave the block at Ctrl-C and end the search, which keeps its incumbent: no effort remains.

        A subclass of `KeyboardInterrupt` is a kill, not a request for a result; it is raised again.
        """
        try:
            with deferred_interrupt():
                yield
        except KeyboardInterrupt as stop:
            if type(stop) is not KeyboardInterrupt:
                raise
            self.interrupted = True


def interruptible(call: Callable[[], Result]) -> Result:
    """Return the result of a call into a compiled solver; Ctrl-C raises `KeyboardInterrupt` while it runs.

    Python handles a signal when the main thread is back in Python. HiGHS releases the interpreter lock, so it runs in
    another thread while the main thread waits in Python, where the signal arrives at once. The other thread is then
    abandoned: it ends at the solver's own limits, or with the process.
    """
    results: list[Result] = []
    errors: list[BaseException] = []

    def run() -> None:
        try:
            results.append(call())
        except BaseException as error:  # raised again by the caller
            errors.append(error)

    thread = threading.Thread(target=run, name="solver", daemon=True)
    thread.start()
    while thread.is_alive():
        thread.join(_POLL_S)
        raise_interrupt()
    if errors:
        raise errors[0]
    return results[0]

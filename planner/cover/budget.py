"""What a solver may spend, and what is known so far.

Work is counted in *touched matrix entries* plus a fixed charge for each step, not in seconds: the same seed and
budget then give the same plan on every machine. A current core does `WORK_PER_SECOND` units in about a second. The wall
clock is only a guard; when it stops a search, `time_limited` says so and the promise of identical results is void.

The incumbent is kept here and not in the solver, so that whoever holds the budget still has the best cover when a
solver is interrupted.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import ceil
from typing import Annotated, Any

import numpy as np

from planner.errors import PlannerError
from planner.values import Floats, Ints, Value

STEP_WORK = 12_000
"""Charge of one step of a search beyond the entries it touches: what its NumPy calls cost anyway."""

WORK_PER_SECOND = 500_000_000
"""Units that one core does in about a second; a budget of so many seconds is this many times that."""

DEFAULT_WORK = 600_000_000
"""Default budget of a selection: about one second."""

UNLIMITED_WORK = 10**15
"""A budget that only a clock ends."""

ROUNDING = 1e-6
"""Taken off before rounding up (above a bound of 1000 in proportion): far above the float error of L(u)."""


@dataclass(frozen=True, slots=True, eq=False)
class Bound(Value):
    """A proven lower bound.

    Attributes:
        dual: value L(u) of the multipliers.
        multipliers: (S,) u.
        reduced_costs: (V,) cost less the sum of the multipliers of the column's rows.
    """

    dual: float
    multipliers: Annotated[Floats, "S"]
    reduced_costs: Annotated[Floats, "V"]

    @property
    def value(self) -> int:
        """No cover costs less than this."""
        return max(ceil(self.dual - _rounding(self.dual)), 0)

    def useful(self, less_than: int) -> Any:
        """(V,) columns that some cover may contain which costs less than the given number (reduced-cost fixing)."""
        return self.dual + np.maximum(self.reduced_costs, 0.0) <= less_than - 1 + _rounding(less_than)


def _rounding(value: float) -> float:
    """What float error may have added to a bound of this size, generously."""
    return ROUNDING * max(1.0, value * 1e-3)


class Budget:
    """Work left, the clock, and the best cover and bound found so far (of the problem that the solver was given).

    Attributes:
        limit: work that may be spent.
        spent: work spent.
        time_limited: whether the wall clock stopped a search.
        interrupted: whether the user did (Ctrl-C).
        best: columns of the best cover so far; None before the first.
        best_cost: its cost.
        lower_bound: no cover costs less (at unit cost: has fewer columns).
        dual: the Lagrangian bound, once computed; its reduced costs tell the exact solver which columns to leave out.
    """

    def __init__(
        self,
        limit: int = DEFAULT_WORK,
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
        self.best_cost = 0
        self.lower_bound = 0
        self.dual: Bound | None = None
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
        """Whether the best cover costs as little as the lower bound: nothing is left to search."""
        return self.best is not None and self.best_cost <= self.lower_bound

    def spend(self, work: int) -> bool:
        """Book work and say whether the search may go on (work left, clock not run out, fewest not proven)."""
        self.spent += int(work)
        if self._deadline is not None and self._clock() >= self._deadline:
            self.time_limited = True
            return False
        return self.left > 0 and not self.proven

    def offer(self, columns: Ints, cost: int | None = None) -> bool:
        """Keep a cover if it costs less than the best so far.

        Args:
            columns: the cover.
            cost: what it costs; None: the number of columns.
        """
        cost = len(columns) if cost is None else cost
        if self.best is not None and cost >= self.best_cost:
            return False
        self.best, self.best_cost = np.array(columns, dtype=np.int64), cost
        return True

    def prove(self, lower_bound: int) -> None:
        """Note that no cover costs less."""
        self.lower_bound = max(self.lower_bound, lower_bound)

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

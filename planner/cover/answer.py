"""The answer to a cover problem: chosen views, what they cover and cost, and what is proven about both."""

from dataclasses import dataclass, field
from enum import Enum
from typing import Annotated

import numpy as np

from planner.values import Floats, Ints, Value


class CoverStatus(Enum):
    """How a selection ended; the value is the sentence for reports, without numbers (`Cover.sentence` has them)."""

    PROVEN = "proven best for these candidates and samples"
    BOUNDED = "within a known distance of the best for these candidates and samples"
    TIME_LIMITED = "the time limit stopped the search; within a known distance of the best"
    INTERRUPTED = "the search was interrupted; within a known distance of the best"
    NOTHING_COVERABLE = "no allowed view measures any sample"

    @property
    def sentence(self) -> str:
        """The status in words."""
        return str(self.value)


@dataclass(frozen=True, slots=True, eq=False)
class Cover(Value):
    """A selection of views and what is proven about it.

    Attributes:
        views: (n,) chosen columns of the matrix, the one that adds the largest area first.
        marginal_area: (n,) area of the rows whose demand each view is the first to satisfy [m^2].
        covered_area: area of the rows that have what they demand [m^2].
        coverable_area: area of the rows that some usable column covers [m^2].
        total_area: area of all rows [m^2].
        uncoverable_rows: rows that no usable column covers.
        pinned: views that the user fixed, ascending; they count in `views` and in `lower_bound`.
        status: how the selection ended.
        lower_bound: no selection that meets the target (with `max_views`: that covers as much) has fewer views.
        upper_area: no selection of as many views as were asked for covers more [m^2]; without `max_views` that is the
            coverable area.
        solver: name of the solver.
        effort: units of work spent (see `planner.cover.budget`).
        demand: load that every row was asked to have; the least where they were asked for different ones.
        unsatisfiable_rows: rows that some columns cover, but all of them together not as much as is demanded.
        cost_and_bound: cost of the views and a lower bound on it; None without costs.
        max_views: how many were allowed; None: as many as it takes.
        n_views_without_overlap: views of the best selection without the overlap constraint; None without one.
    """

    views: Annotated[Ints, "n"]
    marginal_area: Annotated[Floats, "n"]
    covered_area: float
    coverable_area: float
    total_area: float
    uncoverable_rows: Annotated[Ints, "_"]
    pinned: Annotated[Ints, "_"]
    status: CoverStatus
    lower_bound: int
    upper_area: float
    solver: str
    effort: int
    demand: int = 1
    unsatisfiable_rows: Annotated[Ints, "_"] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    cost_and_bound: tuple[float, float] | None = None
    max_views: int | None = None
    n_views_without_overlap: int | None = None

    @property
    def cost(self) -> float:
        """What the views cost together; their number where no costs were given."""
        return len(self.views) if self.cost_and_bound is None else self.cost_and_bound[0]

    @property
    def cost_bound(self) -> float:
        """No selection that meets the target (and contains the pinned views) costs less."""
        return self.lower_bound if self.cost_and_bound is None else self.cost_and_bound[1]

    @property
    def excess_views(self) -> int:
        """The plan has at most this many views more than the fewest."""
        return len(self.views) - self.lower_bound

    @property
    def gap(self) -> float:
        """(cost - bound on it) / cost, which without costs is (views - lower bound) / views; 0 for an empty plan."""
        return (self.cost - self.cost_bound) / self.cost if len(self.views) else 0.0

    @property
    def gap_percent(self) -> float:
        """With `max_views`: points of coverage (percent of the coverable area) that other views could add at most."""
        coverable = self.coverable_area
        return 100.0 * max(self.upper_area - self.covered_area, 0.0) / coverable if coverable > 0 else 0.0

    @property
    def sentence(self) -> str:
        """The status in words with its numbers."""
        if self.status is CoverStatus.NOTHING_COVERABLE:
            return self.status.sentence
        if self.max_views is not None:
            return self._sentence_of_area()
        best = "fewest" if self.cost_and_bound is None else "cheapest"
        best += " that hang together" if self.n_views_without_overlap is not None else ""
        if self.status is CoverStatus.PROVEN:
            return f"proven {best} for these candidates and samples"
        if self.cost_and_bound is not None:
            within = f"costs at most {100 * self.gap / (1 - self.gap):.3g} % more than the {best}"
        else:
            within = f"at most {self.excess_views} {'view' if self.excess_views == 1 else 'views'} more than the {best}"
        return f"{self.beginning}{within} for these candidates and samples"

    def _sentence_of_area(self) -> str:
        if self.covered_area >= self.coverable_area:
            return "these views measure everything that the candidates can"
        if self.status is CoverStatus.PROVEN:
            return "proven most that so many of these candidates measure of these samples"
        views = "1 view" if self.max_views == 1 else f"{self.max_views} views"
        points = max(self.gap_percent, 0.01)
        return f"{self.beginning}at most {points:.2f} points of coverage below the most that {views} can measure"

    @property
    def beginning(self) -> str:
        """How a sentence begins on a search that was ended from outside; empty where it was not."""
        if self.status is CoverStatus.TIME_LIMITED:
            return "the time limit stopped the search; "
        return "the search was interrupted; " if self.status is CoverStatus.INTERRUPTED else ""

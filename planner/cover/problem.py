"""The problem of view selection, told in the caller's own rows and columns.

    choose columns C, each at a cost, so that enough of the rows have what they demand

    minimise    sum_{j in C} cost_j + sum of the fixed costs of the groups that C touches
    subject to  the rows i with sum_{j in C} load_ij >= demand_i have the area that is asked for
                pinned columns are in C, banned ones are not, and where an overlap is asked for the views of C hang
                together

With `max_views` the question turns round: at most so many columns, the largest area. Plain set cover, k views on each
row, promises under pose errors (loads are logarithms of probabilities), a share of the area, seconds in place of
numbers, several set-ups of the part (groups) are all cases of this one value; `planner.cover.solve` answers it.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner.errors import PlannerError


@dataclass(frozen=True, slots=True)
class Overlap:
    """When two views count as joined; exactly one of the two is given.

    Scans can be brought into one frame by matching where the graph of joined views is connected (Scott, Roth, Rivest,
    "View planning with a registration constraint", 3DIM 2001, doi:10.1109/IM.2001.924423).

    Attributes:
        area: they share at least this [m^2].
        share: they share at least this share of what the smaller of them measures, 0 to 1.
    """

    area: float | None = None
    share: float | None = None

    def __post_init__(self) -> None:
        if (self.area is None) == (self.share is None):
            raise PlannerError("an overlap is either an area or a share of the smaller view; give one of them")
        if self.area is not None and not (0 < self.area < np.inf):
            raise PlannerError(f"the overlap is {self.area} m^2; it must be a finite area above 0")
        if self.share is not None and not 0 < self.share <= 1:
            raise PlannerError(f"the overlap is a share of {self.share}; it must be above 0 and at most 1")


@dataclass(frozen=True, slots=True, eq=False)
class CoverProblem:
    """What is to be covered, by what, at what cost; checked when it is solved.

    Attributes:
        matrix: (S, V) scipy sparse or dense: True where column j (a viewpoint) measures row i (a sample); whole numbers
            where columns bring different loads.
        areas: (S,) area of each row [m^2], finite, not negative.
        allowed: (V,) bool, which columns may be used (the reachable ones); None: all.
        coverage: share of the coverable area whose rows must have what they demand, 0 to 1; 1 means every row.
        max_views: at most so many columns, and the most area; None: the fewest or cheapest for the coverage.
        demand: load that each row asks for, 1 or more, or (S,) of them; of a row that all usable columns together
            cannot satisfy, all of them are asked for.
        costs: (V,) of each column, finite, above zero (seconds, say); None: 1 each, so that cost is the number.
        pinned: columns that must be chosen.
        banned: columns that must not; what they alone cover does not count as coverable.
        group: (V,) group 0, 1, ... of each column (its set-up, say); None: no groups.
        group_costs: (G,) what the first column of each group costs on top, zero or more.
        overlap: chosen columns must hang together by this measure; None: they need not.
        weights: (S,) what each row counts in place of its area in what is asked for; None: its area. With `max_views`
            the areas of the answer are of these weights.
        region: (S,) part 0, 1, ... of each row, where each part has a target of its own.
        region_coverage: in place of `coverage`, for each part: share of its coverable area (or weight).
    """

    matrix: Any
    areas: ArrayLike
    allowed: ArrayLike | None = None
    coverage: float = 1.0
    max_views: int | None = None
    demand: int | NDArray[np.int64] = 1
    costs: ArrayLike | None = None
    pinned: Iterable[int] = ()
    banned: Iterable[int] = ()
    group: ArrayLike | None = None
    group_costs: ArrayLike | None = None
    overlap: Overlap | None = None
    weights: ArrayLike | None = None
    region: ArrayLike | None = None
    region_coverage: tuple[float, ...] = ()

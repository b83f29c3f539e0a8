"""Views that keep their promise although the robot is not exactly where it says (Scott 2009).

Sample i is measured by view j with probability p_ij (`planner.measurability.pose_ensemble`). With errors that are
independent from view to view (an assumption: an error of calibration that all views share is not that), the plan C
misses it with probability prod (1 - p_ij). It counts as robustly covered where that is at most alpha:

    sum_{j in C} -log(1 - p_ij) >= -log(alpha)

a cover with demands (`planner.cover.demands`): each view brings its own part, cut at the whole. Parts are rounded down
to multiples of 2^-16 of the demand, so that the promise is kept exactly.
"""

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from fractions import Fraction
from math import ceil, log
from typing import Annotated, Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from planner.cover import demand_bound, demand_search
from planner.cover.told import told
from planner.cover.budget import Budget
from planner.cover.demands import DemandProblem
from planner.cover.prepared import Prepared, prepare
from planner.cover.canonical import TARGET_SLACK
from planner.cover.selection import Cover, beginning, solve
from planner.errors import PlannerError
from planner.measurability.pose_ensemble import ProbabilityLayer, credited
from planner.values import Floats, Ints, Value

ALPHA = 0.05
"""Default: a sample counts where the plan measures it with a probability of at least 95 %."""

DEMAND = 2**16
"""What a row demands, in whole parts."""

ROBUST_WORK = 1_500_000_000
"""Default budget: three to six seconds."""

BOUND_SHARE, SEARCH_SHARE = 0.4, 0.6
"""Of the budget for the bound, and of what is left then for the search before HiGHS."""


@dataclass(frozen=True, slots=True, eq=False)
class RobustCover(Value):
    """Views, and what they promise.

    Attributes:
        cover: the views, with their nominal areas (exact poses); its lower bound is on plans with this promise.
        alpha: probability with which a robustly covered sample may be missed.
        members: size of the ensemble that the probabilities are from; 0 for exact poses.
        robust_area: area of the rows that the views measure with probability 1 - alpha or more [m^2].
        robust_coverable_area: the same for all usable columns together [m^2].
        probability: (S,) of each row of the matrix, that any of the views measures it; none of more than credited.
    """

    cover: Cover
    alpha: float
    members: int
    robust_area: float
    robust_coverable_area: float
    probability: Annotated[Floats, "S"]

    @property
    def sentence(self) -> str:
        """The status in words with its numbers."""
        cover = self.cover
        if self.robust_coverable_area == 0.0:
            return "no sample can be measured with the probability that is asked for"
        if cover.excess <= 0:
            return "proven fewest with this promise, for these candidates and samples"
        views = "view" if cover.excess == 1 else "views"
        return beginning(cover.status) + (
            f"at most {cover.excess} {views} more than the fewest with this promise, for these candidates and samples"
        )


def check_alpha(alpha: float) -> None:
    """Refuse what is no probability of a miss.

    Raises:
        PlannerError: unless 0 < alpha < 1.
    """
    if not 0.0 < alpha < 1.0:
        raise PlannerError(
            f"alpha is {alpha}; it is the probability with which a sample may be missed and must be above 0 and below 1"
            " (with pose errors nothing is certain)"
        )


def views_for_promise(alpha: float, members: int) -> int:
    """Views that must measure a sample at least, each in every member of the ensemble, for the promise to hold."""
    check_alpha(alpha)
    if members == 0:
        return 1
    return ceil(log(alpha) / log(1.0 - float(credited(np.array([members]), members)[0])) - 1e-12)


def loads(layer: ProbabilityLayer, alpha: float, shape: tuple[int, int]) -> Any:
    """(S, V) csr_array of what each view brings to each sample, `DEMAND` being enough; rounded down."""
    p = layer.probability
    with np.errstate(divide="ignore"):
        parts = np.minimum(-np.log1p(-p) / -log(alpha), 1.0)
    # Parts within rounding of the whole are the whole: p = 1 - alpha alone must be enough.
    whole = np.floor(np.minimum(parts * (1 + 1e-12), 1.0) * DEMAND).astype(np.int64)
    return sp.csr_array((whole, layer.indices, layer.indptr), shape=shape)


def robust_cover(
    M: Any,
    layer: ProbabilityLayer,
    areas: ArrayLike,
    allowed: ArrayLike | None = None,
    *,
    alpha: float = ALPHA,
    rng: np.random.Generator,
    coverage: float = 1.0,
    pinned: Iterable[int] = (),
    banned: Iterable[int] = (),
    budget: int = ROBUST_WORK,
    time_limit_s: float | None = None,
    clock: Callable[[], float] = time.perf_counter,
) -> RobustCover:
    """Choose few columns with which enough area is measured with probability 1 - alpha or more.

    With exact poses (a layer without members) this is `planner.cover.solve`, to the bit.

    Args:
        M: (S, V) measurability matrix at exact poses; the layer has its entries.
        layer: probabilities of its entries.
        areas: (S,) area of each row [m^2].
        allowed: (V,) bool, which columns may be used; None: all.
        alpha: probability with which a sample may be missed, above 0 and below 1.
        rng: random choices of the search.
        coverage: share of the robustly coverable area that is asked for, 0 to 1.
        pinned: columns that must be part of the selection.
        banned: columns that must not.
        budget: units of work.
        time_limit_s: wall-clock guard [s].
        clock: seconds, for the guard.

    Raises:
        PlannerError: for input that `planner.cover.solve` refuses, or an alpha that is no probability of a miss.
    """
    check_alpha(alpha)
    pinned, banned = list(pinned), list(banned)
    ready = prepare(M, areas, allowed, pinned, banned, coverage=coverage)
    if layer.members == 0:
        cover = solve(
            M, areas, allowed, rng=rng, coverage=coverage, pinned=pinned, banned=banned,
            time_limit_s=time_limit_s, clock=clock,
        )  # fmt: skip
        return _result(ready, cover, loads(layer, alpha, np.shape(M)), layer, alpha)
    work = Budget(budget, time_limit_s, clock)
    found = ready.found
    brought = loads(layer, alpha, np.shape(M))
    of_problem = brought[found.rows][:, found.columns]
    enough = np.asarray(of_problem.sum(axis=1)).ravel() >= DEMAND
    units = found.problem.units[enough]
    required = ceil(Fraction(coverage) * int(units.sum()) * (1 - TARGET_SLACK))
    demand = np.full(int(enough.sum()), DEMAND, dtype=np.int64)
    problem = DemandProblem.of(of_problem[enough], demand, units, required, full=coverage == 1.0)
    if problem.trivial:
        chosen, least = ready.useful_fixed, len(ready.fixed)
    else:
        chosen, least = _choice(problem, ready, rng, work)
    cover = told(found, ready.fixed, chosen, least, solver="robust", work=work)
    return _result(ready, cover, brought, layer, alpha)


def _choice(problem: DemandProblem, ready: Prepared, rng: np.random.Generator, work: Budget) -> tuple[Ints, int]:
    """Greedy, bound, local search, HiGHS where it pays; columns of the canonical problem, and the bound."""
    fixed = ready.useful_fixed
    idle = len(ready.fixed) - len(fixed)
    chosen = demand_search.prune(problem, demand_search.greedy(problem, fixed), demand_search.NO_GRAPH, fixed)
    with work.portion(BOUND_SHARE):
        bound = demand_bound.lower_bound(problem, len(chosen), work)
    least = min(bound.value, len(chosen))
    with work.portion(SEARCH_SHARE):
        chosen = demand_search.improve(problem, chosen, rng, work, fixed=fixed, enough=least)
    if not len(fixed):  # the model knows nothing of pinned views; their bound is that of the free problem
        chosen, least = demand_bound.close_gap(problem, chosen, bound, work)
    if len(chosen) > least:
        chosen = demand_search.improve(problem, chosen, rng, work, fixed=fixed, enough=least)
    return chosen, max(min(least, len(chosen)), len(fixed)) + idle


def _result(ready: Prepared, cover: Cover, brought: Any, layer: ProbabilityLayer, alpha: float) -> RobustCover:
    """What the views promise on every row of the matrix."""
    areas = ready.found.areas
    sums = np.asarray(brought[:, cover.views].sum(axis=1)).ravel()
    usable = np.asarray(brought[:, ready.found.columns].sum(axis=1)).ravel()
    p = sp.csr_array((layer.probability, layer.indices, layer.indptr), shape=brought.shape)[:, cover.views]
    with np.errstate(divide="ignore"):
        p.data = np.log1p(-p.data)
    missed = np.asarray(p.sum(axis=1)).ravel()
    return RobustCover(
        cover=cover,
        alpha=alpha,
        members=layer.members,
        robust_area=float(areas[sums >= DEMAND].sum()),
        robust_coverable_area=float(areas[usable >= DEMAND].sum()),
        probability=-np.expm1(missed),
    )

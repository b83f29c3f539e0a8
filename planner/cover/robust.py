"""Views that keep their promise although the robot is not exactly where it says (Scott 2009).

Sample i is measured by view j with probability p_ij (`planner.measurability.pose_ensemble`). With errors that are
independent from view to view (an assumption: an error of calibration that all views share is not that), the plan C
misses it with probability prod (1 - p_ij). It counts as robustly covered where that is at most alpha:

    sum_{j in C} -log(1 - p_ij) >= -log(alpha)

a cover whose columns bring different loads (`planner.cover.CoverProblem`): each brings its own part, cut at the whole.
Parts are rounded down to multiples of 2^-16 of the demand, so that the promise is kept exactly.
"""

from dataclasses import dataclass, replace
from math import ceil, log
from typing import Annotated, Any

import numpy as np
import scipy.sparse as sp

from planner.cover.answer import Cover
from planner.cover.answer_of_columns import retold
from planner.cover.canonical import canonical
from planner.cover.problem import CoverProblem
from planner.cover.selection import solve
from planner.errors import PlannerError
from planner.measurability.pose_ensemble import ProbabilityLayer, credited_probability
from planner.values import Floats, Value

ALPHA = 0.05
"""Default: a sample counts where the plan measures it with a probability of at least 95 %."""

DEMAND = 2**16
"""What a row demands, in whole parts."""

ROBUST_EFFORT = 1_500_000_000
"""Default budget: three to six seconds."""


@dataclass(frozen=True, slots=True, eq=False)
class RobustCover(Value):
    """Views, and what they promise.

    Attributes:
        cover: the views, with their nominal areas (exact poses); its lower bound is on plans with this promise.
        alpha: probability with which a robustly covered sample may be missed.
        ensemble_size: size of the ensemble that the probabilities are from; 0 for exact poses.
        robust_area: area of the rows that the views measure with probability 1 - alpha or more [m^2].
        robust_coverable_area: the same for all usable columns together [m^2].
        probability: (S,) of each row of the matrix, that any of the views measures it; none of more than credited.
    """

    cover: Cover
    alpha: float
    ensemble_size: int
    robust_area: float
    robust_coverable_area: float
    probability: Annotated[Floats, "S"]

    @property
    def sentence(self) -> str:
        """The status in words with its numbers."""
        cover = self.cover
        if self.robust_coverable_area == 0.0:
            return "no sample can be measured with the probability that is asked for"
        if cover.excess_views <= 0:
            return "proven fewest with this promise, for these candidates and samples"
        views = "view" if cover.excess_views == 1 else "views"
        return cover.beginning + (
            f"at most {cover.excess_views} {views} more than the fewest with this promise, for these candidates and "
            "samples"
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


def min_views_at_confidence(alpha: float, members: int) -> int:
    """Views that must measure a sample at least, each in every member of the ensemble, for the promise to hold."""
    check_alpha(alpha)
    if members == 0:
        return 1
    return ceil(log(alpha) / log(1.0 - float(credited_probability(np.array([members]), members)[0])) - 1e-12)


def loads(layer: ProbabilityLayer, alpha: float, shape: tuple[int, int]) -> Any:
    """(S, V) csr_array of what each view brings to each sample, `DEMAND` being enough; rounded down."""
    p = layer.probability
    with np.errstate(divide="ignore"):
        parts = np.minimum(-np.log1p(-p) / -log(alpha), 1.0)
    # Parts within rounding of the whole are the whole: p = 1 - alpha alone must be enough.
    whole = np.floor(np.minimum(parts * (1 + 1e-12), 1.0) * DEMAND).astype(np.int64)
    return sp.csr_array((whole, layer.indices, layer.indptr), shape=shape)


def robust_cover(
    problem: CoverProblem,
    layer: ProbabilityLayer,
    *,
    alpha: float = ALPHA,
    rng: np.random.Generator,
    effort_budget: int = ROBUST_EFFORT,
) -> RobustCover:
    """Choose few columns with which enough area is measured with probability 1 - alpha or more.

    With exact poses (a layer without members) the cover is that of `planner.cover.solve`, to the bit.

    Args:
        problem: at exact poses; its coverage is a share of the area that can be promised.
        layer: probabilities of the entries of its matrix.
        alpha: probability with which a sample may be missed, above 0 and below 1.
        rng: random choices of the search.
        effort_budget: units of work.

    Raises:
        PlannerError: for input that `planner.cover.solve` refuses, or an alpha that is no probability of a miss.
    """
    check_alpha(alpha)
    problem = replace(problem, pinned=list(problem.pinned), banned=list(problem.banned))
    brought = loads(layer, alpha, np.shape(problem.matrix))
    nominal = canonical(replace(problem, coverage=0.0))
    enough = np.asarray(brought[:, nominal.columns].sum(axis=1)).ravel() >= DEMAND
    if layer.members == 0:
        cover = solve(problem, rng=rng)
    else:
        kept = sp.csr_array(brought)
        kept.data = kept.data * np.repeat(enough, np.diff(kept.indptr))
        asked = replace(problem, matrix=kept, demand=DEMAND)
        promised = solve(asked, rng=rng, effort_budget=effort_budget)
        cover = retold(nominal, replace(promised, solver="robust"), promised.views, problem)
    sums = np.asarray(brought[:, cover.views].sum(axis=1)).ravel()
    p = sp.csr_array((layer.probability, layer.indices, layer.indptr), shape=brought.shape)[:, cover.views]
    with np.errstate(divide="ignore"):
        p.data = np.log1p(-p.data)
    missed = np.asarray(p.sum(axis=1)).ravel()
    return RobustCover(
        cover=cover,
        alpha=alpha,
        ensemble_size=layer.members,
        robust_area=float(nominal.areas[sums >= DEMAND].sum()),
        robust_coverable_area=float(nominal.areas[enough].sum()),
        probability=-np.expm1(missed),
    )

"""Coverage at confidence 1 - alpha: views that measure a sample although the robot's pose is uncertain (Scott 2009).

View j measures sample i with probability p_ij (`planner.measurability.pose_ensemble`). The errors are assumed to be
independent from view to view; a calibration error that all views share is not. Then the selection C misses the sample
with probability prod (1 - p_ij). The sample is robustly covered if that is at most alpha:

    sum_{j in C} -log(1 - p_ij) >= -log(alpha)

This is a cover whose columns contribute different loads (`planner.cover.CoverProblem`), each limited to the demand.
Loads are rounded down to multiples of 2^-16 of the demand, so that the confidence holds exactly.
"""

from dataclasses import dataclass, replace
from math import ceil, log
from typing import Annotated, Any

import numpy as np
import scipy.sparse as sp

from planner.cover.answer import Cover, reweighted
from planner.cover.problem import CoverProblem
from planner.cover.reductions import canonical_form
from planner.cover.solve import solve
from planner.errors import PlannerError
from planner.measurability.pose_ensemble import ProbabilityLayer, credited_probability
from planner.values import Floats, Value

ALPHA = 0.05
"""Default: a sample counts if the plan measures it with a probability of at least 95 %."""

DEMAND = 2**16
"""Demand of a row in integer loads."""

ROBUST_EFFORT = 1_500_000_000
"""Default budget: three to six seconds."""


@dataclass(frozen=True, slots=True, eq=False)
class RobustCover(Value):
    """A selection of views and its coverage at confidence 1 - alpha.

    Attributes:
        cover: the views, with their areas at exact poses; its lower bound is on selections at this confidence.
        alpha: largest probability with which a robustly covered sample is missed.
        ensemble_size: size of the ensemble of the probabilities; 0 for exact poses.
        robust_area: area of the rows that the views measure with probability 1 - alpha or more [m^2].
        robust_coverable_area: the same for all usable columns together [m^2].
        probability: (S,) probability that any of the views measures each row of the matrix.
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
            return "no sample can be measured at the requested confidence"
        if cover.excess_views <= 0:
            return "proven fewest views at this confidence, for these candidates and samples"
        views = "view" if cover.excess_views == 1 else "views"
        return cover.termination + (
            f"at most {cover.excess_views} {views} more than the fewest views at this confidence, for these candidates "
            "and samples"
        )


def check_alpha(alpha: float) -> None:
    """Refuse an alpha that is no probability of a miss.

    Raises:
        PlannerError: unless 0 < alpha < 1.
    """
    if not 0.0 < alpha < 1.0:
        raise PlannerError(
            f"alpha is {alpha}; it is the probability with which a sample may be missed and must be above 0 and below 1"
            " (with pose errors nothing is certain)"
        )


def min_views_at_confidence(alpha: float, ensemble_size: int) -> int:
    """Return the number of views that must measure a sample, each in every member of the ensemble."""
    check_alpha(alpha)
    if ensemble_size == 0:
        return 1
    highest = float(credited_probability(np.array([ensemble_size]), ensemble_size)[0])
    return ceil(log(alpha) / log(1.0 - highest) - 1e-12)


def loads(layer: ProbabilityLayer, alpha: float, shape: tuple[int, int]) -> Any:
    """Return the load of each view for each sample as (S, V) csr_array, rounded down; `DEMAND` is enough."""
    with np.errstate(divide="ignore"):
        shares = np.minimum(-np.log1p(-layer.probability) / -log(alpha), 1.0)
    # Shares within rounding of 1 are 1: p = 1 - alpha alone must be enough.
    integers = np.floor(np.minimum(shares * (1 + 1e-12), 1.0) * DEMAND).astype(np.int64)
    return sp.csr_array((integers, layer.indices, layer.indptr), shape=shape)


def robust_cover(
    problem: CoverProblem,
    layer: ProbabilityLayer,
    *,
    alpha: float = ALPHA,
    rng: np.random.Generator,
    effort_budget: int = ROBUST_EFFORT,
) -> RobustCover:
    """Select few columns with which enough area is measured with probability 1 - alpha or more.

    With exact poses (a layer without ensemble) the cover is that of `planner.cover.solve`, to the bit.

    Args:
        problem: at exact poses; its coverage is a share of the area that is coverable at this confidence.
        layer: probabilities of the entries of its matrix.
        alpha: probability with which a sample may be missed, above 0 and below 1.
        rng: random draws of the search.
        effort_budget: units of effort.

    Raises:
        PlannerError: for input that `planner.cover.solve` refuses, or an alpha that is no probability of a miss.
    """
    check_alpha(alpha)
    integer_loads = loads(layer, alpha, np.shape(problem.matrix))
    nominal = canonical_form(replace(problem, coverage=0.0))
    coverable = np.asarray(integer_loads[:, nominal.columns].sum(axis=1)).ravel() >= DEMAND
    if layer.members == 0:
        cover = solve(problem, rng=rng)
    else:
        coverable_loads = sp.csr_array(integer_loads)
        coverable_loads.data = coverable_loads.data * np.repeat(coverable, np.diff(coverable_loads.indptr))
        robust = solve(replace(problem, matrix=coverable_loads, demand=DEMAND), rng=rng, effort_budget=effort_budget)
        cover = reweighted(problem, nominal, replace(robust, solver="robust"), robust.views)
    load_sums = np.asarray(integer_loads[:, cover.views].sum(axis=1)).ravel()
    p = sp.csr_array((layer.probability, layer.indices, layer.indptr), shape=integer_loads.shape)[:, cover.views]
    with np.errstate(divide="ignore"):
        p.data = np.log1p(-p.data)
    log_missed = np.asarray(p.sum(axis=1)).ravel()
    return RobustCover(
        cover=cover,
        alpha=alpha,
        ensemble_size=layer.members,
        robust_area=float(nominal.areas[load_sums >= DEMAND].sum()),
        robust_coverable_area=float(nominal.areas[coverable].sum()),
        probability=-np.expm1(log_missed),
    )

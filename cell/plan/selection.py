"""Selection of views: the request, the selection that answers it, and rows added until coverage holds on new samples.

    default      the fewest (or, with costs in seconds, the cheapest) views for a coverage, each sample once or k times
    max_views    the most coverage with at most k views
    overlap      the fewest views whose scans form a connected overlap graph
    pose errors  the fewest views that measure a sample with probability 1 - alpha under pose errors

`planner.cover` answers each. `cell.scene.model` checks which options can be combined.

A coverage below 1 must also hold on held-out samples. Views that measure 99 % of the matrix' samples measure less of
the held-out samples, because the matrix has too few samples on the slivers that the views leave. A higher target on the
matrix would cost views that measure next to nothing. Therefore fresh samples, neither the matrix' nor the held-out
ones, are drawn. All fresh samples of planning faces on which the views leave coverable samples become rows, and the
views are selected again (row generation).
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from types import MappingProxyType
from typing import cast

import numpy as np

from cell.errors import UnreachableError
from cell.plan.candidates import Cell, MeasuredSet
from cell.runs.folder import RunFolder
from cell.runs.schema import Curve, MinimumViews, RobustCoverage, RobustSelection
from cell.scene.model import PlanSettings, RegionTargets
from cell.session import Effort, PlotQueue, default_effort
from cell.world.measurability import PartSurface
from cell.world.model import World
from cell.world.prediction import Prediction
from planner import cover
from planner.cover import Cover, CoverProblem, CoverStatus, Overlap
from planner.cover.curve import CoverageCurve, coverage_curve
from planner.cover.overlap import OverlapGraph, overlap_graph
from planner.cover.robust import RobustCover, robust_cover
from planner.geometry.sampling import SurfaceSamples, draw_samples
from planner.kinematics.reach import Reach, add_configurations
from planner.measurability import quality
from planner.measurability.matrix import Measurability, append_rows, spread_measurability
from planner.measurability.pose_ensemble import (
    PoseError,
    ProbabilityLayer,
    credited_probability,
    probability_layer,
    simulate_executions,
)
from planner.measurability.visibility import apply_occluders, fill_matrix, find_measured
from planner.ports import JointLimits, Progress, SigmaScanner
from planner.tour.tour_search import DEFAULT_BUDGET, MotionBudget
from planner.tour.view_times import least_move_times
from planner.values import Bools, Floats, Ints

DEMANDED = 0.6
"""Share of the coverable samples of features that the demanded number of views measures. Their mean number counts, and
the last samples would cost most views."""

MIN_COST = 1e-6
"""Smallest cost of a view [s]: costs of a cover must be positive."""

MAX_RAISE = 0.002
"""Share by which a target on the matrix is raised at most before samples are added: one raise is usual."""

ALL = 0.99
"""Share of the coverable held-out samples up to which rows are added for a requested coverage of 1."""

ROUNDS = 6
"""Rounds of row generation at most; the views are selected again after each."""

N_FRESH = 20_000
"""Fresh samples of a round."""

SIMULATED_EXECUTIONS = 200
"""Simulated executions of a plan with pose errors."""

_N_SIMULATED_SAMPLES = 10_000  # held-out samples of a simulated execution: a share is then known to half a point
_N_RAISES = 6  # raises of a target; one or two close the gap on held-out samples; the last asks for full coverage
_RAISE_STEP = 0.0005  # share beyond the gap: without it the raised target would aim at the edge
_N_ADDED_ROWS = 4_000  # rows that a round adds at most, or twice the number of rows: later rounds add where needed
_N_REJECTED_NAMED = 3  # rejected candidates that are named if no view is left
_MAX_DEMAND = 2**31 - 1  # more views than any plan has; a larger demand does not fit NumPy's integers
_CURVE_SHARES = (0.9, 0.95, 0.98, 0.99, 0.995, 1.0)


class PinnedViewError(UnreachableError):
    """A pinned candidate cannot be part of a motion.

    Attributes:
        candidate: row of the viewpoints.
        reason: without a full stop.
    """

    def __init__(self, candidate: int, reason: str) -> None:
        super().__init__(
            f"candidate {candidate} is pinned and cannot be part of a motion: {reason}; pin another, or change the "
            "placement"
        )
        self.candidate, self.reason = candidate, reason


@dataclass(frozen=True, slots=True, eq=False)
class RegionGroups:
    """Targets of the regions of a part.

    Regions with a coverage of their own form one group each; all others share a group with the coverage of the plan.

    Attributes:
        group: (R,) group of each region.
        coverage: (P,) requested share of the coverable area of each group.
        views: (R,) views that must measure each sample.
        weight: (R,) weight of the area.
    """

    group: Ints
    coverage: Floats
    views: Ints
    weight: Floats

    @classmethod
    def of(cls, regions: Sequence[RegionTargets], plan: PlanSettings) -> "RegionGroups | None":
        """Collect the targets of a scene's regions, the rest included; None without regions."""
        if not regions:
            return None
        separate = [each for each in regions if each.is_measured and each.coverage is not None]
        shared = [each for each in regions if each.is_measured and each.coverage is None]
        first = int(bool(shared))  # the group that regions without a coverage share
        coverage = [plan.coverage] * first + [float(each.coverage or 0.0) for each in separate]
        return cls(
            np.array([first + separate.index(each) if each in separate else 0 for each in regions]),
            np.array(coverage or [plan.coverage]),
            np.array([min(plan.multiplicity if each.views is None else each.views, _MAX_DEMAND) for each in regions]),
            np.array([each.weight for each in regions]),
        )

    @property
    def is_plain(self) -> bool:
        """Whether the regions only limit which samples count."""
        return len(self.coverage) == 1 and bool((self.views == 1).all() and (self.weight == 1).all())

    def apply(self, problem: CoverProblem, rows: SurfaceSamples) -> CoverProblem:
        """Add demand, weights and targets of the regions to a cover problem."""
        assert rows.region is not None, "the part has regions"
        region = rows.region.astype(np.int64)
        if (self.views != problem.demand).any():
            problem = replace(problem, demand=self.views[region])
        if (self.weight != 1).any():
            problem = replace(problem, weights=rows.areas * self.weight[region])
        if problem.max_views is not None:
            return problem
        problem = replace(problem, coverage=float(self.coverage[0]))
        if len(self.coverage) > 1:
            problem = replace(problem, region=self.group[region])
        return problem

    def shares(self, prediction: Prediction, T_object_scanner: Floats) -> Floats:
        """Return the (P,) shares of the coverable held-out area that views (n, K, 4, 4) [m] measure."""
        seen = prediction.visible(T_object_scanner).covered
        return self.shares_of(prediction.samples, seen, prediction.coverable.covered)

    def shares_of(self, samples: SurfaceSamples, seen: Bools, coverable: Bools) -> Floats:
        """Return the (P,) seen shares of the coverable weight of (S,) samples."""
        assert samples.region is not None, "the part has regions"
        region = samples.region.astype(np.int64)
        weight, group = samples.areas * self.weight[region], self.group[region]
        n = len(self.coverage)
        seen_sum, coverable_sum = (np.bincount(group, weights=weight * rows, minlength=n) for rows in (seen, coverable))
        return np.divide(seen_sum, coverable_sum, out=np.ones(n), where=coverable_sum > 0)


@dataclass(frozen=True, slots=True, eq=False)
class Request:
    """Options of a plan with the values that they need.

    Attributes:
        plan: options of the scene.
        costs: (V,) cost of each view [s]; None: the number of views is minimised.
        layer: probabilities of the matrix' entries; None: poses are exact.
        regions: targets of the regions; None without regions.
        demand: (F,) views that measure `DEMANDED` of the samples on each triangle of the reference, where it is above
            1; None without such triangles.
        demand_of: (F,) number of the set of features whose samples have this share; None: all triangles are one set.
        order: candidates in visiting order, others are inserted where they cost least; None: any order.
        motion: budget of the search for a motion.
        effort: budget of the search for views.
    """

    plan: PlanSettings = field(default_factory=PlanSettings)
    costs: Floats | None = None
    layer: ProbabilityLayer | None = None
    regions: RegionGroups | None = None
    demand: Ints | None = None
    demand_of: Ints | None = None
    order: tuple[int, ...] | None = None
    motion: MotionBudget = DEFAULT_BUDGET
    effort: Effort = field(default_factory=default_effort)

    @property
    def overlap(self) -> Overlap | None:
        """Overlap that connects two views [m^2 or share]; None if none is required."""
        if self.plan.overlap_mm2 is not None:
            return Overlap(area=self.plan.overlap_mm2 * 1e-6)
        return None if self.plan.overlap_share is None else Overlap(share=self.plan.overlap_share)

    @property
    def demand_groups(self) -> Ints:
        """(F,) group of each triangle, from 1 for those that demand several views; others have 0."""
        assert self.demand is not None, "triangles demand several views"
        has_demand = self.demand > 1
        feature_set = has_demand if self.demand_of is None else self.demand_of
        group = np.zeros(len(has_demand), dtype=np.int64)
        group[has_demand] = 1 + np.unique(feature_set[has_demand], return_inverse=True)[1]
        return group

    @property
    def _is_single_cover(self) -> bool:
        return self.plan.max_views is None and self.plan.multiplicity == 1 and self.layer is None

    @property
    def allows_swaps(self) -> bool:
        """Whether a view may be swapped for others that measure the same samples."""
        has_plain_regions = self.regions is None or self.regions.is_plain
        is_simple = self.overlap is None and self.order is None and self.demand is None
        return self._is_single_cover and has_plain_regions and is_simple

    @property
    def targets(self) -> Floats:
        """(P,) requested share of the coverable area, of each group of regions."""
        return np.array([self.plan.coverage]) if self.regions is None else self.regions.coverage

    @property
    def is_evaluated(self) -> bool:
        """Whether the coverage must hold on held-out samples: it is below 1, and once a sample is enough."""
        return self._is_single_cover and bool((self.targets < 1).any())

    @property
    def is_complete(self) -> bool:
        """Whether everything coverable is requested, once a sample and of at least one selectable view."""
        return self._is_single_cover and bool((self.targets >= 1).all())

    @property
    def is_probed(self) -> bool:
        """Whether a short search is informative: the number of views counts, and no overlap is required."""
        return self.costs is None and self.overlap is None and self.plan.solver == "auto"

    @property
    def dwell_s(self) -> float:
        """Time at each view if time is minimised [s]; else 0."""
        return 0.0 if self.costs is None else self.plan.scan_s + self.plan.settle_s


@dataclass(frozen=True, slots=True, eq=False)
class Selection:
    """Selected views.

    Attributes:
        cover: the views with their bound.
        targets: (P,) target share of the coverable samples of the matrix, of each group of regions.
        sentence: status with its numbers.
        details: overlap graph or probabilities; None if the cover says all.
        cost_bound: lower bound on the cost of any selection for the requested coverage.
        shares: (P,) share of the coverable held-out samples that the views measure; 1 if it was not evaluated.
        is_weighted: whether shares refer to weighted areas, which the cover does not report.
    """

    cover: Cover
    targets: Floats
    sentence: str
    details: OverlapGraph | RobustCover | None = None
    cost_bound: float = 0.0
    shares: Floats = field(default_factory=lambda: np.ones(1))
    is_weighted: bool = False

    @property
    def target(self) -> float:
        """Target of the first group of regions; the only one without regions."""
        return float(self.targets[0])

    @property
    def claimed_coverage(self) -> Floats:
        """(P,) lower bound on the share of the coverable samples of the matrix that the views measure."""
        if self.is_weighted or len(self.targets) > 1:
            return self.targets
        return np.array([self.cover.covered_area / self.cover.coverable_area])

    @property
    def note(self) -> str:
        """Note for the user; empty if there is none."""
        if isinstance(self.details, OverlapGraph) and not self.details.is_connected:
            return f"{self.details.sentence}; request less overlap, or allow more candidates (standoffs, rolls)"
        return ""

    def satisfies(self, requested: Floats) -> bool:
        """Return whether the views measure the requested shares of the held-out samples."""
        return bool((self.shares >= requested).all())

    def almost_satisfies(self, requested: Floats) -> bool:
        """Return whether targets raised by `MAX_RAISE` at most are expected to satisfy the requested shares.

        A target above 1 cannot be met, however near it is.
        """
        needed = self._needed_targets(requested)
        return self.satisfies(requested) or bool((needed <= np.minimum(requested + MAX_RAISE, 1.0)).all())

    def raised_targets(self, requested: Floats) -> Floats:
        """Return (P,) targets on the matrix that are expected to satisfy the requested shares of held-out samples."""
        return np.minimum(self._needed_targets(requested), 1.0)

    def with_bounds_of(self, easier: "Selection") -> "Selection":
        """Return the selection with the bounds of a selection for lower targets, where they are better."""
        bounded = replace(self, cost_bound=easier.cost_bound)
        bound = min(easier.cover.lower_bound, len(self.cover.views))
        is_easier = bool((easier.targets <= self.targets).all())
        if not is_easier or self.cover.cost_and_bound is not None or bound <= self.cover.lower_bound:
            return bounded
        status = CoverStatus.PROVEN if bound >= len(self.cover.views) else self.cover.status
        cover = replace(self.cover, lower_bound=bound, status=status)
        return replace(bounded, cover=cover, sentence=cover.sentence)

    def _needed_targets(self, requested: Floats) -> Floats:
        gap = np.maximum(self.claimed_coverage - self.shares, 0.0)
        return np.asarray(requested + gap + np.where(self.shares < requested, _RAISE_STEP, 0.0))


@dataclass(frozen=True, slots=True, eq=False)
class SelectionProblem(MeasuredSet):
    """Measured candidates in a cell with a request.

    Attributes:
        request: options of the plan.
        cell: compiled, with its collision checker.
        limits: of the axes, scaled to the requested speed.
    """

    request: Request
    cell: Cell
    limits: JointLimits

    @property
    def world(self) -> World:
        """The compiled cell."""
        return self.cell.world

    @property
    def is_at_rest(self) -> bool:
        """Whether the arm stands still at a view; otherwise it sweeps."""
        return bool(self.candidates.T_object_scanner.shape[1] == 1)

    def usable(self, rejected: Collection[int] = ()) -> Bools:
        """Return (V,) whether each candidate is reachable, and neither banned nor rejected."""
        usable = np.asarray(self.reached.reachable).copy()
        usable[[*rejected, *self.request.plan.banned]] = False
        return usable

    def with_configurations(self, views: Ints, q: Floats) -> "SelectionProblem":
        """Return the problem with the (n, axes) configurations [rad] at which a motion takes (n,) candidates.

        Only angles of a rotary table may lie between the configurations of the reach.
        """
        return self if self.world.table is None else replace(self, reached=add_configurations(self.reached, views, q))

    def priced(self) -> "SelectionProblem":
        """Return the problem with the least time of each candidate as its cost."""
        home = self.world.home if self.is_at_rest else None
        return self.with_costs(least_view_times(self.request.plan, self.reached, home, self.limits))

    def with_costs(self, costs: Floats | None) -> "SelectionProblem":
        """Return the problem with the cost of each view; None: the fewest views."""
        return replace(self, request=replace(self.request, costs=costs))


def least_view_times(plan: PlanSettings, reached: Reach, home: Floats | None, limits: JointLimits) -> Floats:
    """Return the (V,) least time of each candidate in any plan [s]: scan, settling, and half of two moves.

    Args:
        plan: `scan_s` and `settle_s`.
        reached: configurations.
        home: (axes,) [rad]; None if views sweep: moves then count nothing.
        limits: of the axes, scaled to the requested speed.
    """
    moves = np.zeros(len(reached)) if home is None else least_move_times(reached.q, reached.offsets, home, limits)
    return np.maximum(plan.scan_s + plan.settle_s + moves, MIN_COST)


class Search(Enum):
    """Kind of a search for views."""

    PROBE = "short search for the requested coverage; its views may fall short"
    CONTINUED = "search that continues from a start; its views may fall short"
    REPEATED = "short search that continues from a start; its views may fall short"
    FULL = "search whose views hold the coverage on held-out samples; targets are raised if needed"


def select_views(
    problem: SelectionProblem,
    rng: np.random.Generator,
    *,
    M: Measurability | None = None,
    rejected: Mapping[int, str] = MappingProxyType({}),
    shaded: Mapping[int, str] = MappingProxyType({}),
    start: Selection | None = None,
    search: Search = Search.FULL,
) -> Selection:
    """Select views that answer the request.

    If a coverage below 1 holds on the matrix' samples but not on the held-out samples, its target on the matrix is
    raised. Two requests are answered on the matrix alone: the most coverage with k views has no target, and
    probabilities are unknown for samples without a row. One search continues throughout: each target, and each matrix
    with added rows, begins with the best views so far.

    Args:
        problem: candidates and request.
        rng: randomness of the search.
        M: measurability as the arm leaves it; None: that of the problem.
        rejected: candidates that may not be selected, with a reason each.
        shaded: candidates occluded by their own arm, with a reason each.
        start: earlier selection of the same candidates or fewer, or of fewer rows, from which the search continues.
        search: kind of the search.

    Raises:
        UnreachableError: if no view measures anything.
    """
    selection = _select(problem, problem.M if M is None else M, tuple(rejected), rng, start, search)
    if not len(selection.cover.views):
        reasons = [f"candidate {view}: {reason}" for view, reason in {**rejected, **shaded}.items()]
        more = [f"and {len(reasons) - _N_REJECTED_NAMED} more"] if len(reasons) > _N_REJECTED_NAMED else []
        why = "; ".join(reasons[:_N_REJECTED_NAMED] + more)
        raise UnreachableError(
            "no view is left that measures the part and can be reached by a collision-free motion"
            + (f" ({why})" if why else "")
            + "; change the placement, the standoff or the fixtures"
        )
    return selection


def _select(
    problem: SelectionProblem,
    M: Measurability,
    rejected: tuple[int, ...],
    rng: np.random.Generator,
    start: Selection | None,
    search: Search,
) -> Selection:
    request, plan, effort = problem.request, problem.request.plan, problem.request.effort
    cover_problem = CoverProblem(
        M.matrix(), M.samples.areas, problem.reached.reachable, coverage=plan.coverage, max_views=plan.max_views,
        demand=plan.multiplicity, costs=request.costs, pinned=plan.pinned, banned=(*rejected, *plan.banned),
        overlap=request.overlap,
    )  # fmt: skip
    if request.regions is not None:
        cover_problem = request.regions.apply(cover_problem, M.samples)
    if request.demand is not None:
        face = M.samples.face
        cover_problem = replace(cover_problem, demand=request.demand[face], region=request.demand_groups[face])
    if plan.max_views is not None:
        budget = cover.scaled_effort(effort.constrained_work, cover_problem.matrix.nnz)
        known = None if start is None else start.cover.views
        most = cover.solve(cover_problem, rng=rng, start=known, effort_budget=budget)
        return Selection(most, np.ones(1), most.sentence)
    if request.layer is not None:
        robust = robust_cover(cover_problem, request.layer.restricted_to(M), alpha=plan.alpha, rng=rng)
        return Selection(robust.cover, request.targets, robust.sentence, robust)
    if not request.is_evaluated:  # the coverage refers to the samples of the matrix alone
        work = effort.probe_work if search is Search.PROBE and request.is_probed else effort.cover_work
        return _cover(request, cover_problem, request.targets, rng, work, start)

    def solve(targets: Floats, work: int, start: Selection | None) -> Selection:
        is_short = request.is_probed or (request.costs is not None and start is not None)
        selection = _cover(request, cover_problem, targets, rng, work if is_short else effort.cover_work, start)
        poses = problem.candidates.T_object_scanner[selection.cover.views]
        if request.regions is None:
            return replace(selection, shares=np.array([problem.prediction.share_of_coverable(poses)]))
        shares = request.regions.shares(problem.prediction, poses)
        return replace(selection, shares=np.where(request.targets < 1, shares, 1.0))

    work = {Search.PROBE: effort.probe_work, Search.REPEATED: effort.repeat_work}.get(search, effort.selection_work)
    if start is None or search is not Search.FULL:
        targets = request.targets if start is None or search is Search.PROBE else start.targets
        start = solve(targets, work, start)
    if search is not Search.FULL or start.satisfies(request.targets):
        return start
    return _with_raised_targets(request.targets, start, lambda targets, last: solve(targets, effort.repeat_work, last))


def _with_raised_targets(
    requested: Floats, start: Selection, solve: Callable[[Floats, Selection], Selection]
) -> Selection:
    """Return the first selection that holds on held-out samples; targets of groups are raised where needed."""
    selection = start
    for raises in range(_N_RAISES):
        is_last = raises == _N_RAISES - 1
        more = np.ones(len(requested))
        if not is_last:
            more = np.maximum(selection.raised_targets(requested), selection.targets + _RAISE_STEP)
        targets = np.where(selection.shares < requested, np.minimum(more, 1.0), selection.targets)
        selection = solve(targets, selection).with_bounds_of(selection)
        if selection.satisfies(requested) or (selection.targets[selection.shares < requested] >= 1).all():
            break
    return selection


def _cover(
    request: Request, problem: CoverProblem, targets: Floats, rng: np.random.Generator, work: int,
    start: Selection | None,
) -> Selection:  # fmt: skip
    """Select the fewest or cheapest views for targets, with connected scans if overlap is required."""
    shares = (*targets.tolist(), *([] if request.demand is None else [DEMANDED] * int(request.demand_groups.max())))
    problem = replace(problem, coverage=shares[0], region_coverage=shares if len(shares) > 1 else ())
    if request.overlap is not None:
        budget = cover.scaled_effort(request.effort.constrained_work, problem.matrix.nnz)
        connected = cover.solve(problem, rng=rng, effort_budget=budget)
        graph = overlap_graph(problem, connected)
        return Selection(connected, targets, connected.sentence if graph.is_connected else graph.sentence, graph)
    known = None if start is None or request.plan.solver != "auto" else start.cover.views
    budget = cover.scaled_effort(work, problem.matrix.nnz)
    solution = cover.solve(problem, rng=rng, solver=request.plan.solver, start=known, effort_budget=budget)
    is_weighted = problem.weights is not None
    return Selection(solution, targets, solution.sentence, cost_bound=solution.cost_bound, is_weighted=is_weighted)


def select_with_row_generation(
    problem: SelectionProblem, surface: PartSurface, rng: np.random.Generator, fresh: np.random.Generator,
    *, is_short: bool = False,
) -> tuple[SelectionProblem, Selection]:  # fmt: skip
    """Select views, and add rows until the views hold the requested coverage on held-out samples.

    Args:
        problem: candidates and request.
        surface: the part.
        rng: randomness of the selection.
        fresh: draws the samples.
        is_short: whether short searches are enough, for views from which another search begins; they may fall slightly
            short. `select_thoroughly` continues from them.

    Returns:
        The problem with its rows, and the views. They fall short only if fresh samples show nothing more.
    """
    if problem.request.plan.fill != "aimed":
        return problem, select_views(problem, rng)
    if problem.request.is_complete and not is_short:
        problem, start = _with_rows_for_all(problem, surface, rng, fresh)
        return problem, select_views(problem, rng, start=start)
    if not problem.request.is_evaluated:
        return problem, select_views(problem, rng)
    requested, selection = problem.request.targets, None
    for left in reversed(range(ROUNDS + 1)):
        selection = select_views(problem, rng, start=selection, search=Search.PROBE)
        if selection.almost_satisfies(requested):
            selection = selection if is_short else continue_selection(problem, selection, rng)
            if selection.almost_satisfies(requested):
                break
        if not left:  # a selection that is raised and bounded afterwards must be of the same rows
            break
        if (larger := _with_more_rows(problem, selection, surface, fresh)) is None:
            break
        problem = larger
    if is_short and selection is not None:
        return problem, selection
    return problem, _with_most_coverage(problem, select_views(problem, rng, start=selection), rng)


def _with_rows_for_all(
    problem: SelectionProblem, surface: PartSurface, rng: np.random.Generator, fresh: np.random.Generator
) -> tuple[SelectionProblem, Selection]:
    """Add rows until views that measure all of them measure nearly all coverable held-out samples.

    The few samples of a coarse matrix need fewer views than a coverage just below 1 of the held-out samples.
    """
    for left in reversed(range(ROUNDS + 1)):
        selection = select_views(problem, rng, search=Search.PROBE)
        poses = problem.candidates.T_object_scanner[selection.cover.views]
        if not left or problem.prediction.share_of_coverable(poses) >= ALL:
            break
        if (larger := _with_more_rows(problem, selection, surface, fresh)) is None:
            break
        problem = larger
    return problem, selection


def _with_most_coverage(problem: SelectionProblem, fewest: Selection, rng: np.random.Generator) -> Selection:
    """Return as many views with the most coverage, so that a lower target never gives more than a higher one."""
    request, cover_ = problem.request, fewest.cover
    if not request.is_probed or request.regions is not None or len(cover_.views) < 2:
        return fewest
    most = select_views(_for_most_coverage(problem, len(cover_.views)), rng.spawn(1)[0], start=fewest).cover
    share = problem.prediction.share_of_coverable(problem.candidates.T_object_scanner[most.views])
    if len(most.views) != len(cover_.views) or share <= fewest.shares[0] or most.covered_area < cover_.covered_area:
        return fewest
    cover_ = replace(cover_, views=most.views, marginal_area=most.marginal_area, covered_area=most.covered_area)
    return replace(fewest, cover=cover_, shares=np.array([share]))


def _for_most_coverage(problem: SelectionProblem, max_views: int) -> SelectionProblem:
    """Return the problem for the most coverage with at most a number of views."""
    plan = problem.request.plan.model_copy(update={"max_views": max_views})
    effort = replace(problem.request.effort, constrained_work=problem.request.effort.selection_work)
    return replace(problem, request=replace(problem.request, plan=plan, effort=effort))


def select_thoroughly(problem: SelectionProblem, start: Selection, rng: np.random.Generator) -> Selection:
    """Continue from views of short searches with the full budget, over the same rows."""
    if start.almost_satisfies(problem.request.targets):
        start = continue_selection(problem, start, rng)
    return select_views(problem, rng, start=start)


def continue_selection(problem: SelectionProblem, probe: Selection, rng: np.random.Generator) -> Selection:
    """Continue the search from views that were selected shortly, with the full budget.

    Fewer views that fall slightly short of the requested coverage are searched again for a higher target.
    """
    if not problem.request.is_probed:  # the probe had the full budget
        return probe
    requested, targets = problem.request.targets, probe.raised_targets(problem.request.targets)
    if probe.satisfies(requested):  # if these views stay, then as views for targets that they meet
        targets = np.minimum(targets, probe.claimed_coverage)
    probe = replace(probe, targets=targets)
    selection = select_views(problem, rng, start=probe, search=Search.CONTINUED)
    if selection.satisfies(requested) or not probe.satisfies(requested):
        return selection
    # Fewer views that fall short: a few more of the matrix' samples, or else the views of the probe.
    again = replace(selection, targets=selection.raised_targets(requested))
    more = select_views(problem, rng, start=again, search=Search.REPEATED).with_bounds_of(selection)
    is_better = more.satisfies(requested) and len(more.cover.views) < len(probe.cover.views)
    return more if is_better else probe.with_bounds_of(selection)


def _with_more_rows(
    problem: SelectionProblem, selection: Selection, surface: PartSurface, fresh: np.random.Generator
) -> SelectionProblem | None:
    """Return the problem with fresh samples as rows; None if the views leave no coverable sample of a fresh pool."""
    known, T = problem.prediction, problem.candidates.T_object_scanner
    pool = draw_samples(surface.reference, surface.planning, N_FRESH, fresh)
    left = pool.pick(~find_measured(T[selection.cover.views], pool, known.scanner, known.casters))
    left = left.pick(find_measured(T[problem.usable()], left, known.scanner, known.casters))
    # All fresh samples of the planning faces that fail: the failing samples alone would overstate the failure.
    needed = np.isin(pool.planning_face, left.planning_face)
    rows = np.flatnonzero(needed)[:: 1 + int(needed.sum()) // max(2 * len(problem.M.samples), _N_ADDED_ROWS)]
    if not len(rows):
        return None
    added = measure_rows(problem, problem.reached.reachable, pool.pick(rows))
    return replace(problem, M=append_rows(problem.M, added, known.samples))


def measure_rows(measured: MeasuredSet, usable: Bools, samples: SurfaceSamples) -> Measurability:
    """Return the matrix of further samples for (V,) usable candidates, with occluders and limit on sigma applied."""
    columns, total, known = np.flatnonzero(usable), len(measured.candidates), measured.prediction
    candidates, scanner = measured.candidates.pick(columns), known.scanner
    part, occluders = known.casters
    M = apply_occluders(
        fill_matrix(candidates, samples, scanner, part), candidates, scanner, occluders, ray_caster=part
    )
    if measured.M.sigma is not None:
        M = quality.sigma_layer(M, candidates, cast(SigmaScanner, scanner), casters=(part, occluders))
    return spread_measurability(M, columns, total)


def select_least_time(
    problem: SelectionProblem, fewest: Selection, rng: np.random.Generator
) -> tuple[SelectionProblem, Selection]:
    """Price the views in seconds, and return the selection from which the search for less time begins.

    The search begins with the fewest views; then views and motion are selected in turns (`cell.plan.improvement`). No
    plan therefore takes longer than one that selects the fewest views and orders them afterwards. If views sweep, are
    rejected and selected again, or an option concerns them, the motion is no part of the selection.
    """
    problem = problem.priced()
    if not problem.request.allows_swaps:  # nothing is selected again once the motion is known
        return problem, select_views(problem, rng)
    # A bound for the requested coverage; the target of the views may be above it.
    start = replace(fewest, targets=problem.request.targets)
    cheapest = select_views(problem, rng, start=start, search=Search.CONTINUED)
    return problem, replace(fewest, cost_bound=cheapest.cost_bound)


def pose_error(plan: PlanSettings) -> PoseError:
    """Return the standard deviations of the scene in metres and radians."""
    return PoseError(plan.pose_sd_mm / 1000, float(np.deg2rad(plan.pose_sd_deg)))


def pose_probabilities(
    plan: PlanSettings, measured: MeasuredSet, rng: np.random.Generator, progress: Progress
) -> ProbabilityLayer:
    """Return the probabilities of the matrix' entries under the pose error of the scene."""
    errors, known = pose_error(plan).draw(plan.ensemble, rng), measured.prediction
    return probability_layer(
        measured.M, measured.candidates, known.scanner, known.casters, errors, columns=measured.reached.reachable,
        progress=progress,
    )  # fmt: skip


def simulate_pose_errors(
    plan: PlanSettings,
    robust: RobustSelection,
    T_object_poses: Floats,
    prediction: Prediction,
    rng: np.random.Generator,
    progress: Progress,
) -> RobustCoverage:
    """Execute the views with fresh pose errors, and compare with the coverage at confidence 1 - alpha.

    The selection knows an ensemble of errors and the samples of the matrix. Each simulated execution draws an error of
    its own for every view and measures held-out samples anew (docs/internals/coverage_requests.md).

    Args:
        plan: options of the scene.
        robust: numbers of the selection.
        T_object_poses: (n, K, 4, 4) views of the plan [m].
        prediction: held-out samples, scanner and casters.
        rng: draws samples, ensemble and executions.
        progress: called with (executions done, executions).
    """
    every = prediction.samples
    rows = np.sort(rng.permutation(len(every))[:_N_SIMULATED_SAMPLES])
    samples = every.pick(rows)
    area = samples.areas / samples.areas.sum()
    error, n = pose_error(plan), len(T_object_poses)

    def each(T: Floats) -> Bools:
        return find_measured(T, samples, prediction.scanner, prediction.casters, each=True)

    hits = np.zeros((len(samples), n), dtype=np.int64)
    for member in error.draw(plan.ensemble, rng):
        hits += each(T_object_poses @ member)
    p = credited_probability(hits, plan.ensemble) * each(T_object_poses)
    is_expected = np.prod(1.0 - p, axis=1) <= plan.alpha
    errors = error.draw(SIMULATED_EXECUTIONS * n, rng).reshape(SIMULATED_EXECUTIONS, n, 4, 4)
    times, share = simulate_executions(
        T_object_poses, samples, prediction.scanner, prediction.casters, errors, progress=progress
    )
    frequency = times / SIMULATED_EXECUTIONS
    is_achieved = frequency >= 1.0 - plan.alpha
    expected = float(area[is_expected].sum())
    return RobustCoverage(
        **dict(robust),
        executions=SIMULATED_EXECUTIONS,
        samples=len(samples),
        coverage=expected,
        simulated_coverage=float(area[is_achieved].sum()),
        confirmed_share=float(area[is_expected & is_achieved].sum()) / expected if expected else 1.0,
        mean_frequency=float((area * frequency)[is_expected].sum()) / expected if expected else 1.0,
        coverage_mean=float(share.mean()),
        coverage_min=float(share.min()),
    )


def curve_of_plan(
    problem: SelectionProblem, M: Measurability, selection: Selection, rng: np.random.Generator
) -> CoverageCurve:
    """Return the coverage over the number of views; the plan is one of its points.

    Args:
        problem: candidates and request; pinned and banned views hold for the curve too.
        M: measurability as arm and occluders leave it.
        selection: views of the plan.
        rng: randomness of the search.
    """
    request, known = problem.request, selection.cover
    is_full = request.allows_swaps and selection.target == 1.0 and request.costs is None
    plan = request.plan
    cover_problem = CoverProblem(
        M.matrix(), M.samples.areas, problem.reached.reachable, pinned=plan.pinned, banned=plan.banned
    )
    return coverage_curve(
        cover_problem, rng=rng, known_selections=[known.views],
        min_views_full_coverage=known.lower_bound if is_full else 0, effort_budget=request.effort.curve_work,
    )  # fmt: skip


def minimum_views_of(curve: CoverageCurve) -> Curve:
    """Return the fewest views for round shares of the coverable area, for report.json."""
    fewest = {share: curve.fewest_views(share) for share in _CURVE_SHARES}
    return Curve(
        minimum_views=[
            MinimumViews(share_of_coverable=share, views=n, lower_bound=least) for share, (n, least) in fewest.items()
        ]
    )


def write_curve(
    folder: RunFolder, plots: PlotQueue, curve: CoverageCurve, plan_views: int, plan_area: float,
    name: Callable[[int], int | str] = int,
) -> None:  # fmt: skip
    """Write `curve.json` and queue `curve.png`.

    Args:
        folder: run folder.
        plots: queue of plots.
        curve: coverage over the number of views.
        plan_views: number of views of the plan.
        plan_area: area of the matrix' samples that the plan measures [m^2].
        name: name of a column of the matrix.
    """
    folder.write_json(
        "curve.json",
        {
            "units": "fractions of the surface's area, over the samples of measurability.npz",
            "coverable": curve.coverable_area / curve.total_area,
            "points": [
                {
                    "n_views": int(n),
                    "coverage": float(area) / curve.total_area,
                    "upper_bound": float(upper) / curve.total_area,
                    "views": [name(view) for view in views],
                }
                for n, area, upper, views in zip(
                    curve.n_views, curve.covered_area, curve.upper_area, curve.views, strict=True
                )
            ],
            **minimum_views_of(curve).as_json(),
        },
    )
    percent = 100 / max(curve.coverable_area, 1e-300)
    plots.send(
        "coverage_over_views",
        folder.path / "curve.png",
        n_views=curve.n_views,
        covered=percent * curve.covered_area,
        bound=percent * curve.upper_area,
        plan_views=plan_views,
        plan=percent * plan_area,
    )

"""What a plan is asked for beyond the fewest views, and the selection that answers it.

    plain        the fewest (or, at a cost in seconds, the cheapest) views for a coverage, each sample once or k times
    max_views    the most coverage with at most k views
    overlap      the fewest views whose scans hang together
    promise      the fewest views that measure a sample with probability 1 - alpha although poses are off

`planner.cover` answers each; which wishes go together is checked where the scene is read (`cell.scene.model`).
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from cell.plan.region_goals import RegionGoals
from cell.scene.model import PlanSettings
from cell.world.prediction import Prediction
from planner import cover
from planner.cover import Cover, CoverProblem, CoverStatus, Overlap
from planner.cover.overlap import OverlapGraph, overlap_graph
from planner.cover.robust import RobustCover, robust_cover
from planner.kinematics.reach import Reach
from planner.measurability.matrix import Measurability
from planner.measurability.pose_ensemble import ProbabilityLayer
from planner.ports import JointLimits
from planner.tour.tour_search import DEFAULT_BUDGET, MotionBudget
from planner.tour.view_times import least_move_times
from planner.values import Floats
from planner.viewpoints.viewpoints import Viewpoints

_RAISES = 6  # of the target; one or two close the gap that the held-out samples show; the last asks for everything
LEAST_COST = 1e-6
"""Seconds that a view is taken to cost at least, as a cover's costs are above 0."""

_STEP = 0.0005  # beyond the gap [share]: without it the raised target would aim at the edge

RAISED = 0.002
"""Share by which a target is raised on the matrix before samples are added to it: one raise is usual."""

LOOK_WORK, WORK, AGAIN_WORK = cover.DEFAULT_EFFORT // 25, 2 * cover.DEFAULT_EFFORT // 5, cover.DEFAULT_EFFORT // 5
"""Of a look, of the search that goes on from it, and of each after that, should its views fall short by little."""

_MOST_WORK = 3 * cover.DEFAULT_EFFORT  # for the most area with k views, and for views that hang together


@dataclass(frozen=True, slots=True, eq=False)
class Request:
    """The wishes.

    Attributes:
        plan: the scene's table, which names and explains them.
        costs: (V,) seconds that each view is priced at; None where the number of views counts.
        layer: probabilities of the matrix' entries; None where poses count as exact.
        goals: what regions of the part ask for; None where it has none.
        order: candidates in the order in which they are visited, others where they cost least; None: in any order.
        motion: work that planning the motion may use.
    """

    plan: PlanSettings = field(default_factory=PlanSettings)
    costs: Floats | None = None
    layer: ProbabilityLayer | None = None
    goals: RegionGoals | None = None
    order: tuple[int, ...] | None = None
    motion: MotionBudget = DEFAULT_BUDGET

    @property
    def overlap(self) -> Overlap | None:
        """When two views count as joined [m^2 or share]; None where they need not be."""
        if self.plan.overlap_mm2 is not None:
            return Overlap(area=self.plan.overlap_mm2 * 1e-6)
        return None if self.plan.overlap_share is None else Overlap(share=self.plan.overlap_share)

    @property
    def exchangeable(self) -> bool:
        """Whether a view may be exchanged for others that measure the same: no wish hangs on it itself."""
        plain = self.plan.max_views is None and self.plan.multiplicity == 1
        plain = plain and (self.goals is None or self.goals.plain)
        return plain and self.overlap is None and self.layer is None and self.order is None

    @property
    def asked(self) -> Floats:
        """(P,) share of what is coverable that is asked of each part of the samples."""
        return np.array([self.plan.coverage]) if self.goals is None else self.goals.coverage

    @property
    def promises(self) -> bool:
        """Whether a coverage is kept on held-out samples: one below 1, once for each sample."""
        plain = self.plan.max_views is None and self.plan.multiplicity == 1 and self.layer is None
        return plain and bool((self.asked < 1).any())

    @property
    def brief(self) -> bool:
        """Whether a short search tells much: the number of views counts, which need not hang together."""
        return self.costs is None and self.overlap is None and self.plan.solver == "auto"

    @property
    def standing(self) -> float:
        """Seconds at each view, where time counts; 0 where the number of views does."""
        return 0.0 if self.costs is None else self.plan.scan_s + self.plan.settle_s


@dataclass(frozen=True, slots=True, eq=False)
class Selected:
    """Views that answer a request.

    Attributes:
        cover: the views.
        targets: (P,) share of the coverable samples of the matrix that was asked for, of each part.
        sentence: the status in words with its numbers.
        answer: what is known beyond the cover, which for most requests says all; else None.
        cost_bound: no selection for the coverage that the user asks for costs less, whatever `target` was raised to.
        shares: (P,) of what is coverable on the held-out samples, measured by the views; 1 where it was not looked at.
        weighted: whether shares are of weighted areas, which the cover does not tell.
    """

    cover: Cover
    targets: Floats
    sentence: str
    answer: OverlapGraph | RobustCover | None = None
    cost_bound: float = 0.0
    shares: Floats = field(default_factory=lambda: np.ones(1))
    weighted: bool = False

    @property
    def claimed(self) -> Floats:
        """(P,) share of what is coverable that the views measure on the matrix, or at least do."""
        if self.weighted or len(self.targets) > 1:
            return self.targets
        return np.array([self.cover.covered_area / self.cover.coverable_area])

    def keeps(self, asked: Floats) -> bool:
        """Whether the views measure the shares asked for on the held-out samples."""
        return bool((self.shares >= asked).all())

    def raised(self, asked: Floats) -> Floats:
        """(P,) targets on the matrix at which views should measure the shares asked for on the held-out samples too."""
        return np.minimum(self._wanted(asked), 1.0)

    def nearly(self, asked: Floats) -> bool:
        """Whether views keep the shares asked for, or should with targets raised by no more than `RAISED`.

        Where more than all of the matrix' samples would be wanted, no target helps, however near it is.
        """
        return self.keeps(asked) or bool((self._wanted(asked) <= np.minimum(asked + RAISED, 1.0)).all())

    def _wanted(self, asked: Floats) -> Floats:
        """(P,) shares of the matrix' samples by which a gap like that of these views is made up for; may exceed 1."""
        gap = np.maximum(self.claimed - self.shares, 0.0)
        return np.asarray(asked + gap + np.where(self.shares < asked, _STEP, 0.0))

    def bounded(self, easier: "Selected") -> "Selected":
        """With the bounds of one that was asked for less, where they are better."""
        known = replace(self, cost_bound=easier.cost_bound)
        bound = min(easier.cover.lower_bound, len(self.cover.views))
        less = bool((easier.targets <= self.targets).all())
        if not less or self.cover.cost_and_bound is not None or bound <= self.cover.lower_bound:
            return known
        status = CoverStatus.PROVEN if bound >= len(self.cover.views) else self.cover.status
        cover = replace(self.cover, lower_bound=bound, status=status)
        return replace(known, cover=cover, sentence=cover.sentence)

    @property
    def target(self) -> float:
        """Of the first part, which is all but where regions differ."""
        return float(self.targets[0])

    @property
    def note(self) -> str:
        """What the user should be told although the work goes on; empty where all is well."""
        if isinstance(self.answer, OverlapGraph) and not self.answer.is_connected:
            return f"{self.answer.sentence}; ask for less overlap, or allow more candidates (standoffs, rolls)"
        return ""


def select(
    request: Request,
    M: Measurability,
    reached: Reach,
    candidates: Viewpoints,
    prediction: Prediction,
    *,
    banned: tuple[int, ...],
    rng: np.random.Generator,
    looked: Selected | None = None,
    look: int = 0,
) -> Selected:
    """Answer a request.

    A coverage below 1 is a promise about the surface: where a cover keeps it on the matrix' samples but not on the
    held-out ones, its target on the matrix is raised. Two promises are kept on the matrix alone: the most coverage
    with k views has no target, and probabilities are not known of samples that were not planned for.

    One search goes on throughout: each target, and each matrix with samples added, begins with the views that were
    best before. A look finds the target and where samples are missing; the work goes into the last target.

    Args:
        request: the wishes.
        M: measurability, with occluders and arm applied.
        reached: which candidates may be used.
        candidates: the columns of M.
        prediction: held-out samples.
        banned: candidates that turned out to be of no use; those that the user bans come on top.
        rng: randomness of the selection.
        looked: the answer of a look at the same, or at fewer samples or candidates; it is searched on from there.
        look: work of a search that is enough, and whose views may miss the promise; 0: the views of a plan.
    """
    plan = request.plan
    wish = CoverProblem(
        M.matrix(), M.samples.areas, reached.reachable, coverage=plan.coverage, max_views=plan.max_views,
        demand=plan.multiplicity, costs=request.costs, pinned=plan.pinned, banned=(*banned, *plan.banned),
        overlap=request.overlap,
    )  # fmt: skip
    if request.goals is not None:
        wish = request.goals.applied(wish, M.samples)
    if plan.max_views is not None:
        most = cover.solve(wish, rng=rng, effort_budget=cover.scaled_effort(_MOST_WORK, wish.matrix.nnz))
        return Selected(most, np.ones(1), most.sentence)
    if request.layer is not None:
        robust = robust_cover(wish, request.layer.within(M), alpha=plan.alpha, rng=rng)
        return Selected(robust.cover, request.asked, robust.sentence, robust)
    if not request.promises:  # of the matrix' samples that is all that it can be asked
        return _cover(request, wish, request.asked, rng, cover.DEFAULT_EFFORT, looked)

    def solve(targets: Floats, work: int, start: Selected | None) -> Selected:
        short = request.brief or (request.costs is not None and start is not None)
        found = _cover(request, wish, targets, rng, work if short else cover.DEFAULT_EFFORT, start)
        poses = candidates.T_object_scanner[found.cover.views]
        if request.goals is None:
            return replace(found, shares=np.array([prediction.share_of_coverable(poses)]))
        return replace(found, shares=np.where(request.asked < 1, request.goals.shares(prediction, poses), 1.0))

    if look or looked is None:
        looked = solve(request.asked if looked is None or look == LOOK_WORK else looked.targets, look or WORK, looked)
    return looked if look or looked.keeps(request.asked) else _raised(request.asked, looked, solve)


def _raised(asked: Floats, looked: Selected, solve: Callable[[Floats, int, Selected | None], Selected]) -> Selected:
    """The first cover that keeps the promise, the targets of its parts raised where they have to be."""
    found = looked
    for raises in range(_RAISES):
        more = np.ones(len(asked)) if raises == _RAISES - 1 else np.maximum(found.raised(asked), found.targets + _STEP)
        targets = np.where(found.shares < asked, np.minimum(more, 1.0), found.targets)
        before, found = found, solve(targets, AGAIN_WORK, found)
        found = found.bounded(before)
        if found.keeps(asked) or (found.targets[found.shares < asked] >= 1).all():
            break
    return found


def _cover(
    request: Request, wish: CoverProblem, targets: Floats, rng: np.random.Generator, work: int, start: Selected | None
) -> Selected:
    """The fewest or cheapest views for the targets of all parts, which hang together where that is asked."""
    one = len(targets) == 1
    wish = replace(wish, coverage=float(targets[0]), region_coverage=() if one else tuple(targets.tolist()))
    if request.overlap is not None:
        joined = cover.solve(wish, rng=rng, effort_budget=cover.scaled_effort(_MOST_WORK, wish.matrix.nnz))
        how = overlap_graph(wish, joined)
        return Selected(joined, targets, joined.sentence if how.is_connected else how.sentence, how)
    known = None if start is None or request.plan.solver != "auto" else start.cover.views
    work = cover.scaled_effort(work, wish.matrix.nnz)
    chosen = cover.solve(wish, rng=rng, solver=request.plan.solver, start=known, effort_budget=work)
    weighted = wish.weights is not None
    return Selected(chosen, targets, chosen.sentence, cost_bound=chosen.cost_bound, weighted=weighted)


def seconds_of_views(plan: PlanSettings, reached: Reach, home: Floats | None, limits: JointLimits) -> Floats:
    """(V,) seconds that each candidate takes at least in any plan: a scan, settling, and half of two moves.

    Args:
        plan: `scan_s` and `settle_s`.
        reached: joint solutions.
        home: (6,) joint angles [rad]; None where views sweep: the moves then count nothing.
        limits: of the axes, scaled to the speed that is wanted.
    """
    moves = np.zeros(len(reached)) if home is None else least_move_times(reached.q, reached.offsets, home, limits)
    return np.maximum(plan.scan_s + plan.settle_s + moves, LEAST_COST)

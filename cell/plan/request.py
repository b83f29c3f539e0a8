"""What a plan is asked for beyond the fewest views, and the selection that answers it.

    plain        the fewest (or, at a cost in seconds, the cheapest) views for a coverage, each sample once or k times
    max_views    the most coverage with at most k views
    overlap      the fewest views whose scans hang together
    promise      the fewest views that measure a sample with probability 1 - alpha although poses are off

`planner.cover` answers each; which wishes go together is checked where the scene is read (`cell.scene.plan_settings`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from cell.errors import SceneError
from cell.plan.region_goals import RegionGoals
from cell.rays.prediction import Prediction
from cell.scene.plan_settings import PlanSettings
from planner import cover
from planner.cover import Cover, CoverStatus, Overlap, Problem
from planner.cover.overlap import Connection, connection
from planner.cover.robust import RobustCover, robust_cover
from planner.measurability.matrix import Measurability
from planner.measurability.pose_ensemble import ProbabilityLayer
from planner.order.seconds_of_views import least_moves
from planner.order.tour import Tour
from planner.ports import JointLimits
from planner.reach.reach import Reach, Verdict
from planner.values import Floats, Ints
from planner.viewpoints.viewpoints import Viewpoints

_RAISES = 6  # of the target; one or two close the gap that the held-out samples show; the last asks for everything
LEAST_COST = 1e-6
"""Seconds that a view is taken to cost at least, as a cover's costs are above 0."""

_STEP = 0.0005  # beyond the gap [share]: without it the raised target would aim at the edge

RAISED = 0.002
"""Share by which a target is raised on the matrix before samples are added to it: one raise is usual."""

_LOOK_WORK = cover.DEFAULT_WORK // 5
"""Of a short search: nine of ten have the views of the whole work; what that adds is mostly proof."""

_LAST_WORK = cover.DEFAULT_WORK // 2  # after a look

_MOST_WORK = 3 * cover.DEFAULT_WORK  # for the most area with k views, and for views that hang together


@dataclass(frozen=True, slots=True, eq=False)
class Request:
    """The wishes.

    Attributes:
        plan: the scene's table, which names and explains them.
        costs: (V,) seconds that each view is priced at; None where the number of views counts.
        layer: probabilities of the matrix' entries; None where poses count as exact.
        goals: what regions of the part ask for; None where it has none.
        order: candidates in the order in which they are visited, others where they cost least; None: in any order.
        known: gives the motion through (n,) candidates at their (m, 6) joint solutions [rad] where one is known.
    """

    plan: PlanSettings = field(default_factory=PlanSettings)
    costs: Floats | None = None
    layer: ProbabilityLayer | None = None
    goals: RegionGoals | None = None
    order: tuple[int, ...] | None = None
    known: Callable[[Ints, Sequence[Floats]], Tour | None] | None = None

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
        short: share of what is coverable on the held-out samples that a coverage below 1 misses there; 0 where it is
            kept, or was not looked at.
    """

    cover: Cover
    targets: Floats
    sentence: str
    answer: Connection | RobustCover | None = None
    cost_bound: float = 0.0
    short: float = 0.0

    @property
    def target(self) -> float:
        """Of the first part, which is all but where regions differ."""
        return float(self.targets[0])

    @property
    def note(self) -> str:
        """What the user should be told although the work goes on; empty where all is well."""
        if isinstance(self.answer, Connection) and not self.answer.connected:
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
    look: bool = False,
) -> Selected:
    """Answer a request.

    A coverage below 1 is a promise about the surface: where a cover keeps it on the matrix' samples but not on the
    held-out ones, its target on the matrix is raised. Two promises are kept on the matrix alone: the most coverage
    with k views has no target, and probabilities are not known of samples that were not planned for.

    The raises are found by short searches, which seldom miss a view; the whole work goes into the last target alone.

    Args:
        request: the wishes.
        M: measurability, with occluders and arm applied.
        reached: which candidates may be used.
        candidates: the columns of M.
        prediction: held-out samples.
        banned: candidates that turned out to be of no use; those that the user bans come on top.
        rng: randomness of the selection.
        looked: the answer of a look at the same; it is searched on from there.
        look: whether a short search is enough, and a cover that misses the promise by more than `RAISED`.
    """
    plan = request.plan
    wish = Problem(
        M.matrix(), M.features.areas, reached.reachable, coverage=plan.coverage, max_views=plan.max_views,
        demand=plan.multiplicity, costs=request.costs, pinned=plan.pinned, banned=(*banned, *plan.banned),
        overlap=request.overlap,
    )  # fmt: skip
    if request.goals is not None:
        wish = request.goals.applied(wish, M.features)
    if plan.max_views is not None:
        most = cover.solve(wish, rng=rng, budget=_MOST_WORK)
        return Selected(most, np.ones(1), most.sentence)
    if request.layer is not None:
        robust = robust_cover(wish, request.layer.within(M), alpha=plan.alpha, rng=rng)
        return Selected(robust.cover, request.asked, robust.sentence, robust)
    if not request.promises:  # of the matrix' samples that is all that it can be asked
        return _cover(request, wish, request.asked, rng, cover.DEFAULT_WORK)

    def short(selected: Selected) -> Floats:
        poses = candidates.T_object_scanner[selected.cover.views]
        if request.goals is None:
            return request.asked - prediction.share_of_coverable(poses)
        return np.where(request.asked < 1, request.asked - request.goals.shares(prediction, poses), 0.0)

    brief = request.costs is None and request.overlap is None and plan.solver == "auto"
    work = _LOOK_WORK if brief else cover.DEFAULT_WORK
    found = looked or _raised(request, wish, rng, work, short, most=RAISED if look else 1.0)
    if look or not brief or found.cover.status is CoverStatus.PROVEN:
        return found
    thorough = _cover(request, wish, found.targets, rng, _LAST_WORK)
    if len(thorough.cover.views) < len(found.cover.views) and short(thorough).max() <= found.short:
        return replace(thorough, short=found.short)
    return _with_bound(found, thorough.cover.lower_bound)


def _raised(
    request: Request,
    wish: Problem,
    rng: np.random.Generator,
    work: int,
    short: Callable[[Selected], Floats],
    most: float,
) -> Selected:
    """The first cover that keeps the promise, the targets of its parts raised where they have to be.

    Where one would have to be raised by more than `most`, the cover that does not keep the promise.
    """
    targets, raises, least = request.asked, 0, 0.0
    while True:
        found = _cover(request, wish, targets, rng, work)
        least = least if raises else found.cost_bound
        lacks = short(found)
        found = replace(found, cost_bound=least, short=max(float(lacks.max()), 0.0))
        raises += 1
        more = np.ones(len(targets)) if raises == _RAISES else np.minimum(1.0, targets + lacks + _STEP)
        more = np.where(lacks > 0, more, targets)
        if (more <= targets).all() or (more > request.asked + most).any():
            return found
        targets = more


def _cover(request: Request, wish: Problem, targets: Floats, rng: np.random.Generator, work: int) -> Selected:
    """The fewest or cheapest views for the targets of all parts, which hang together where that is asked."""
    one = len(targets) == 1
    wish = replace(wish, coverage=float(targets[0]), part_coverage=() if one else tuple(targets.tolist()))
    if request.overlap is not None:
        joined = cover.solve(wish, rng=rng, budget=_MOST_WORK)
        how = connection(wish, joined)
        return Selected(joined, targets, joined.sentence if how.connected else how.sentence, how)
    chosen = cover.solve(wish, rng=rng, solver=request.plan.solver, budget=work)
    return Selected(chosen, targets, chosen.sentence, cost_bound=chosen.cost_bound)


def _with_bound(selected: Selected, bound: int) -> Selected:
    """With a bound that a longer search for the same target has proven."""
    bound = max(bound, selected.cover.lower_bound)
    proven = bound >= len(selected.cover.views)
    status = CoverStatus.PROVEN if proven else selected.cover.status
    cover = replace(selected.cover, lower_bound=min(bound, len(selected.cover.views)), status=status)
    return replace(selected, cover=cover, sentence=cover.sentence)


def check_named(plan: PlanSettings, reached: Reach) -> None:
    """Refuse pinned and banned candidates that do not exist, and pinned ones that the arm does not reach.

    Raises:
        SceneError: with the candidate and its verdict.
    """
    for key in ("pinned", "banned"):
        for view in getattr(plan, key):
            if view >= len(reached):
                raise SceneError(f"plan.{key} names candidate {view}; there are candidates 0 to {len(reached) - 1}")
    for view in plan.pinned:
        if not reached.reachable[view]:
            verdict = Verdict(int(reached.verdict[view]))
            blocker = f" ({reached.blocker[view]})" if reached.blocker[view] else ""
            raise SceneError(
                f"plan.pinned names candidate {view}, which is {verdict.sentence}{blocker}; pin another one, or move "
                "the part"
            )


def seconds_of_views(plan: PlanSettings, reached: Reach, home: Floats | None, limits: JointLimits) -> Floats:
    """(V,) seconds that each candidate takes at least in any plan: a scan, settling, and half of two moves.

    Args:
        plan: `scan_s` and `settle_s`.
        reached: joint solutions.
        home: (6,) joint angles [rad]; None where views sweep: the moves then count nothing.
        limits: of the axes, scaled to the speed that is wanted.
    """
    moves = np.zeros(len(reached)) if home is None else least_moves(reached.q, reached.offsets, home, limits)
    return np.maximum(plan.scan_s + plan.settle_s + moves, LEAST_COST)

"""Search fewer views over all reachable poses (`planner.viewpoints.pose_search`), after the cover over the candidates.

Moved views are appended to the candidates with exact columns of the matrix, so that selection, bound and motion see
ordinary candidates. Pinned views stay as they are, and a banned candidate is not used. Requests for which the search
has no meaning or no method are skipped, with the reason (`skip_reason`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from numpy.typing import NDArray

from cell.plan.candidates import GROWN, view_evaluator
from cell.plan.improvement import cover_of_views
from cell.plan.selection import Request, Search, Selection, SelectionProblem, continue_selection, select_views
from cell.world.measurability import PartSurface
from cell.world.prediction import Prediction
from planner.cover import CoverStatus
from planner.geometry.sampling import SurfaceSamples, draw_samples
from planner.interrupts import deferred_interrupt, raise_interrupt
from planner.measurability.direction_table import DirectionTable
from planner.measurability.matrix import Measurability
from planner.measurability.visibility import VisibilityMemo, find_measured
from planner.ports import DirectionCaster, Scanner
from planner.values import Bools, Floats, Ints
from planner.viewpoints.lines_of_sight import RayTargets
from planner.viewpoints.pose_sampling import find_frustum
from planner.viewpoints.pose_search import (
    EFFORTS,
    Place,
    SearchPoses,
    SearchProgress,
    Shortfall,
    search_poses,
)
from planner.viewpoints.viewpoints import Viewpoints, viewpoints_from_poses

Append = Callable[[SelectionProblem, Viewpoints], SelectionProblem]
"""Append viewpoints to the candidates of a problem."""

MANY_VIEWS = 25
"""Number of views above which the effort grows in proportion: each round moves all views."""

MARGIN = 0.0014
"""Share of the coverable area beyond the requested coverage that moved views measure at least."""

N_EVALUATED = 12_000
"""Samples on which poses are evaluated."""

EVALUATED_PER_VIEW = 600
"""The same for each view, if that is more: with fewer, many views measure the samples instead of the surface."""

MAX_EVALUATED = 40_000
"""Largest number of samples on which poses are evaluated."""

_DRAWN_PER_EVALUATED = 5 / 3  # samples that many candidates measure are thinned out of the drawn ones

N_COMPARED = 40_000
"""Samples on which found views are compared with those from which the search begins."""

_SAMPLING_ERROR = 3e-4  # of a share on the compared samples, so that it also holds on the held-out ones

_HALVINGS = 40  # of an interval that begins with (0, 1)


@dataclass(frozen=True, slots=True)
class PoseSearch:
    """Result of a pose search in numbers.

    Attributes:
        effort: name or number of the requested effort.
        evaluated: evaluated poses.
        n_views: number of views at its end.
        n_pinned: number of views among these that the request names.
        is_interrupted: whether Ctrl-C ended it.
    """

    effort: str
    evaluated: int
    n_views: int
    n_pinned: int = 0
    is_interrupted: bool = False

    def sentence(self, n_views: int) -> str:
        """Return the result for a plan of a number of views."""
        if not self.evaluated:
            return "Pose search was interrupted." if self.is_interrupted else "Poses were not searched."
        effort = f"interrupted, {self.effort}" if self.is_interrupted else self.effort
        begin = f"Pose search ({effort} effort, {self.evaluated:,} poses)"
        if n_views <= self.n_views:
            return f"{begin} found no plan with {n_views - 1}{' that keeps the given views' * bool(self.n_pinned)}."
        return f"{begin} found {self.n_views} views, which could not be connected."


def skip_reason(problem: SelectionProblem) -> str:
    """Return why poses are not searched for a request; "" if they are."""
    request, plan = problem.request, problem.request.plan
    if plan.candidates != GROWN:
        return f"the candidates are limited to {plan.candidates}"
    reasons = {
        "coverage 1": bool((request.targets >= 1).any()),
        "overlap": request.overlap is not None,
        "several views per sample": plan.multiplicity > 1,
        "a largest number of views": plan.max_views is not None,
        "pose errors": request.layer is not None,
        "targets of regions": request.regions is not None and not request.regions.is_plain,
        "a given order": request.order is not None,
        f"the solver {plan.solver}": plan.solver != "auto",
        "the fill method rays": plan.fill != "aimed",
        "a scanner that sweeps": not problem.is_at_rest,
    }
    names = [name for name, is_given in reasons.items() if is_given]
    return f"the search does not support {names[0]}" if names else ""


def search_views(
    problem: SelectionProblem, selection: Selection, surface: PartSurface, append: Append, rng: np.random.Generator,
    fresh: np.random.Generator, selection_rng: np.random.Generator, progress: SearchProgress,
    *, is_allowed: Callable[[Floats], Bools] | None = None,
) -> tuple[SelectionProblem, Selection, PoseSearch]:  # fmt: skip
    """Find fewer views that measure as much of the held-out samples, among all reachable poses.

    Args:
        problem: candidates and request, for which `skip_reason` is "".
        selection: views from which the search begins; they may fall short of the requested coverage.
        surface: the part.
        append: appends viewpoints to the candidates.
        rng: samples and proposals.
        fresh: samples on which found views are compared with the given ones.
        selection_rng: randomness of the selection among all candidates.
        progress: called with evaluated poses, effort, and the number of views found so far.
        is_allowed: (n, 4, 4) [m] -> (n,) whether a view may be moved to each pose; None: all poses are allowed.

    Returns:
        Problem and selection with the moved views; the given ones if there are no fewer views.
    """
    plan, known = problem.request.plan, problem.prediction
    effort = effort_of(problem.request, len(selection.cover.views))
    usable = np.flatnonzero(problem.usable())
    pool = poses_of(problem.candidates, usable)
    pinned = np.flatnonzero(np.isin(selection.cover.views, plan.pinned))
    fixed = poses_of(problem.candidates, selection.cover.views[pinned])
    initial = np.searchsorted(usable, np.delete(selection.cover.views, pinned))
    least = min(plan.coverage + MARGIN, 1.0)
    if not (effort and len(initial) > 1):
        return problem, selection, PoseSearch(plan.effort, 0, len(selection.cover.views))
    try:
        with deferred_interrupt():
            samples, weights = draw_evaluated([(problem.M, problem.usable())], surface, len(initial), rng)
            table = make_table(samples, known)
            raise_interrupt()
            pool_measured = table.measured(pool.T_object_scanner)
            raise_interrupt()
            coverable = pool_measured.any(axis=0)
            needed = np.flatnonzero(coverable & ~table.measured(fixed.T_object_scanner).any(axis=0))
            shortfall = _shortfall(problem, selection, surface, fixed, least, fresh)
    except KeyboardInterrupt as stop:
        if type(stop) is not KeyboardInterrupt:  # a subclass is a kill, not a request for a result
            raise
        return problem, selection, PoseSearch(plan.effort, 0, len(selection.cover.views), is_interrupted=True)
    evaluator = view_evaluator(problem.cell, known.scanner, known.casters)

    def are_reachable(T_object_scanner: Floats) -> Bools:
        reachable = evaluator.are_reachable(T_object_scanner[:, None])
        return reachable if is_allowed is None else reachable & is_allowed(T_object_scanner)

    # Shares of the coverable area: the shortfall on held-out samples has the same unit.
    result = search_poses(
        initial, pool, [Place(table.pick(needed), are_reachable)], weights[needed] / weights[coverable].sum(),
        shortfall=shortfall, effort=effort, rng=rng, pool_measured=pool_measured[:, needed],
        progress=lambda n_done, total, n_views: progress(n_done, total, len(fixed) + n_views),
    )  # fmt: skip
    # Views that hold the requirement on the fresh samples may miss the requested share of the held-out samples.
    fewer = [SearchPoses.join([fixed, views]) for views in result.found if len(views) < len(initial)]
    while fewer and known.share_of_coverable(fewer[-1].T_object_scanner[:, None]) < plan.coverage:
        fewer.pop()
    n_views = len(fewer[-1]) if fewer else len(fixed) + len(initial)
    numbers = PoseSearch(plan.effort, result.evaluated, n_views, len(fixed), result.is_interrupted)
    if not fewer:
        return problem, selection, numbers
    more, moved = _appended(problem, selection, fewer[-1], append)
    # A selection among all candidates may need still fewer views.
    among_all = continue_selection(more, moved, selection_rng)
    if (among_all.targets > moved.targets).any() and not _is_better(among_all, moved, problem.request):
        # Its bound holds for a higher target only.
        among_all = select_views(more, selection_rng.spawn(1)[0], start=moved, search=Search.CONTINUED)
    if _is_better(among_all, moved, problem.request):
        return more, among_all, numbers
    return more, moved.with_bounds_of(among_all), numbers


def _is_better(one: Selection, other: Selection, request: Request) -> bool:
    """Return whether a selection has fewer views than another one, and satisfies the request."""
    return len(one.cover.views) < len(other.cover.views) and one.satisfies(request.targets)


def _shortfall(
    problem: SelectionProblem, selection: Selection, surface: PartSurface, fixed: SearchPoses, least: float,
    fresh: np.random.Generator,
) -> Shortfall:  # fmt: skip
    """Return the comparison of views with those of a selection, on samples that neither was chosen by.

    Found views measure as much more of these samples as the selection misses `least` of the held-out samples, but no
    less than the selection. They also measure the requested share of what candidates and views can measure, which is
    more surface than the candidates alone can measure.
    """
    known, requested = problem.prediction, problem.request.plan.coverage
    samples = draw_samples(surface.reference, surface.planning, min(N_COMPARED, len(known.samples)), fresh)
    memo = VisibilityMemo(samples, known.scanner, known.casters)
    T = problem.candidates.T_object_scanner
    of_start = memo.measured(T[selection.cover.views])
    coverable = of_start | find_measured(T[problem.usable()], samples, known.scanner, known.casters, among=~of_start)
    goal = float(of_start.mean() / coverable.mean()) + max(0.0, least - float(selection.shares[0]))

    def shortfall(views: SearchPoses) -> float:
        measured = memo.measured(SearchPoses.join([fixed, views]).T_object_scanner[:, None])
        missing = goal - float(measured.mean() / coverable.mean())
        share = float(measured.mean() / (coverable | measured).mean())
        return max(missing, requested + _SAMPLING_ERROR - share)

    return shortfall


def effort_of(request: Request, n_views: int) -> int:
    """Return the effort of a search that begins with a number of views."""
    effort = request.plan.effort
    poses = EFFORTS[effort] if effort in EFFORTS else int(effort)
    return round(poses * request.effort.pose_search_share * max(1.0, n_views / MANY_VIEWS))


def poses_of(candidates: Viewpoints, which: Ints, place: int = 0) -> SearchPoses:
    """Return the poses of some candidates at rest, in a set-up."""
    unmoved = np.zeros(len(which), dtype=np.bool_)
    return SearchPoses(
        candidates.T_object_scanner[which, 0], candidates.standoff[which], which, unmoved, np.full(len(which), place)
    )


def moved_viewpoints(views: SearchPoses, faces: NDArray[np.int32]) -> Viewpoints:
    """Return the moved ones of some views as viewpoints, with the planning faces (V,) of the candidates."""
    moved = views.pick(views.moved)
    T = moved.T_object_scanner
    return viewpoints_from_poses(T, T[:, :3, 3] + moved.distance[:, None] * T[:, :3, 2], faces[moved.origin])


def distances_of(scanner: Scanner) -> tuple[float, float]:
    """Return the smallest and largest distance of source and sensor from a measured point [m]."""
    places, ends = find_frustum(scanner).points, np.stack([scanner.source, scanner.sensor])
    distance = np.linalg.norm(places[:, None] - ends, axis=2)
    return float(distance.min()), float(distance.max())


def draw_evaluated(
    matrices: Sequence[tuple[Measurability, Bools]], surface: PartSurface, n_views: int, rng: np.random.Generator
) -> tuple[SurfaceSamples, Floats]:
    """Draw samples on which poses are evaluated, and the weight of each.

    Args:
        matrices: of each set-up, with its usable candidates: samples that many measure are thinned out.
        surface: the part.
        n_views: number of views.
        rng: of the samples.
    """
    count = min(max(N_EVALUATED, EVALUATED_PER_VIEW * n_views), MAX_EVALUATED)
    samples = draw_samples(surface.reference, surface.planning, round(_DRAWN_PER_EVALUATED * count), rng)
    ease = np.mean([_ease(M, usable, samples) for M, usable in matrices], axis=0)
    rows, share = _thinned(ease, count)
    return samples.pick(rows), 1.0 / share[rows]


def make_table(samples: SurfaceSamples, known: Prediction) -> DirectionTable:
    """Return the direction table of samples, with scanner and casters of a prediction."""
    targets = RayTargets.of(samples.points, samples.normals, samples.region)
    part, *occluders = cast(Sequence[DirectionCaster], known.casters)
    return DirectionTable.build(targets, known.scanner, part, occluders, distances_of(known.scanner))


def _thinned(ease: Floats, count: int) -> tuple[Ints, Floats]:
    """Return about `count` of (S,) samples, and the share of each that is kept: all hard ones, few easy ones.

    At most half of them have ease 0: no candidate measures their faces, and most are out of reach.
    """
    if len(ease) <= count:
        return np.arange(len(ease)), np.ones(len(ease))
    is_measured = ease > 0
    n_unmeasured = int((~is_measured).sum())
    n_kept = min(n_unmeasured, count // 2)
    share = np.full(len(ease), n_kept / max(1, n_unmeasured))
    share[is_measured] = _shares(ease[is_measured], count - n_kept)
    return np.flatnonzero(np.diff(np.floor(np.cumsum(share)), prepend=0.0) > 0), share


def _shares(ease: Floats, count: int) -> Floats:
    """Return (S,) shares whose sum is about `count`, inversely proportional to the ease and at most 1."""
    low, high = 0.0, 1.0
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        low, high = (
            (low, middle) if np.minimum(1.0, middle / np.maximum(ease, middle)).sum() > count else (middle, high)
        )
    return np.asarray(high / np.maximum(ease, high))


def _ease(M: Measurability, usable: Bools, samples: SurfaceSamples) -> Floats:
    """Return (S,) share of the usable candidates that measure the rows on the planning face of each sample."""
    faces = 1 + int(max(M.samples.planning_face.max(), samples.planning_face.max(initial=0)))
    rows = np.bincount(M.samples.planning_face, minlength=faces)
    entries = np.bincount(M.samples.planning_face, weights=np.diff(M.indptr), minlength=faces)
    return np.asarray((entries / np.maximum(rows, 1) / max(1, int(usable.sum())))[samples.planning_face])


def _appended(
    problem: SelectionProblem, selection: Selection, views: SearchPoses, append: Append
) -> tuple[SelectionProblem, Selection]:
    """Append moved views to the candidates, and return all views as a selection."""
    more = append(problem, moved_viewpoints(views, problem.candidates.face))
    numbers = views.origin.copy()
    numbers[views.moved] = len(problem.candidates) + np.arange(int(views.moved.sum()))
    is_coverable: Bools = np.diff(more.M.indptr) > 0
    measures_some = np.bincount(more.M.indices, minlength=len(more.candidates)) > 0
    unbounded = replace(
        selection.cover, lower_bound=1, status=CoverStatus.BOUNDED, uncoverable_rows=np.flatnonzero(~is_coverable),
        coverable_area=float(more.M.samples.areas[is_coverable].sum()),
        n_candidates=int((measures_some & more.usable()).sum()),
    )  # fmt: skip
    cover, _ = cover_of_views(unbounded, more.M, numbers)
    share = more.prediction.share_of_coverable(more.candidates.T_object_scanner[cover.views])
    moved = replace(selection, cover=cover, shares=np.array([share]), sentence=cover.sentence)
    return more, replace(moved, targets=np.minimum(selection.targets, moved.claimed_coverage))

"""Views exchanged for others that measure as much, between selection and motion (`planner.tour.equivalent_views`).

The cover's views go in; groups of candidates come out, one for each view of the plan. The motion picks one joint
solution of one member of each group, and what it picked becomes the plan. The number of views and the lower bound on it
stay what the cover says.

Less than full coverage is promised on held-out samples too, which the exchange does not see: there its views are looked
at on them, and fewer liberties taken where they fall short or lose more than a little beyond it; then those that
lose most are taken back for the cover's own. What the selection had to cover of the matrix stays covered.
"""

import logging
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from cell.plan.problem import Problem
from cell.plan.request import LEAST_COST, WORK, Selected, select
from cell.plan.views import Groups
from cell.world.self_occlusion import SelfOcclusion
from planner.cover import Cover, CoverStatus
from planner.measurability.matrix import Measurability
from planner.tour.equivalent_views import ViewExchange, VisibilityIndex, exchange_views
from planner.tour.generalised_tsp import MANY_CLUSTERS
from planner.tour.tour import Tour
from planner.tour.view_times import insertion_times
from planner.values import Floats, Ints

log = logging.getLogger(__name__)

_LOST = 0.0002  # share of what is coverable that may go for a shorter motion, where the promise leaves it
_ROUNDING = 1e-9  # of areas that are summed in another order
_COVERS = 8  # covers tried where time counts; two to five are usual


def alone(arm: SelfOcclusion, views: Ints) -> Groups:
    """Each view in a group of its own."""
    return _groups(arm, _single(views))


def groups(
    problem: Problem, arm: SelfOcclusion, selected: Selected, usable: NDArray[np.bool_], rng: np.random.Generator
) -> Groups:
    """Exchange the cover's views for others with a shorter motion; where time counts, for another cover of less time.

    Args:
        problem: the candidates, home and limits.
        arm: what is left of the matrix and of each candidate's joint solutions.
        selected: the cover, and the share of the matrix' coverable samples that it was to meet.
        usable: (V,) candidates that may be used.
        rng: source of randomness.
    """
    found, members = _exchanged(problem, arm, selected, usable, rng)
    _tell(found)
    standing = problem.request.standing
    before = found.duration_before + standing * len(selected.cover.views)
    exchanged = replace(_groups(arm, members), straight_before=before, visited=tuple(found.visited.tolist()))
    if problem.request.costs is None:
        return exchanged
    draws = rng.spawn(1)[0]  # so that where no other cover is better the motion is that of the fewest views
    timed, _ = _timed(problem, arm, (found, members), draws)
    other, others = _other_covers(problem, arm, selected, (timed, members), usable, draws)
    if other is timed:
        return exchanged
    before = timed.duration + standing * len(members)
    groups = replace(_groups(arm, others), straight_before=before, visited=tuple(other.visited.tolist()))
    return replace(groups, instead=exchanged)


def _exchanged(
    problem: Problem, arm: SelfOcclusion, selected: Selected, usable: NDArray[np.bool_], rng: np.random.Generator
) -> tuple[ViewExchange, tuple[Ints, ...]]:
    """The exchange of a cover's views, and the groups that the promise on held-out samples leaves."""
    chosen, target = selected.cover, selected.target
    matrix = VisibilityIndex(arm.M.matrix(), arm.M.samples.areas, usable)
    spare = chosen.covered_area - target * chosen.coverable_area if target < 1 else 0.0
    asked = problem.request.plan.coverage
    least = max(asked, float(selected.shares[0]) - _LOST)
    enough = target * chosen.coverable_area * (1 - _ROUNDING)
    again = (
        spare > 0 and len(chosen.views) <= MANY_CLUSTERS
    )  # of many views another exchange takes longer than it saves
    for allowed in (spare, 0.0) if again else (spare,):
        found = exchange_views(
            matrix, chosen.views, arm.configurations, problem.world.home, problem.limits, rng,
            pinned=chosen.pinned.tolist(), slack=allowed,
        )  # fmt: skip
        if asked >= 1:
            return found, found.groups
        kept = problem.prediction.share_of_coverable(problem.candidates.T_object_scanner[found.views]) >= least
        if kept and _covered(matrix, found.views) >= enough:
            return found, _single(found.views)
    views = _taken_back(problem, chosen.views, found, least)
    if len(views) > len(found.views) or _covered(matrix, views) < enough:
        return found, _single(chosen.views)
    visited = views[np.array([np.flatnonzero(found.views == view)[0] for view in found.visited])]
    once = np.sort(np.unique(views, return_index=True)[1])  # a view that came back may have stood in for another
    return replace(found, views=views, visited=visited), _single(views[once])


def _timed(
    problem: Problem, arm: SelfOcclusion, exchanged: tuple[ViewExchange, tuple[Ints, ...]], rng: np.random.Generator
) -> tuple[ViewExchange, tuple[Ints, ...]]:
    """The exchange with a tour through the views of its groups: where some were taken back, its own tour has others."""
    found, members = exchanged
    views = np.array([group[0] for group in members])
    stops = zip(found.visited.tolist(), found.stops[1:-1], strict=False)
    alike = np.array_equal(np.sort(found.visited), np.sort(views)) and len(found.stops) == len(views) + 2
    if alike and all((arm.configurations(view) == q).all(axis=1).any() for view, q in stops):
        return exchanged
    matrix = VisibilityIndex(arm.M.matrix(), arm.M.samples.areas, np.ones(arm.M.shape[1], dtype=np.bool_))
    timed = exchange_views(
        matrix, views, arm.configurations, problem.world.home, problem.limits, rng, pinned=views.tolist()
    )  # fmt: skip
    return replace(timed, duration_before=found.duration_before), members


def _taken_back(problem: Problem, own: Ints, found: ViewExchange, least: float) -> Ints:
    """The views of an exchange, some taken back for the cover's own: as many as keep a share of the held-out samples.

    First go those whose own view measures most of what the cover measures and the exchange does not; a view that comes
    back may lose a little of what its stand-in alone measured, so it is looked at again.

    Args:
        problem: the held-out samples, and the candidates.
        own: (n,) the cover's views.
        found: their exchange.
        least: share of what is coverable that is kept.

    Returns:
        As many candidates as the exchange has views, or all of the cover's where that does not suffice.
    """
    known, T = problem.prediction, problem.candidates.T_object_scanner
    views, before = found.views.copy(), own[found.replaces]
    aim = known.visible(T[own]).covered
    while (share := known.share_of_coverable(T[views])) < least:
        changed, lost = np.flatnonzero(views != before), aim & ~known.visible(T[views]).covered
        waiting, seen = known.samples.areas[lost], known.seen(T[before[changed]], among=lost)
        gap = (least - share) * known.coverable.area
        while gap > 0.0 and (gains := waiting @ seen).any():
            best = int(gains.argmax())
            gap -= float(gains[best])
            waiting[seen[:, best]] = 0.0
            views[changed[best]] = before[changed[best]]
        if gap > 0.0:
            return own
    return views


def _covered(matrix: VisibilityIndex, views: Ints) -> float:
    """Area of the matrix' samples that views measure [m^2]."""
    return float(matrix.areas[matrix.counts(views.tolist()) > 0].sum())


def _other_covers(
    problem: Problem,
    arm: SelfOcclusion,
    selected: Selected,
    exchanged: tuple[ViewExchange, tuple[Ints, ...]],
    usable: NDArray[np.bool_],
    rng: np.random.Generator,
) -> tuple[ViewExchange, tuple[Ints, ...]]:
    """The exchange, and its groups, of the least time found by choosing and ordering in turns.

    Each candidate is priced at its standing and at what it makes the tour at hand longer, the cheapest cover at these
    prices is ordered and its views are exchanged, and so on, until a cover comes back or two in a row are no better;
    then once more from the cheapest cover at the prices that know no tour.
    """
    request, reached = problem.request, problem.reached
    banned = tuple(np.flatnonzero(~usable & reached.reachable).tolist())

    def priced(tour: ViewExchange) -> Floats:
        more = insertion_times(tour.stops, tour.visited, reached.q, reached.offsets, problem.limits)
        return np.maximum(np.where(usable, more, 0.0) + request.standing, LEAST_COST)

    (best, members), since = exchanged, 0
    least, prices, without_tour = best.duration + request.standing * len(members), priced(best), request.costs
    seen = {frozenset(best.views.tolist())}
    for _ in range(_COVERS):
        choose = partial(
            select, replace(request, costs=prices), arm.M, reached, problem.candidates, problem.prediction,
            banned=banned, rng=rng,
        )  # fmt: skip
        cheapest = choose(looked=choose(looked=selected, look=WORK))
        back = frozenset(cheapest.cover.views.tolist()) in seen
        if not back:
            found, others = _timed(problem, arm, _exchanged(problem, arm, cheapest, usable, rng), rng)
            seen |= {frozenset(cheapest.cover.views.tolist()), frozenset(found.views.tolist())}
            seconds = found.duration + request.standing * len(others)
            log.info("another cover of %d views: %.3f s with the motion, best %.3f s", len(others), seconds, least)
            since, prices = since + 1, priced(found)
            if seconds < least * (1.0 - 1e-9):
                best, least, members, since = found, seconds, others, 0
        if back or since == 2:
            if without_tour is None:
                break
            since, prices, without_tour = 0, without_tour, None
    return best, members


def shorter(exchanged: tuple[Groups, Tour], own: tuple[Groups, Tour], standing: float = 0.0) -> tuple[Groups, Tour]:
    """The motion of two that takes less time with the seconds at each view; one that visits every view comes first."""

    def seconds(planned: tuple[Groups, Tour]) -> tuple[int, float]:
        groups, motion = planned
        return len(motion.dropped), motion.duration + standing * len(groups.members)

    return min(exchanged, own, key=seconds)


def of_views(chosen: Cover, M: Measurability, picks: Ints) -> tuple[Cover, Ints]:
    """The cover of other views, not more, for the same request, and the order in which they add most area.

    Args:
        chosen: the cover of the request.
        M: the matrix.
        picks: (n,) candidates.

    Returns:
        The cover, and the (n,) indices into `picks` of its views.
    """
    matrix = VisibilityIndex(M.matrix(), M.samples.areas, np.ones(M.shape[1], dtype=np.bool_))
    waiting = matrix.areas.copy()
    rows = [matrix.measured_by(int(view)) for view in picks]
    sequence: list[int] = []
    added: list[float] = []
    while len(sequence) < len(picks):
        gains = [-1.0 if k in sequence else float(waiting[at].sum()) for k, at in enumerate(rows)]
        best = int(np.argmax(gains))
        sequence.append(best)
        added.append(gains[best])
        waiting[rows[best]] = 0.0
    lower_bound = min(chosen.lower_bound, len(picks))
    cover = replace(
        chosen,
        views=picks[sequence],
        marginal_area=np.array(added),
        covered_area=_covered(matrix, picks),
        lower_bound=lower_bound,
        status=CoverStatus.PROVEN if lower_bound == len(picks) else chosen.status,
    )
    return cover, np.array(sequence, dtype=np.int64)


def settled(chosen: Cover, M: Measurability, motion: Tour, picks: Ints) -> tuple[Cover, Tour]:
    """The cover of the candidates that a motion picked, the one that adds the largest area first, and its motion.

    Args:
        chosen: the cover whose views were exchanged.
        M: the matrix.
        motion: its views are indices into `picks`; all are visited.
        picks: (n,) candidates.
    """
    if np.array_equal(picks, chosen.views):
        return chosen, motion
    cover, sequence = of_views(chosen, M, picks)
    place = np.empty(len(picks), dtype=np.int64)
    place[sequence] = np.arange(len(picks))
    view = np.where(motion.view >= 0, place[np.maximum(motion.view, 0)], -1)
    return cover, replace(motion, order=place[motion.order], view=view)


def _single(views: Ints) -> tuple[Ints, ...]:
    return tuple(views[k : k + 1] for k in range(len(views)))


def _groups(arm: SelfOcclusion, members: tuple[Ints, ...]) -> Groups:
    owner, configurations = [], []
    for group in members:
        solutions = [arm.configurations(int(view)) for view in group]
        owner.append(np.repeat(group, [len(q) for q in solutions]))
        configurations.append(np.concatenate(solutions))
    return Groups(members, tuple(owner), tuple(configurations))


def _tell(found: ViewExchange) -> None:
    log.info(
        "views exchanged for others that measure as much: straight moves of %.3f s before, %.3f s after; %d orderings",
        found.duration_before,
        found.duration,
        found.orderings,
    )

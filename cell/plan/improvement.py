"""Improvement of selected views: swaps for equivalent views, and swaps of whole covers.

**Swaps.** Between selection and motion, views are swapped for others that measure the same samples
(`planner.tour.equivalent_views`). The views of the cover go in; groups of candidates come out, one for each view of the
plan. The motion picks one configuration of one member of each group, and its picks become the plan. The number of views
and its lower bound stay those of the cover. A coverage below 1 must also hold on held-out samples, which the swap does
not see: there the swapped views are evaluated on them, with less freedom if they fall short or lose more than a little;
then the original views that lose most are restored. The samples that the selection had to cover stay covered.

**Covers.** If time is minimised, whole covers are searched and ordered in turns as well (`_least_time_cover`).
"""

import logging
from dataclasses import dataclass, replace

import numpy as np

from cell.plan.selection import MIN_COST, Search, Selection, SelectionProblem, select_views
from cell.world.self_occlusion import SelfOcclusion
from planner.cover import Cover, CoverStatus
from planner.measurability.matrix import Measurability
from planner.tour.equivalent_views import ViewExchange, VisibilityIndex, exchange_views
from planner.tour.generalised_tsp import MANY_CLUSTERS
from planner.tour.tour import Tour
from planner.tour.view_times import insertion_times
from planner.values import Bools, Floats, Ints

log = logging.getLogger(__name__)

_MAX_LOSS = 0.0002  # share of the coverable area that a shorter motion may cost, if the requested coverage allows it
_ROUNDING = 1e-9  # of areas that are summed in another order
_MAX_COVERS = 8  # covers tried if time is minimised; two to five are usual

Swapped = tuple[ViewExchange, tuple[Ints, ...]]
"""A swap of a cover's views, and the groups of candidates that the evaluation on held-out samples leaves."""


@dataclass(frozen=True, slots=True, eq=False)
class EquivalentViews:
    """Groups of candidates; the motion picks one of each.

    Attributes:
        members: candidates of each group, the expected one first.
        owner: for each group, the candidate of each row of its configurations.
        configurations: for each group, (m, axes) configurations of its members, one after the other [rad].
        straight_before: time of straight moves through the original views, and of dwelling at them if time is minimised
            [s]: a motion that takes no longer need not be compared with theirs. inf without swaps.
        visited: candidates in the order of the tour that the swap found.
        fallback: groups to connect for that comparison; None: each view of the cover by itself.
    """

    members: tuple[Ints, ...]
    owner: tuple[Ints, ...]
    configurations: tuple[Floats, ...]
    straight_before: float = float("inf")
    visited: tuple[int, ...] = ()
    fallback: "EquivalentViews | None" = None

    @classmethod
    def of(cls, arm: SelfOcclusion, members: tuple[Ints, ...]) -> "EquivalentViews":
        """Collect the configurations of the members of each group."""
        owner, configurations = [], []
        for group in members:
            solutions = [arm.configurations(int(view)) for view in group]
            owner.append(np.repeat(group, [len(q) for q in solutions]))
            configurations.append(np.concatenate(solutions))
        return cls(members, tuple(owner), tuple(configurations))

    @property
    def has_swaps(self) -> bool:
        """Whether views of the cover were swapped."""
        return bool(np.isfinite(self.straight_before))

    @property
    def views(self) -> Ints:
        """(n,) expected candidate of each group."""
        return np.array([group[0] for group in self.members], dtype=np.int64)

    def picked_by(self, motion: Tour) -> Ints:
        """Return the (n,) candidate that a motion picked of each group; the expected one of a group it leaves out."""
        picks = self.views
        for view, choice in zip(motion.order, motion.choice, strict=True):
            picks[view] = self.owner[view][choice]
        return picks

    def visited_by(self, motion: Tour) -> tuple[int, ...]:
        """Return the candidates of a motion in visiting order."""
        return tuple(self.picked_by(motion)[motion.order].tolist())


def single_views(views: Ints) -> tuple[Ints, ...]:
    """Return each view in a group of its own."""
    return tuple(views[k : k + 1] for k in range(len(views)))


def swap_views(
    problem: SelectionProblem, arm: SelfOcclusion, selection: Selection, usable: Bools, rng: np.random.Generator
) -> EquivalentViews:
    """Swap the views of a cover for others with a shorter motion; if time is minimised, try other covers as well.

    Args:
        problem: candidates, home and limits.
        arm: matrix and configurations as the arm leaves them.
        selection: cover and target.
        usable: (V,) candidates that may be used.
        rng: randomness of the search.
    """
    swap, members = _swap_cover(problem, arm, selection, usable, rng)
    log.info(
        "views swapped for others that measure the same: straight moves of %.3f s before, %.3f s after; %d orderings",
        swap.duration_before,
        swap.duration,
        swap.orderings,
    )
    dwell = problem.request.dwell_s
    before = swap.duration_before + dwell * len(selection.cover.views)
    swapped = replace(EquivalentViews.of(arm, members), straight_before=before, visited=tuple(swap.visited.tolist()))
    if problem.request.costs is None:
        return swapped
    draws = rng.spawn(1)[0]  # so that the motion is that of the fewest views if no other cover is better
    timed, _ = _with_tour(problem, arm, (swap, members), draws)
    other, others = _least_time_cover(problem, arm, selection, (timed, members), usable, draws)
    if other is timed:
        return swapped
    before = timed.duration + dwell * len(members)
    groups = EquivalentViews.of(arm, others)
    return replace(groups, straight_before=before, visited=tuple(other.visited.tolist()), fallback=swapped)


def _swap_cover(
    problem: SelectionProblem, arm: SelfOcclusion, selection: Selection, usable: Bools, rng: np.random.Generator
) -> Swapped:
    known_cover, target = selection.cover, selection.target
    index = VisibilityIndex(arm.M.matrix(), arm.M.samples.areas, usable)
    spare = known_cover.covered_area - target * known_cover.coverable_area if target < 1 else 0.0
    requested = problem.request.plan.coverage
    least = max(requested, float(selection.shares[0]) - _MAX_LOSS)
    enough = target * known_cover.coverable_area * (1 - _ROUNDING)
    # A second swap of many views takes longer than it saves.
    retries = spare > 0 and len(known_cover.views) <= MANY_CLUSTERS
    for allowed in (spare, 0.0) if retries else (spare,):
        swap = exchange_views(
            index, known_cover.views, arm.configurations, problem.world.home, problem.limits, rng,
            pinned=known_cover.pinned.tolist(), slack=allowed,
        )  # fmt: skip
        if requested >= 1:
            return swap, swap.groups
        is_sufficient = problem.prediction.share_of_coverable(problem.candidates.T_object_scanner[swap.views]) >= least
        if is_sufficient and _covered_area(index, swap.views) >= enough:
            return swap, single_views(swap.views)
    views = restored_views(problem, known_cover.views, swap, least)
    if len(views) > len(swap.views) or _covered_area(index, views) < enough:
        return swap, single_views(known_cover.views)
    visited = views[np.array([np.flatnonzero(swap.views == view)[0] for view in swap.visited])]
    once = np.sort(np.unique(views, return_index=True)[1])  # a restored view may itself be a replacement
    return replace(swap, views=views, visited=visited), single_views(views[once])


def _with_tour(problem: SelectionProblem, arm: SelfOcclusion, swapped: Swapped, rng: np.random.Generator) -> Swapped:
    """Return the swap with a tour through the views of its groups; restored views are not in its own tour."""
    exchange, members = swapped
    views = np.array([group[0] for group in members])
    stops = zip(exchange.visited.tolist(), exchange.stops[1:-1], strict=False)
    is_same = np.array_equal(np.sort(exchange.visited), np.sort(views)) and len(exchange.stops) == len(views) + 2
    if is_same and all((arm.configurations(view) == q).all(axis=1).any() for view, q in stops):
        return swapped
    index = VisibilityIndex(arm.M.matrix(), arm.M.samples.areas, np.ones(arm.M.shape[1], dtype=np.bool_))
    timed = exchange_views(
        index, views, arm.configurations, problem.world.home, problem.limits, rng, pinned=views.tolist()
    )
    return replace(timed, duration_before=exchange.duration_before), members


def restored_views(problem: SelectionProblem, original: Ints, swap: ViewExchange, least: float) -> Ints:
    """Restore original views until a share of the held-out samples is measured.

    Views whose original measures most of the area that the cover measures and the swap does not are restored first. A
    restored view may lose a little of the area that its replacement alone measured, so the share is evaluated again.

    Args:
        problem: held-out samples and candidates.
        original: (n,) views of the cover.
        swap: of these views.
        least: share of the coverable area.

    Returns:
        As many candidates as the swap has views, or all original views if that does not suffice.
    """
    known, T = problem.prediction, problem.candidates.T_object_scanner
    views, before = swap.views.copy(), original[swap.replaces]
    aim = known.visible(T[original]).covered
    while (share := known.share_of_coverable(T[views])) < least:
        changed, is_lost = np.flatnonzero(views != before), aim & ~known.visible(T[views]).covered
        open_area, seen = known.samples.areas[is_lost], known.seen(T[before[changed]], among=is_lost)
        gap = (least - share) * known.coverable.area
        while gap > 0.0 and (gains := open_area @ seen).any():
            best = int(gains.argmax())
            gap -= float(gains[best])
            open_area[seen[:, best]] = 0.0
            views[changed[best]] = before[changed[best]]
        if gap > 0.0:
            return original
    return views


def _covered_area(index: VisibilityIndex, views: Ints) -> float:
    return float(index.areas[index.counts(views.tolist()) > 0].sum())


def _least_time_cover(
    problem: SelectionProblem, arm: SelfOcclusion, selection: Selection, swapped: Swapped, usable: Bools,
    rng: np.random.Generator,
) -> Swapped:  # fmt: skip
    """Search the swap of least time by selecting and ordering views in turns.

    Each candidate is priced at its dwell time and its insertion time into the current tour. The cheapest cover at these
    prices is ordered and its views are swapped, and so on, until a cover returns or two in a row are no better; then
    once more from the cheapest cover at the prices without a tour.
    """
    request, reached = problem.request, problem.reached
    rejected = dict.fromkeys(np.flatnonzero(~usable & reached.reachable).tolist(), "")

    def prices_of(tour: ViewExchange) -> Floats:
        more = insertion_times(tour.stops, tour.visited, reached.q, reached.offsets, problem.limits)
        return np.maximum(np.where(usable, more, 0.0) + request.dwell_s, MIN_COST)

    (best, members), since = swapped, 0
    least, prices, without_tour = best.duration + request.dwell_s * len(members), prices_of(best), request.costs
    seen = {frozenset(best.views.tolist())}
    for _ in range(_MAX_COVERS):
        priced = replace(problem, request=replace(request, costs=prices))
        start = select_views(priced, rng, M=arm.M, rejected=rejected, start=selection, search=Search.CONTINUED)
        cheapest = select_views(priced, rng, M=arm.M, rejected=rejected, start=start)
        has_returned = frozenset(cheapest.cover.views.tolist()) in seen
        if not has_returned:
            swap, others = _with_tour(problem, arm, _swap_cover(problem, arm, cheapest, usable, rng), rng)
            seen |= {frozenset(cheapest.cover.views.tolist()), frozenset(swap.views.tolist())}
            seconds = swap.duration + request.dwell_s * len(others)
            log.info("another cover of %d views: %.3f s with the motion, best %.3f s", len(others), seconds, least)
            since, prices = since + 1, prices_of(swap)
            if seconds < least * (1.0 - 1e-9):
                best, least, members, since = swap, seconds, others, 0
        if has_returned or since == 2:
            if without_tour is None:
                break
            since, prices, without_tour = 0, without_tour, None
    return best, members


def shorter_motion(
    one: tuple[EquivalentViews, Tour], other: tuple[EquivalentViews, Tour], dwell_s: float = 0.0
) -> tuple[EquivalentViews, Tour]:
    """Return the motion of less time, dwell time included; a motion through more groups comes first."""

    def seconds(planned: tuple[EquivalentViews, Tour]) -> tuple[int, float]:
        groups, motion = planned
        return len(motion.dropped), motion.duration + dwell_s * len(groups.members)

    return min(one, other, key=seconds)


def cover_of_views(original: Cover, M: Measurability, picks: Ints) -> tuple[Cover, Ints]:
    """Return the cover by (n,) other views, not more than the original ones, in the order of their marginal area.

    Also returns the (n,) indices into `picks` of its views.
    """
    index = VisibilityIndex(M.matrix(), M.samples.areas, np.ones(M.shape[1], dtype=np.bool_))
    open_area = index.areas.copy()
    rows = [index.measured_by(int(view)) for view in picks]
    sequence: list[int] = []
    marginal: list[float] = []
    while len(sequence) < len(picks):
        gains = [-1.0 if k in sequence else float(open_area[at].sum()) for k, at in enumerate(rows)]
        best = int(np.argmax(gains))
        sequence.append(best)
        marginal.append(gains[best])
        open_area[rows[best]] = 0.0
    lower_bound = min(original.lower_bound, len(picks))
    cover = replace(
        original,
        views=picks[sequence],
        marginal_area=np.array(marginal),
        covered_area=_covered_area(index, picks),
        lower_bound=lower_bound,
        status=CoverStatus.PROVEN if lower_bound == len(picks) else original.status,
    )
    return cover, np.array(sequence, dtype=np.int64)


def cover_of_motion(original: Cover, M: Measurability, motion: Tour, picks: Ints) -> tuple[Cover, Tour]:
    """Return the cover by the (n,) candidates that a motion picked, and the motion with indices into its views.

    Args:
        original: cover whose views were swapped.
        M: measurability.
        motion: through all views; its views are indices into `picks`.
        picks: (n,) candidates.
    """
    if np.array_equal(picks, original.views):
        return original, motion
    cover, sequence = cover_of_views(original, M, picks)
    place = np.empty(len(picks), dtype=np.int64)
    place[sequence] = np.arange(len(picks))
    view = np.where(motion.view >= 0, place[np.maximum(motion.view, 0)], -1)
    return cover, replace(motion, order=place[motion.order], view=view)

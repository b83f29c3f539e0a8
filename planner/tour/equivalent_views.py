"""Exchange chosen views for equivalent candidates to shorten the motion.

A view is needed for the samples that no other chosen view measures. A candidate that measures at least these (another
roll of the same viewpoint, a neighbour, one from the other side) is an alternative: the plan has as many views and
measures as many samples, but the arm may get there faster. In the travelling salesman problem the configurations of all
alternatives are nodes of the view's cluster.

Two exchanges together may lose a sample that both of the original views measured. So the exchange is lazy: order with
all alternatives; find the samples that the picked views lose; make one of the views the *owner* of each, so that only
candidates that measure it may replace its owner; order again, until nothing is lost. Then the same around the new
views, until the motion gets no shorter. If the given views measure more area than the target, the exchange may lose as
much of it (the slack). Moves are straight and collisions are not considered here: `ViewExchange.groups` leaves the
choice among alternatives that can be combined freely to the search that considers them.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from planner.ports import JointLimits
from planner.timing.move_time import move_time
from planner.tour import generalised_tsp as gtsp
from planner.tour.visits import best_nodes_on_tour, node_offsets, too_many_nodes
from planner.values import Bools, Floats, Ints, Value, freeze, readonly

MAX_ALTERNATIVES = 16
"""Largest number of candidates for one view, with itself: those with the shortest detours from the current tour."""

_STEPS = 500  # of the search of one ordering: the final exchange is ordered again in full, on real paths
_MAX_ORDERINGS = 20  # four to seven are usual
_NONE = np.zeros(0, dtype=np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class ViewExchange(Value):
    """Views that measure as much as the given ones, with a shorter motion.

    Attributes:
        views: (n,) candidates; not more than the given ones.
        replaces: (n,) number of the given view that each replaces.
        groups: for each view the candidates that may be picked for it, itself first: every combination measures all
            samples that `views` measure, and no candidate is in two groups.
        duration_before: time of straight moves over the given views [s].
        duration: time of straight moves over `views` [s]; not longer.
        visited: (n,) `views` in visiting order.
        stops: (n + 2, axes) joint angles of this tour, home at both ends [rad].
        orderings: number of orderings.
    """

    views: Annotated[Ints, "n"]
    replaces: Annotated[Ints, "n"]
    groups: Annotated[tuple[Ints, ...], "n"]
    duration_before: float
    duration: float
    visited: Annotated[Ints, "n"]
    stops: Annotated[Floats, "n+2 axes"]
    orderings: int

    def __post_init__(self) -> None:
        groups = tuple(readonly("group", group, (None,), np.int64) for group in self.groups)
        object.__setattr__(self, "groups", groups)
        freeze(self)


class VisibilityIndex:
    """The measurability matrix with access by rows and by columns."""

    def __init__(self, M: Any, areas: Floats, usable: Bools) -> None:
        """Index a (S, V) sparse matrix with the area of each sample [m^2] and the (V,) usable candidates."""
        self._rows, self._columns, self.areas, self.usable = sp.csr_array(M), sp.csc_array(M), areas, usable

    def measured_by(self, view: int) -> Ints:
        """Return the samples that a view measures."""
        at = self._columns.indptr
        return np.asarray(self._columns.indices[at[view] : at[view + 1]], dtype=np.int64)

    def counts(self, views: Iterable[int]) -> Ints:
        """Return (S,) the number of distinct views that measure each sample."""
        counts = np.zeros(self._rows.shape[0], dtype=np.int64)
        for view in set(views):
            counts[self.measured_by(view)] += 1
        return counts

    def measuring(self, samples: Ints, slack: float = 0.0) -> Bools:
        """Return (V,) whether each usable candidate measures all samples except for a slack area [m^2]."""
        entries_of = self._rows[samples]
        if slack <= 0.0:  # counted, so that no rounding decides
            return np.asarray(
                self.usable & (np.bincount(entries_of.indices, minlength=len(self.usable)) == len(samples))
            )
        areas = self.areas[samples]
        entries = np.repeat(areas, np.diff(entries_of.indptr))
        measured = np.bincount(entries_of.indices, weights=entries, minlength=len(self.usable))
        return np.asarray(self.usable & (measured >= areas.sum() - slack))

    def area(self, samples: Bools | Ints) -> float:
        """Return the area of samples [m^2]."""
        return float(self.areas[samples].sum())


def exchange_views(
    index: VisibilityIndex,
    views: Ints,
    configurations: Callable[[int], Floats],
    home: Floats,
    limits: JointLimits,
    rng: np.random.Generator,
    *,
    pinned: Iterable[int] = (),
    slack: float = 0.0,
) -> ViewExchange:
    """Exchange views for alternatives while this shortens the motion.

    Args:
        index: samples that each candidate measures, and usable candidates.
        views: (n,) chosen candidates, each with a configuration.
        configurations: returns the (m, axes) configurations of a candidate [rad]; m may be 0.
        home: (axes,) joint angles at both ends [rad].
        limits: limits of the axes.
        rng: source of the search's randomness.
        pinned: views that must stay.
        slack: area of samples that may be lost [m^2].
    """
    fixed = frozenset(pinned)
    current = np.array(views, dtype=np.int64)
    required = np.minimum(index.counts(current.tolist()), 1)
    tours = _Tours(configurations, home, limits, rng)
    best = tours.first(current)
    before, replaces = best.cost, np.arange(len(current))
    while len(best.picks) > 1 and tours.count < _MAX_ORDERINGS:
        tour = _exchange_once(index, best, required, fixed, tours, slack)
        if tour is None or tour.cost >= best.cost * (1.0 - 1e-9):
            break
        best, remaining = _without_repeats(tour)
        replaces = replaces[remaining]
        measured = np.minimum(index.counts(best.picks.tolist()), 1)
        slack = max(slack + index.area(measured > required) - index.area(measured < required), 0.0)
        required = measured
    groups = _free_groups(index, best.picks, required, fixed)
    stops = np.concatenate([home[None], best.q, home[None]])
    members = tuple(tours.nearest(best, groups))
    return ViewExchange(best.picks, replaces, members, before, best.cost, best.picks[best.order], stops, tours.count)


def needed_samples(index: VisibilityIndex, views: Ints, required: Ints) -> list[Ints]:
    """Return for each view the samples that the other views measure less often than required (S,)."""
    counts = index.counts(views.tolist())
    return [rows[counts[rows] <= required[rows]] for rows in map(index.measured_by, views.tolist())]


class _Tour(NamedTuple):
    """A tour over n groups: time [s], candidate picked of each; groups and joint angles (n, axes) [rad] as visited."""

    cost: float
    picks: Ints
    order: Ints
    q: Floats


class _Tours:
    """Orders views with the configurations of their alternatives, and counts the orderings."""

    def __init__(
        self, configurations: Callable[[int], Floats], home: Floats, limits: JointLimits, rng: np.random.Generator
    ) -> None:
        self.configurations, self.home, self.limits, self.rng = configurations, home, limits, rng
        self.count = 0

    def first(self, views: Ints) -> _Tour:
        """Return the best tour through the views, without a known tour."""
        return self._shortest([views[k : k + 1] for k in range(len(views))], np.arange(len(views)), None)

    def along(self, tour: _Tour, groups: Sequence[Ints]) -> _Tour:
        """Return the best tour with one member of each group, starting from a good one."""
        return self._shortest(self.nearest(tour, groups), tour.order, tour)

    def _shortest(self, groups: Sequence[Ints], order: Ints, near: _Tour | None) -> _Tour:
        """Return the best tour with one member of each group.

        Args:
            groups: candidates of each view.
            order: (n,) groups in the order from which the search starts.
            near: good tour; if there are too many configurations, those with the shortest detours from it are used.
        """
        configurations = [[self.configurations(int(view)) for view in group] for group in groups]
        owners = [
            np.repeat(group, [len(q) for q in view_configurations])
            for group, view_configurations in zip(groups, configurations, strict=True)
        ]
        joints = [np.concatenate(view_configurations) for view_configurations in configurations]
        if near is not None and too_many_nodes(joints):
            best_nodes = [best_nodes_on_tour(self._detours(near, k, q), len(groups)) for k, q in enumerate(joints)]
            owners = [group_owners[rows] for group_owners, rows in zip(owners, best_nodes, strict=True)]
            joints = [q[rows] for q, rows in zip(joints, best_nodes, strict=True)]
        nodes, first = np.concatenate([self.home[None], *joints]), np.concatenate(([0], node_offsets(joints)))
        problem = gtsp.make_instance(move_time(nodes[:, None], nodes, self.limits), first)
        solution = gtsp.solve(problem, order + 1, self.rng, _STEPS, None, warm=near is not None)
        self.count += 1
        visited = problem.clusters_of(solution.tour)[1:] - 1
        picks = np.empty(len(groups), dtype=np.int64)
        picks[visited] = np.concatenate([np.array([-1]), *owners])[solution.tour[1:]]
        return _Tour(solution.cost, picks, visited, nodes[solution.tour[1:]])

    def _detours(self, tour: _Tour, k: int, q: Floats) -> Floats:
        """Return (n,) the time of the moves to q (n, axes) from the stop before a tour's k-th group and to the next."""
        place = int(np.flatnonzero(tour.order == k)[0])
        before = tour.q[place - 1] if place else self.home
        after = tour.q[place + 1] if place + 1 < len(tour.q) else self.home
        return move_time(before, q, self.limits) + move_time(q, after, self.limits)

    def nearest(self, tour: _Tour, groups: Sequence[Ints]) -> list[Ints]:
        """Reduce each group to the `MAX_ALTERNATIVES` members with the shortest detours, the picked view first."""
        reduced = []
        for k, group in enumerate(groups):
            others = group[group != tour.picks[k]]
            detours = np.full(len(others), np.inf)
            if len(others):  # all in one call: a call for each would take ten times as long
                configurations = [self.configurations(int(view)) for view in others]
                owner = np.repeat(np.arange(len(others)), [len(q) for q in configurations])
                np.minimum.at(detours, owner, self._detours(tour, k, np.concatenate(configurations)))
            nearest = np.argsort(detours, kind="stable")[: MAX_ALTERNATIVES - 1]
            usable = [int(others[i]) for i in nearest if detours[i] < np.inf]
            reduced.append(np.array([tour.picks[k], *usable], dtype=np.int64))
        return reduced


def _exchange_once(
    index: VisibilityIndex, best: _Tour, required: Ints, pinned: frozenset[int], tours: _Tours, slack: float
) -> _Tour | None:
    """Return the best tour over alternatives that loses at most the slack area, or None without any."""
    views = best.picks
    needed = needed_samples(index, views, required)
    owned: list[Ints] = [_NONE] * len(views)  # samples that must not be lost any more
    while tours.count < _MAX_ORDERINGS:
        members = [
            _alternatives(index, int(view), rows, owned_samples, pinned, slack)
            for view, rows, owned_samples in zip(views, needed, owned, strict=True)
        ]
        tour = tours.along(best, members)
        counts = index.counts(tour.picks.tolist())
        lost_samples = np.flatnonzero(counts < required)
        if index.area(lost_samples) <= slack + (index.area((counts > 0) & (required == 0)) if slack > 0.0 else 0.0):
            return tour
        # The owner of a lost sample is, of the views that measure it, the one with the largest share of alternatives
        # that measure it.
        shares = np.array([_measuring_share(index, group, lost_samples) for group in members])
        for k, view in enumerate(views):
            shares[k, ~np.isin(lost_samples, index.measured_by(int(view))) | np.isin(lost_samples, owned[k])] = -1.0
        if (shares.max(axis=0) < 0.0).any():  # all its views own it: two of them were picked as one
            return None
        for k, sample in zip(shares.argmax(axis=0), lost_samples, strict=True):
            owned[k] = np.append(owned[k], sample)
    return None


def _alternatives(
    index: VisibilityIndex, view: int, samples: Ints, owned: Ints, pinned: frozenset[int], slack: float = 0.0
) -> Ints:
    """Return the view and its alternatives: they measure the owned samples, and `samples` except for the slack area."""
    if view in pinned:
        return np.array([view])
    allowed = index.measuring(samples, slack) & index.measuring(owned)
    allowed[list(pinned)] = False
    allowed[view] = True
    return np.flatnonzero(allowed)


def _measuring_share(index: VisibilityIndex, group: Ints, samples: Ints) -> Floats:
    """Return (n,) the share of the group's members that measure each sample."""
    count = np.zeros(len(samples))
    for view in group:
        count += np.isin(samples, index.measured_by(int(view)))
    return count / len(group)


def _without_repeats(tour: _Tour) -> tuple[_Tour, Ints]:
    """Return the tour without views that were picked twice, and the numbers of the remaining groups."""
    remaining = np.sort(np.unique(tour.picks, return_index=True)[1])
    number = np.full(len(tour.picks), -1)
    number[remaining] = np.arange(len(remaining))
    order = number[tour.order]
    return _Tour(tour.cost, tour.picks[remaining], order[order >= 0], tour.q[order >= 0]), remaining


def _free_groups(index: VisibilityIndex, views: Ints, required: Ints, pinned: frozenset[int]) -> list[Ints]:
    """Return groups that allow any combination: every sample has as many owners as it requires.

    Views with few alternatives become owners first, because they lose least by it.
    """
    needed = needed_samples(index, views, required)
    exclusive = [_alternatives(index, int(v), rows, _NONE, pinned) for v, rows in zip(views, needed, strict=True)]
    waiting = required.copy()
    groups: list[Ints] = [_NONE] * len(views)
    is_assigned = np.zeros(len(index.usable), dtype=np.bool_)
    is_assigned[views] = True
    for k in np.argsort([len(group) for group in exclusive], kind="stable"):
        rows = index.measured_by(int(views[k]))
        rows = rows[waiting[rows] > 0]
        waiting[rows] -= 1
        group = _alternatives(index, int(views[k]), rows, _NONE, pinned)
        group = group[~is_assigned[group] | (group == views[k])]
        is_assigned[group] = True
        groups[k] = group
    return groups

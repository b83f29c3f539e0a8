"""Which other candidates may stand in for a chosen view, and the exchange of views that shortens the motion.

A view is needed for the samples that no other chosen view measures. A candidate that measures at least those (another
roll of the same viewpoint, a neighbour, one from the other side) may stand in for it: the plan has as many views and
measures as many samples, but the arm may get there faster. In the travelling salesman's terms the joint solutions of
all stand-ins are nodes of the view's cluster.

Two stand-ins at once may lose a sample that both of the views before them measured. So the exchange is lazy: order with
all stand-ins, look at which samples the views picked lose, make one of the views the *owner* of each, so that only what
measures it may stand in for its owner, and order again, until nothing is lost. Then the same around the views found,
until the motion gets no shorter. Where the views given measure more area than was asked for, stand-ins may lose as much
of it. Moves are straight and collisions are not looked at here: `Exchange.groups` leaves the
choice among stand-ins that can be picked in any combination to the search that does.
"""

from collections.abc import Callable, Iterable
from collections.abc import Sequence as Many
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
"""Candidates that are tried for one view at most, itself included: those that lie best on the tour so far."""

_STEPS = 500  # of the search of one ordering: the last exchange is ordered again in full, on real paths
_ORDERINGS = 20  # at most; four to seven are usual


@dataclass(frozen=True, slots=True, eq=False)
class ViewExchange(Value):
    """Views that measure as much as the ones given, and a shorter motion.

    Attributes:
        views: (n,) candidates; not more than were given.
        instead_of: (n,) which of the views given each stands in for, by number.
        groups: for each view the candidates that may be picked for it, itself first: every combination measures all
            samples that `views` measure, and no candidate stands in two groups.
        duration_before: time of straight moves over the views given [s].
        duration: time of straight moves over `views` [s]; not longer.
        visited: (n,) `views` in visiting order.
        stops: (n + 2, axes) joint angles of that tour, home at both ends [rad].
        orderings: orderings computed.
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
    """The measurability matrix, asked by rows and by columns."""

    def __init__(self, M: Any, areas: Floats, usable: Bools) -> None:
        """Take a (S, V) sparse matrix, the area of each sample [m^2] and which columns may be used."""
        self._rows, self._columns, self.areas, self.usable = sp.csr_array(M), sp.csc_array(M), areas, usable

    def measured_by(self, view: int) -> Ints:
        """Samples that a view measures."""
        at = self._columns.indptr
        return np.asarray(self._columns.indices[at[view] : at[view + 1]], dtype=np.int64)

    def counts(self, views: Iterable[int]) -> Ints:
        """(S,) how many of the views measure each sample; a view that is named twice counts once."""
        found = np.zeros(self._rows.shape[0], dtype=np.int64)
        for view in set(views):
            found[self.measured_by(view)] += 1
        return found

    def measuring(self, samples: Ints, spare: float = 0.0) -> Bools:
        """(V,) usable candidates that measure every one of the samples, but for a spare area [m^2]."""
        found = self._rows[samples]
        if spare <= 0.0:  # counted, so that no rounding decides
            return np.asarray(self.usable & (np.bincount(found.indices, minlength=len(self.usable)) == len(samples)))
        areas = self.areas[samples]
        entries = np.repeat(areas, np.diff(found.indptr))
        measured = np.bincount(found.indices, weights=entries, minlength=len(self.usable))
        return np.asarray(self.usable & (measured >= areas.sum() - spare))


def exchange_views(
    matrix: VisibilityIndex,
    views: Ints,
    configurations: Callable[[int], Floats],
    home: Floats,
    limits: JointLimits,
    rng: np.random.Generator,
    *,
    pinned: Iterable[int] = (),
    spare: float = 0.0,
) -> ViewExchange:
    """Exchange views for stand-ins while that shortens the motion.

    Args:
        matrix: what each candidate measures, and which may be used.
        views: (n,) chosen candidates, each with a joint solution.
        configurations: (m, axes) joint solutions of a candidate [rad]; m may be 0.
        home: (axes,) joint angles at both ends [rad].
        limits: limits of the axes.
        rng: source of the search's randomness.
        pinned: views that must stay.
        spare: area of samples that may be lost [m^2].
    """
    kept = frozenset(pinned)
    current = np.array(views, dtype=np.int64)
    required = np.minimum(matrix.counts(current.tolist()), 1)
    tours = _Tours(configurations, home, limits, rng)
    best = tours.first(current)
    before, instead_of = best.cost, np.arange(len(current))
    while len(best.picks) > 1 and tours.count < _ORDERINGS:
        found = _exchanged(matrix, best, required, kept, tours, spare)
        if found is None or found.cost >= best.cost * (1.0 - 1e-9):
            break
        best, stays = _without_repeats(found)
        instead_of = instead_of[stays]
        measured = np.minimum(matrix.counts(best.picks.tolist()), 1)
        spare = max(spare + _area(matrix, measured > required) - _area(matrix, measured < required), 0.0)
        required = measured
    groups = _any_combination(matrix, best.picks, required, kept)
    stops = np.concatenate([home[None], best.q, home[None]])
    members = tuple(tours.nearest(best, groups))
    visited = best.picks[best.order]
    return ViewExchange(best.picks, instead_of, members, before, best.cost, visited, stops, tours.count)


def needed_samples(matrix: VisibilityIndex, views: Ints, required: Ints) -> list[Ints]:
    """For each view the samples that the others measure less often than is required."""
    counts = matrix.counts(views.tolist())
    return [rows[counts[rows] <= required[rows]] for rows in map(matrix.measured_by, views.tolist())]


class _Tour(NamedTuple):
    """A tour over n groups: time [s], candidate picked of each; groups and joint angles (n, axes) [rad] as visited."""

    cost: float
    picks: Ints
    order: Ints
    q: Floats


class _Tours:
    """Orders views with the joint solutions of their stand-ins, and counts how often."""

    def __init__(
        self, configurations: Callable[[int], Floats], home: Floats, limits: JointLimits, rng: np.random.Generator
    ) -> None:
        self.configurations, self.home, self.limits, self.rng = configurations, home, limits, rng
        self.count = 0

    def first(self, views: Ints) -> _Tour:
        """The best tour through views that is found without knowing one."""
        return self._shortest([views[k : k + 1] for k in range(len(views))], np.arange(len(views)), None)

    def along(self, tour: _Tour, groups: Many[Ints]) -> _Tour:
        """The best tour with one member of each group, searched for from a good one."""
        return self._shortest(self.nearest(tour, groups), tour.order, tour)

    def _shortest(self, groups: Many[Ints], order: Ints, near: _Tour | None) -> _Tour:
        solutions = [[self.configurations(int(view)) for view in group] for group in groups]
        owners = [np.repeat(group, [len(s) for s in own]) for group, own in zip(groups, solutions, strict=True)]
        joints = [np.concatenate(own) for own in solutions]
        if near is not None and too_many_nodes(joints):
            kept = [best_nodes_on_tour(self._longer(near, k, q), len(groups)) for k, q in enumerate(joints)]
            owners = [own[best] for own, best in zip(owners, kept, strict=True)]
            joints = [q[best] for q, best in zip(joints, kept, strict=True)]
        nodes, first = np.concatenate([self.home[None], *joints]), np.concatenate(([0], node_offsets(joints)))
        problem = gtsp.make_instance(move_time(nodes[:, None], nodes, self.limits), first)
        found = gtsp.solve(problem, order + 1, self.rng, _STEPS, None, warm=near is not None)
        self.count += 1
        visited = problem.clusters_of(found.tour)[1:] - 1
        picks = np.empty(len(groups), dtype=np.int64)
        picks[visited] = np.concatenate([np.array([-1]), *owners])[found.tour[1:]]
        return _Tour(found.cost, picks, visited, nodes[found.tour[1:]])

    def _longer(self, tour: _Tour, k: int, q: Floats) -> Floats:
        """(n,) time of the moves to joint angles from where a tour is before its k-th group, and on to the next [s]."""
        place = int(np.flatnonzero(tour.order == k)[0])
        before = tour.q[place - 1] if place else self.home
        after = tour.q[place + 1] if place + 1 < len(tour.q) else self.home
        return move_time(before, q, self.limits) + move_time(q, after, self.limits)

    def nearest(self, tour: _Tour, groups: Many[Ints]) -> list[Ints]:
        """Each group cut to the `STAND_INS` members that make the tour least longer; the view it picked comes first."""
        cut = []
        for k, group in enumerate(groups):
            others = group[group != tour.picks[k]]
            more = np.full(len(others), np.inf)
            if len(others):  # of all at once: a call for each would take ten times as long
                solutions = [self.configurations(int(view)) for view in others]
                owner = np.repeat(np.arange(len(others)), [len(s) for s in solutions])
                np.minimum.at(more, owner, self._longer(tour, k, np.concatenate(solutions)))
            nearest = np.argsort(more, kind="stable")[: MAX_ALTERNATIVES - 1]
            usable = [int(others[i]) for i in nearest if more[i] < np.inf]
            cut.append(np.array([tour.picks[k], *usable], dtype=np.int64))
        return cut


def _exchanged(
    matrix: VisibilityIndex, best: _Tour, required: Ints, pinned: frozenset[int], tours: _Tours, spare: float
) -> _Tour | None:
    """The best tour over stand-ins that loses no sample but the spare area; None where none was found."""
    views = best.picks
    only_here = needed_samples(matrix, views, required)
    owned: list[Ints] = [np.zeros(0, dtype=np.int64)] * len(views)  # samples that may not be lost any more
    while tours.count < _ORDERINGS:
        members = [
            _members(matrix, int(view), rows, own, pinned, spare)
            for view, rows, own in zip(views, only_here, owned, strict=True)
        ]
        found = tours.along(best, members)
        counts = matrix.counts(found.picks.tolist())
        lost = np.flatnonzero(counts < required)
        if _area(matrix, lost) <= spare + (_area(matrix, (counts > 0) & (required == 0)) if spare > 0.0 else 0.0):
            return found
        # Of the views that measure a lost sample, the one of whose stand-ins the largest share measures it, owns it.
        shares = np.array([_share(matrix, group, lost) for group in members])
        for k, view in enumerate(views):
            shares[k, ~np.isin(lost, matrix.measured_by(int(view))) | np.isin(lost, owned[k])] = -1.0
        if (shares.max(axis=0) < 0.0).any():  # all its views own it: two of them were picked as one
            return None
        for k, sample in zip(shares.argmax(axis=0), lost, strict=True):
            owned[k] = np.append(owned[k], sample)
    return None


def _area(matrix: VisibilityIndex, samples: Bools | Ints) -> float:
    return float(matrix.areas[samples].sum())


def _members(
    matrix: VisibilityIndex, view: int, samples: Ints, owned: Ints, pinned: frozenset[int], spare: float = 0.0
) -> Ints:
    """The view and its stand-ins: they measure what it owns, and the samples but for the spare area."""
    if view in pinned:
        return np.array([view])
    allowed = matrix.measuring(samples, spare) & matrix.measuring(owned)
    allowed[list(pinned)] = False
    allowed[view] = True
    return np.flatnonzero(allowed)


def _share(matrix: VisibilityIndex, group: Ints, samples: Ints) -> Floats:
    """(n,) share of the group's members that measure each sample."""
    found = np.zeros(len(samples))
    for view in group:
        found += np.isin(samples, matrix.measured_by(int(view)))
    return found / len(group)


def _without_repeats(tour: _Tour) -> tuple[_Tour, Ints]:
    """The tour without views that were picked twice, one visit serves both; and the numbers of those that stay."""
    first = np.unique(tour.picks, return_index=True)[1]
    stays = np.sort(first)
    number = np.full(len(tour.picks), -1)
    number[stays] = np.arange(len(stays))
    order = number[tour.order]
    return _Tour(tour.cost, tour.picks[stays], order[order >= 0], tour.q[order >= 0]), stays


def _any_combination(matrix: VisibilityIndex, views: Ints, required: Ints, pinned: frozenset[int]) -> list[Ints]:
    """Groups from which any combination may be picked: every sample has as many owners as it requires.

    Views with few stand-ins own first, as they lose least by it.
    """
    nothing = np.zeros(0, dtype=np.int64)
    only_here = needed_samples(matrix, views, required)
    exclusive = [_members(matrix, int(v), rows, nothing, pinned) for v, rows in zip(views, only_here, strict=True)]
    waiting = required.copy()
    groups: list[Ints] = [nothing] * len(views)
    taken = np.zeros(len(matrix.usable), dtype=np.bool_)
    taken[views] = True
    for k in np.argsort([len(group) for group in exclusive], kind="stable"):
        rows = matrix.measured_by(int(views[k]))
        rows = rows[waiting[rows] > 0]
        waiting[rows] -= 1
        group = _members(matrix, int(views[k]), rows, nothing, pinned)
        group = group[~taken[group] | (group == views[k])]
        taken[group] = True
        groups[k] = group
    return groups

"""Search fewer views over all reachable poses, starting from the views of a cover.

A cover over candidates is optimal for these candidates only. The search leaves out the views with the smallest area of
their own and repairs the rest: in each round every view gets proposals, poses around its own. They are evaluated by a
direction table on the samples that no other view measures, and the best few are tested for reachability, those of all
views in one call. A view moves to the first reachable one unless it loses area; small losses are accepted with a
probability (Kirkpatrick, Gelatt, Vecchi 1983, doi:10.1126/science.220.4598.671, at a constant temperature). Few
proposals are better than many: views drift along plateaus of equal area, and the next gain is found from there. In some
rounds the best candidate is proposed as well. Of many views several are left out; if the rest cannot be repaired,
candidates are added one by one.

When the table says that the goal is reached, exact rays on other samples decide; a shortfall there raises the goal.
Views that pass are the new start of a search for fewer. The last part of the effort moves the fewest views to a larger
area. Effort is counted in evaluated poses. Object frame, metres.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Protocol

import numpy as np
from scipy.sparse import csr_array

from planner.compiled import compiled
from planner.geometry.rigid import rotation_matrices
from planner.interrupts import deferred_interrupt, raise_interrupt
from planner.ports import no_progress
from planner.values import Bools, Floats, Ints, Ints32, Rows

EFFORTS = {"low": 12_000, "normal": 48_000, "high": 800_000}
"""Poses that a search evaluates."""

_PROPOSALS = 12  # of a view in a round
_TESTED = 3  # best proposals of a view that are tested for reachability
_LAST_PART = 0.1  # of the effort, for a larger area
_FROM_POOL = 4  # rounds between two in which candidates are proposed
_MANY_VIEWS = 25  # from this number on several views are left out at a time
_VIEWS_PER_REMOVAL = 8  # one view of this many
_SHARE_OF_REMOVAL = 0.04  # of the effort, after which one of several views that were left out is replaced
_MAX_TURN = np.deg2rad(15.0)  # of a proposal about its aim, for each component of the rotation vector
_MAX_SHIFT = 0.15  # of a proposal along each axis, as a share of the distance
_SMALLEST = 0.1  # scale of the smallest proposals; scales are log-uniform up to 1
_TEMPERATURE = 3e-4  # share of the surface; with more than `_MANY_VIEWS` divided among them
_RETURNS = 5  # returns to the best views after which the search begins again without other views
_PATIENCE = 60  # rounds without a better area after which the search returns to the best views


class PoseEvaluator(Protocol):
    """Fast evaluation of poses on S samples."""

    def weights_measured(
        self, T_object_scanner: Floats, rows: Ints, starts: Ints, weights: Floats, thresholds: Floats
    ) -> Floats:
        """Return (n, P) approximate sums of the weights that poses (n, P, 4, 4) [m] measure, of n sets of rows.

        Set k is rows[starts[k] : starts[k + 1]]. A sum below its threshold may be partial.
        """
        ...

    def measured(self, T_object_scanner: Floats) -> Bools:
        """Return (n, S) whether each pose (n, 4, 4) [m] measures each sample."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """A set-up in which poses are searched.

    Attributes:
        evaluator: of poses on the S samples.
        are_reachable: (m, 4, 4) [m] -> (m,) whether the arm takes up each pose without collision.
    """

    evaluator: PoseEvaluator
    are_reachable: Callable[[Floats], Bools]


@dataclass(frozen=True, slots=True, eq=False)
class SearchPoses(Rows):
    """Poses of n views.

    Attributes:
        T_object_scanner: (n, 4, 4) [m].
        distance: (n,) to the point at which each is aimed [m].
        origin: (n,) number among the initial views and the candidates of the pose from which each was moved.
        moved: (n,) whether the pose differs from that candidate's.
        place: (n,) number of the set-up in which the part is measured.
    """

    T_object_scanner: Annotated[Floats, "n 4 4"]
    distance: Annotated[Floats, "n"]
    origin: Annotated[Ints, "n"]
    moved: Annotated[Bools, "n"]
    place: Annotated[Ints, "n"]

    def with_poses(self, views: Ints, T_object_scanner: Floats) -> "SearchPoses":
        """Return the poses with some views moved to poses (n, 4, 4) [m] near their own."""
        T, moved = self.T_object_scanner.copy(), self.moved.copy()
        T[views], moved[views] = T_object_scanner, True
        return replace(self, T_object_scanner=T, moved=moved)

    def with_view(self, view: int, other: "SearchPoses") -> "SearchPoses":
        """Return the poses with one view replaced by a single other one."""
        parts = (self.pick(np.arange(view)), other, self.pick(np.arange(view + 1, len(self))))
        return SearchPoses.join(parts)


SearchProgress = Callable[[int, int, int], None]
"""Receive evaluated poses, effort, and the number of views found so far."""

Shortfall = Callable[[SearchPoses], float]
"""Return the share of the surface by which views miss the requirement, by exact rays; at most 0 if they hold it."""


@dataclass(frozen=True, slots=True, eq=False)
class SearchResult:
    """Result of a search.

    Attributes:
        found: views that hold the requirement: the initial ones, then fewer and fewer, the last ones moved to a larger
            area if that was possible.
        evaluated: number of evaluated poses.
        is_interrupted: whether Ctrl-C ended the search.
    """

    found: Sequence[SearchPoses]
    evaluated: int
    is_interrupted: bool = False


def search_poses(
    initial: Ints,
    pool: SearchPoses,
    places: Sequence[Place],
    weights: Floats,
    *,
    shortfall: Shortfall,
    effort: int,
    rng: np.random.Generator,
    pool_measured: Bools | None = None,
    progress: SearchProgress = no_progress,
) -> SearchResult:
    """Search fewer views than the initial ones.

    Args:
        initial: (n,) candidates, numbers in `pool`.
        pool: reachable candidates.
        places: set-ups by their numbers.
        weights: (S,) share of the surface of each sample.
        shortfall: share of the surface by which views miss the requirement, by exact rays; at most 0 if they hold it.
        effort: poses that are evaluated.
        rng: of proposals and accepted moves.
        pool_measured: (n, S) whether each candidate measures each sample, if that is known.
        progress: called with evaluated poses, effort and number of views so far.

    Returns:
        The result; Ctrl-C ends the search with the views so far.
    """
    selections = [pool.pick(initial)]
    before_last_part = round((1 - _LAST_PART) * effort)
    search = None
    try:
        with deferred_interrupt():
            search = _Search(pool, places, weights, effort, rng, pool_measured, progress)
            while search.evaluated < before_last_part and len(selections[-1]) > 1:
                if (fewer := search.repaired(selections[-1], shortfall, before_last_part)) is not None:
                    selections.append(fewer)
            if len(selections) > 1 and (moved := search.with_larger_area(selections[-1], shortfall)) is not None:
                selections.append(moved)
    except KeyboardInterrupt as stop:
        if type(stop) is not KeyboardInterrupt:  # a subclass is a kill, not a request for a result
            raise
        return SearchResult(selections, 0 if search is None else search.evaluated, is_interrupted=True)
    return SearchResult(selections, search.evaluated)


class _Search:
    """State of a search: n current views with the S samples that they measure."""

    def __init__(
        self, pool: SearchPoses, places: Sequence[Place], weights: Floats, effort: int, rng: np.random.Generator,
        pool_measured: Bools | None, progress: SearchProgress,
    ) -> None:  # fmt: skip
        self.pool, self.places, self.weights = pool, places, weights
        self.effort, self.rng, self.progress = effort, rng, progress
        self.order = rng.permutation(len(weights))  # sums over the first of them are spread over the surface
        self.evaluated, self.rounds = 0, 0
        self.pool_measured = self._measured(pool) if pool_measured is None else pool_measured
        self.pool_of_row = csr_array(self.pool_measured.T)
        self._set(pool.pick(np.arange(0)), np.empty((0, len(weights)), dtype=np.bool_))

    def repaired(self, start: SearchPoses, shortfall: Shortfall, effort: int) -> SearchPoses | None:
        """Return fewer views than the start that hold the requirement; None if the effort is exhausted.

        Of many views several are left out. Each part of the effort that does not suffice adds a candidate, until a
        single view is missing.
        """
        removed = len(start) // _VIEWS_PER_REMOVAL if len(start) >= _MANY_VIEWS else 1
        measured = self._measured(start)
        goal = float(self.weights[measured.any(axis=0)].sum()) + shortfall(start)
        remaining = self._needed_most(measured, removed)
        self._set(start.pick(remaining), measured[remaining])
        begin, returns = self.evaluated, 0
        part = min(_SHARE_OF_REMOVAL * effort, (effort - self.evaluated) / (2 * removed))
        best, best_area, since = (self.views, self.measured.copy()), self._area(), 0
        while self.evaluated < effort:
            if removed > 1 and self.evaluated - begin > part:
                self._set(*best)
                self._add_from_pool()
                removed, begin, best_area = removed - 1, self.evaluated, 0.0
            self._round()
            area = self._area()
            since += 1
            if area > best_area:
                best, best_area, since = (self.views, self.measured.copy()), area, 0
                if area >= goal:
                    missing = shortfall(self.views)
                    if missing <= 0:
                        return self.views
                    goal = area + missing
            elif since > _PATIENCE:
                returns, since = returns + 1, 0
                if returns % _RETURNS == 0:  # begin again without other views
                    remaining = np.sort(self.rng.permutation(len(start))[removed:])
                    self._set(start.pick(remaining), measured[remaining])
                    best, best_area = (self.views, self.measured.copy()), self._area()
                else:
                    self._set(*best)
            self._report(len(start))
        return None

    def with_larger_area(self, start: SearchPoses, shortfall: Shortfall) -> SearchPoses | None:
        """Return the views moved to a larger area with the remaining effort; None if exact rays do not confirm it."""
        self._set(start, self._measured(start))
        best, best_area = start, self._area()
        while self.evaluated < self.effort:
            self._round()
            if (area := self._area()) > best_area:
                best, best_area = self.views, area
            self._report(len(start))
        return best if shortfall(best) < shortfall(start) else None

    def _measured(self, poses: SearchPoses) -> Bools:
        """Return (n, S) whether each pose measures each sample."""
        is_measured = np.zeros((len(poses), len(self.weights)), dtype=np.bool_)
        for place in np.unique(poses.place):
            indices = np.flatnonzero(poses.place == place)
            is_measured[indices] = self.places[place].evaluator.measured(poses.T_object_scanner[indices])
        return is_measured

    def _sums(self, T: Floats, rows: Ints, starts: Ints, least: Floats) -> Floats:
        """Return (n, P) approximate weights of the open rows that proposals (n, P, 4, 4) of the views measure."""
        sums = np.empty(T.shape[:2])
        for place in np.unique(self.views.place):
            indices = np.flatnonzero(self.views.place == place)
            rows_of = np.concatenate([rows[starts[view] : starts[view + 1]] for view in indices])
            starts_of = np.concatenate([[0], np.cumsum(np.diff(starts)[indices])])
            evaluator = self.places[place].evaluator
            sums[indices] = evaluator.weights_measured(T[indices], rows_of, starts_of, self.weights, least[indices])
        return sums

    def _report(self, n_views: int) -> None:
        raise_interrupt()
        self.progress(min(self.evaluated, self.effort), self.effort, n_views)

    def _set(self, views: SearchPoses, measured: Bools) -> None:
        self.views, self.measured = views, measured.copy()
        self.count = measured.sum(axis=0)

    def _area(self) -> float:
        return float(self.weights[self.count > 0].sum())

    def _needed_most(self, measured: Bools, removed: int) -> Ints:
        """Return all views but `removed`: repeatedly drop the one with the smallest area that no other measures."""
        is_left, times = np.ones(len(measured), dtype=np.bool_), measured.sum(axis=0)
        alone = measured[:, times == 1] @ self.weights[times == 1]
        for _ in range(removed):
            least = int(np.argmin(np.where(is_left, alone, np.inf)))
            is_left[least] = False
            times = times - measured[least]
            rows = np.flatnonzero(measured[least] & (times == 1))
            alone += measured[:, rows] @ self.weights[rows]
        return np.flatnonzero(is_left)

    def _round(self) -> None:
        """Move each view to its best reachable proposal, if that loses nothing or little.

        Proposals of all views are evaluated and tested for reachability first; a move is decided by the views so far.
        """
        n, T = len(self.views), self._perturbed()
        accepted = _TEMPERATURE * min(1.0, _MANY_VIEWS / n) * np.log(self.rng.random(n))
        rows, starts = list_open_rows(self.measured, self.count, self.order)
        least = self._own_weights(rows, starts) + accepted
        area = self._sums(T, rows, starts, least)
        best = np.argsort(-area, axis=1, kind="stable")[:, :_TESTED]
        view, rank = np.nonzero(np.take_along_axis(area, best, axis=1) >= least[:, None])
        tested = replace(self.views.pick(view), T_object_scanner=T[view, best[view, rank]])
        is_reachable = np.zeros(len(tested), dtype=np.bool_)
        for place in np.unique(tested.place):
            is_here = tested.place == place
            is_reachable[is_here] = self.places[place].are_reachable(tested.T_object_scanner[is_here])
        left = np.flatnonzero(is_reachable)
        while len(left):
            views, first = np.unique(view[left], return_index=True)
            moves = tested.pick(left[first])
            is_moved = self._accepted(views, self._measured(moves), accepted[views])
            self.views = self.views.with_poses(views[is_moved], moves.T_object_scanner[is_moved])
            left = np.delete(left, first)
            left = left[~np.isin(view[left], views[is_moved])]
        if self.rounds % _FROM_POOL == _FROM_POOL - 1:
            self._take_from_pool()
        self.evaluated += n * _PROPOSALS
        self.rounds += 1

    def _take_from_pool(self) -> None:
        """Replace each view by the best candidate, if that measures more."""
        for view in range(len(self.views)):
            rows = np.flatnonzero(self.count == self.measured[view])
            weight = float(self.weights[rows[self.measured[view, rows]]].sum())
            sums = np.zeros(len(self.pool))
            candidate = best_candidate(
                self.pool_of_row.indptr, self.pool_of_row.indices, rows, self.weights, weight, sums
            )  # fmt: skip
            if candidate >= 0:
                here = np.array([candidate])
                if self._accepted(np.array([view]), self.pool_measured[here], np.zeros(1))[0]:
                    self.views = self.views.with_view(view, self.pool.pick(here))

    def _add_from_pool(self) -> None:
        """Add the candidate with the largest area that no view measures."""
        rows = np.flatnonzero(self.count == 0)
        best = np.array([np.argmax(self.pool_measured[:, rows] @ self.weights[rows])])
        views = SearchPoses.join((self.views, self.pool.pick(best)))
        self._set(views, np.concatenate([self.measured, self.pool_measured[best]]))

    def _own_weights(self, rows: Ints, starts: Ints) -> Floats:
        """Return (n,) weight of the open rows that each view measures."""
        n = len(self.views)
        view = np.repeat(np.arange(n), np.diff(starts))
        return np.bincount(view, self.weights[rows] * self.measured[view, rows], n).astype(np.float64)

    def _accepted(self, view: Ints, measured: Bools, change: Floats) -> Bools:
        return accept_moves(self.measured, self.count, self.weights, view, measured, change)

    def _perturbed(self) -> Floats:
        """Return (n, _PROPOSALS, 4, 4) poses around those of the views [m]: shifted, and turned about their aim."""
        n, T = len(self.views), self.views.T_object_scanner
        u = self.rng.random((n * _PROPOSALS, 7))
        scale = _SMALLEST ** u[:, 6:]
        distance = np.repeat(self.views.distance, _PROPOSALS)
        turn = rotation_matrices((2 * u[:, 3:6] - 1) * (_MAX_TURN * scale))
        R, t = (np.repeat(each, _PROPOSALS, axis=0) for each in (T[:, :3, :3], T[:, :3, 3]))
        aim = t + distance[:, None] * R[:, :, 2]
        proposals = np.tile(np.eye(4), (n * _PROPOSALS, 1, 1))
        proposals[:, :3, :3] = turn @ R
        proposals[:, :3, 3] = aim + np.einsum("nij,nj->ni", turn, t - aim)
        proposals[:, :3, 3] += (2 * u[:, :3] - 1) * (_MAX_SHIFT * scale * distance[:, None])
        return proposals.reshape(n, _PROPOSALS, 4, 4)


@compiled
def list_open_rows(measured: Bools, count: Ints, order: Ints) -> tuple[Ints, Ints]:
    """List for each of n views the rows that no other view measures.

    Args:
        measured: (n, S) whether each view measures each row.
        count: (S,) views that measure each row.
        order: (S,) rows in the order in which they are listed.

    Returns:
        The rows of all views, and the (n + 1,) first one of each.
    """
    n, starts = len(measured), np.zeros(len(measured) + 1, dtype=np.int64)
    for view in range(n):
        starts[view + 1] = starts[view]
        for row in range(len(count)):
            starts[view + 1] += count[row] == measured[view, row]
    rows, k = np.empty(starts[n], dtype=np.int64), 0
    for view in range(n):
        for row in order:
            if count[row] == measured[view, row]:
                rows[k] = row
                k += 1
    return rows, starts


@compiled
def accept_moves(measured: Bools, count: Ints, weights: Floats, view: Ints, new: Bools, change: Floats) -> Bools:
    """Accept moves one after the other, unless they lose too much; `measured` and `count` are changed in place.

    Args:
        measured: (n, S) whether each view measures each row.
        count: (S,) views that measure each row.
        weights: (S,) of the rows.
        view: (m,) that are moved.
        new: (m, S) whether each measures each row afterwards.
        change: (m,) smallest accepted change of the weight of measured rows.

    Returns:
        (m,) whether each move was accepted.
    """
    accepted = np.zeros(len(view), dtype=np.bool_)
    for k in range(len(view)):
        old, gain = measured[view[k]], 0.0
        for row in range(len(count)):
            if new[k, row] != old[row] and count[row] == old[row]:
                gain += weights[row] if new[k, row] else -weights[row]
        if gain >= change[k]:
            accepted[k] = True
            for row in range(len(count)):
                count[row] += np.int64(new[k, row]) - np.int64(old[row])
                old[row] = new[k, row]
    return accepted


@compiled
def best_candidate(
    indptr: Ints32, indices: Ints32, rows: Ints, weights: Floats, least: float, sums: Floats
) -> int:  # fmt: skip
    """Return the candidate that measures the largest weight of some rows; -1 if none measures more than `least`.

    Args:
        indptr: (S + 1,) first entry of each row.
        indices: candidates that measure each row.
        rows: (m,) rows that count.
        weights: (S,) of the rows.
        least: weight to exceed.
        sums: (V,) zeros, overwritten with the weight of each candidate; numpy's functions take long to compile.
    """
    best = -1
    for row in rows:
        for entry in range(indptr[row], indptr[row + 1]):
            sums[indices[entry]] += weights[row]
    for candidate in range(len(sums)):
        if sums[candidate] > least * (1 + 1e-12) and (best < 0 or sums[candidate] > sums[best]):
            best = candidate
    return best

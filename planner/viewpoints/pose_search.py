"""Search fewer views over all reachable poses, starting from the views of a cover.

A cover over candidates is optimal for these candidates only. The search leaves out the views with the smallest area of
their own and repairs the rest: in each round every view gets proposals, poses around its own. They are evaluated by a
direction table on the samples that no other view measures, and the best few are tested for reachability, those of all
views in one call. A view moves to the first reachable one unless it loses area; small losses are accepted with a
probability (Kirkpatrick, Gelatt, Vecchi 1983, doi:10.1126/science.220.4598.671, at a constant temperature). Few
proposals are better than many: views drift along plateaus of equal area, and the next gain is found from there. In some
rounds the best candidate is proposed as well.

When the table says that the goal is reached, exact rays on other samples decide; a shortfall there raises the goal.
Views that pass are the new start, with one view less. The last part of the effort moves the fewest views to a larger
area. Effort is counted in evaluated poses. Object frame, metres.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Protocol

import numpy as np
from scipy.sparse import csr_array

from planner.geometry.rigid import rotation_matrices
from planner.values import Bools, Floats, Ints, Value

EFFORTS = {"low": 20_000, "normal": 80_000, "high": 800_000}
"""Poses that a search evaluates."""

_PROPOSALS = 24  # of a view in a round
_TESTED = 4  # best proposals of a view that are tested for reachability
_LAST_PART = 0.2  # of the effort, for a larger area
_FROM_POOL = 4  # rounds between two in which candidates are proposed
_VIEWS_PER_REMOVAL = 10  # one view of this many is left out at a time
_MAX_TURN = np.deg2rad(15.0)  # of a proposal about its aim, for each component of the rotation vector
_MAX_SHIFT = 0.15  # of a proposal along each axis, as a share of the distance
_INTERLEAVED = 8  # the rows of a view are evaluated in this many passes over the surface, so that losses show early
_SMALLEST = 0.03  # scale of the smallest proposals; scales are log-uniform up to 1
_TEMPERATURE = 1.5e-4  # share of the surface
_PATIENCE = 60  # rounds without a better area after which the search returns to the best views


class PoseEvaluator(Protocol):
    """Fast approximate evaluation of poses on S samples."""

    def weights_measured(
        self, T_object_scanner: Floats, rows: Ints, weights: Floats, threshold: float = -np.inf
    ) -> Floats:
        """Return (n,) the sum of weights (m,) of the rows (m,) that each pose (n, 4, 4) [m] measures.

        A sum below the threshold may be partial.
        """
        ...

    def measured(self, T_object_scanner: Floats, rows: Ints | None = None) -> Bools:
        """Return (m, n) whether each pose (n, 4, 4) [m] measures each row; None: all S."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class SearchPoses(Value):
    """Poses of n views.

    Attributes:
        T_object_scanner: (n, 4, 4) [m].
        distance: (n,) to the point at which each is aimed [m].
        origin: (n,) number among the initial views and the candidates of the pose from which each was moved.
        moved: (n,) whether the pose differs from that candidate's.
    """

    T_object_scanner: Annotated[Floats, "n 4 4"]
    distance: Annotated[Floats, "n"]
    origin: Annotated[Ints, "n"]
    moved: Annotated[Bools, "n"]

    def __len__(self) -> int:
        return len(self.origin)

    def pick(self, which: Ints) -> "SearchPoses":
        """Return some of the poses."""
        return SearchPoses(self.T_object_scanner[which], self.distance[which], self.origin[which], self.moved[which])

    def at(self, view: int, T_object_scanner: Floats, pool: "SearchPoses", candidate: int | None) -> "SearchPoses":
        """Return the poses with one view moved to a pose (4, 4) [m], which is that of a candidate or near its own."""
        T, distance = self.T_object_scanner.copy(), self.distance.copy()
        origin, moved = self.origin.copy(), self.moved.copy()
        T[view], moved[view] = T_object_scanner, candidate is None
        if candidate is not None:
            distance[view], origin[view] = pool.distance[candidate], pool.origin[candidate]
        return SearchPoses(T, distance, origin, moved)


def join_poses(parts: Sequence[SearchPoses]) -> SearchPoses:
    """Concatenate poses."""
    return SearchPoses(
        np.concatenate([part.T_object_scanner for part in parts]),
        np.concatenate([part.distance for part in parts]),
        np.concatenate([part.origin for part in parts]),
        np.concatenate([part.moved for part in parts]),
    )


Shortfall = Callable[[SearchPoses], float]
"""Return the share of the surface by which views miss the requirement, by exact rays; at most 0 if they hold it."""


@dataclass(frozen=True, slots=True, eq=False)
class SearchResult:
    """Result of a search.

    Attributes:
        views: the fewest views that passed the exact test; the initial ones if there are none.
        evaluated: number of evaluated poses.
    """

    views: SearchPoses
    evaluated: int


def search_poses(
    initial: Ints,
    pool: SearchPoses,
    evaluator: PoseEvaluator,
    weights: Floats,
    *,
    are_reachable: Callable[[Floats], Bools],
    shortfall: Shortfall,
    effort: int,
    rng: np.random.Generator,
    progress: Callable[[int, int], None] | None = None,
) -> SearchResult:
    """Search fewer views than the initial ones.

    Args:
        initial: (n,) candidates, numbers in `pool`.
        pool: reachable candidates.
        evaluator: of poses on S samples.
        weights: (S,) share of the surface of each sample.
        are_reachable: (m, 4, 4) [m] -> (m,) whether the arm takes up each pose without collision.
        shortfall: share of the surface by which views miss the requirement, by exact rays; at most 0 if they hold it.
        effort: poses that are evaluated.
        rng: of proposals and accepted moves.
        progress: called with (evaluated poses, effort).

    Returns:
        The result; Ctrl-C ends the search with the fewest views so far.
    """
    search = _Search(pool, evaluator, weights, are_reachable, effort, rng, progress)
    best = pool.pick(initial)
    count, before_last_part = max(1, len(best) // _VIEWS_PER_REMOVAL), round((1 - _LAST_PART) * effort)
    try:
        while search.evaluated < before_last_part and len(best) > 1:
            count = min(count, len(best) - 1)
            found = search.repaired(best, count, shortfall, before_last_part)
            if found is not None:
                best = found
            elif count > 1:
                count //= 2
        if len(best) < len(initial):
            best = search.with_larger_area(best, shortfall)
    except KeyboardInterrupt as stop:
        if type(stop) is not KeyboardInterrupt:  # a subclass is a kill, not a request for a result
            raise
    return SearchResult(best, search.evaluated)


class _Search:
    """State of a search: current views with the samples that they measure."""

    def __init__(
        self, pool: SearchPoses, evaluator: PoseEvaluator, weights: Floats, are_reachable: Callable[[Floats], Bools],
        effort: int, rng: np.random.Generator, progress: Callable[[int, int], None] | None,
    ) -> None:  # fmt: skip
        self.pool, self.evaluator, self.weights, self.are_reachable = pool, evaluator, weights, are_reachable
        self.effort, self.rng, self.progress = effort, rng, progress
        self.evaluated, self.rounds = 0, 0
        self.pool_measured = csr_array(evaluator.measured(pool.T_object_scanner).T, dtype=np.float32)
        self.views, self.measured = pool.pick(np.arange(0)), np.empty((len(weights), 0), dtype=np.bool_)
        self.count = np.zeros(len(weights), dtype=np.int64)

    def repaired(self, start: SearchPoses, removed: int, shortfall: Shortfall, effort: int) -> SearchPoses | None:
        """Return views without `removed` of the start that hold the requirement; None if the effort is exhausted."""
        measured = self.evaluator.measured(start.T_object_scanner)
        goal = float(self.weights[measured.any(axis=1)].sum()) + max(0.0, shortfall(start))
        kept = self._needed_most(measured, removed)
        self._set(start.pick(kept), measured[:, kept])
        limit = effort if removed == 1 else min(effort, self.evaluated + effort // 8)
        best, best_area, since = self.views, self._area(), 0
        while self.evaluated < limit:
            self._round()
            area = self._area()
            since += 1
            if area > best_area:
                best, best_area, since = self.views, area, 0
                if area >= goal:
                    missing = shortfall(best)
                    if missing <= 0:
                        return best
                    goal = area + missing
            elif since > _PATIENCE:
                self._set(best, self.evaluator.measured(best.T_object_scanner))
                since = 0
            if self.progress:
                self.progress(min(self.evaluated, self.effort), self.effort)
        return None

    def with_larger_area(self, start: SearchPoses, shortfall: Shortfall) -> SearchPoses:
        """Return the views moved to a larger area with the remaining effort, if exact rays confirm it."""
        self._set(start, self.evaluator.measured(start.T_object_scanner))
        best, best_area = start, self._area()
        while self.evaluated < self.effort:
            self._round()
            if (area := self._area()) > best_area:
                best, best_area = self.views, area
        return best if shortfall(best) < shortfall(start) else start

    def _set(self, views: SearchPoses, measured: Bools) -> None:
        self.views, self.measured = views, measured.copy()
        self.count = measured.sum(axis=1)

    def _area(self) -> float:
        return float(self.weights[self.count > 0].sum())

    def _needed_most(self, measured: Bools, removed: int) -> Ints:
        """Return all views but `removed`: repeatedly drop the one with the smallest area that no other measures."""
        kept, times = np.arange(measured.shape[1]), measured.sum(axis=1)
        for _ in range(removed):
            once = np.flatnonzero(times == 1)
            owner = measured[np.ix_(once, kept)].argmax(axis=1)
            least = int(np.argmin(np.bincount(owner, self.weights[once], len(kept))))
            times = times - measured[:, kept[least]]
            kept = np.delete(kept, least)
        return kept

    def _round(self) -> None:
        """Move each view to its best reachable proposal, if that loses nothing or little.

        Proposals of all views are evaluated and tested for reachability first; a move is decided by the views so far.
        """
        n, T = len(self.views), self._perturbed()
        accepted = _TEMPERATURE * np.log(self.rng.random(n))
        tested = []
        for view in range(n):
            rows, weights, least = self._rows(view, float(accepted[view]))
            area = self.evaluator.weights_measured(T[view], rows, weights, least)
            best = np.argsort(-area, kind="stable")[:_TESTED]
            tested += [(view, proposal) for proposal in best[area[best] >= least].tolist()]
        proposed = np.array([T[view, proposal] for view, proposal in tested]).reshape(-1, 4, 4)
        is_moved = np.zeros(n, dtype=np.bool_)
        for (view, _), pose, is_reachable in zip(tested, proposed, self.are_reachable(proposed), strict=True):
            if is_reachable and not is_moved[view]:
                is_moved[view] = self._move(view, pose, None, float(accepted[view]))
        if self.rounds % _FROM_POOL == _FROM_POOL - 1:
            for view in range(n):
                rows, weights, least = self._rows(view, 0.0)
                wanted = np.zeros(len(self.weights), dtype=np.float32)
                wanted[rows] = weights
                of_pool = np.asarray(self.pool_measured @ wanted)
                candidate = int(of_pool.argmax())
                if of_pool[candidate] > least:
                    self._move(view, self.pool.T_object_scanner[candidate], candidate, 0.0)
        self.evaluated += n * _PROPOSALS
        self.rounds += 1

    def _rows(self, view: int, accepted: float) -> tuple[Ints, Floats, float]:
        """Return the rows that no other view measures, their weights, and the weight that a new pose must measure."""
        only = np.flatnonzero(self.measured[:, view] & (self.count == 1))
        spread = [only[k::_INTERLEAVED] for k in range(_INTERLEAVED)]
        rows = np.concatenate([*spread, np.flatnonzero(self.count == 0)])
        return rows, self.weights[rows], float(self.weights[only].sum()) + accepted

    def _move(self, view: int, T_object_scanner: Floats, candidate: int | None, accepted: float) -> bool:
        """Move a view to a pose (4, 4) [m], if it measures enough of what no other view measures.

        Args:
            view: that is moved.
            T_object_scanner: near its pose, or that of a candidate [m].
            candidate: whose pose it is.
            accepted: change of the weight of measured samples that is accepted.

        Returns:
            Whether the view was moved.
        """
        new = self.evaluator.measured(T_object_scanner[None])[:, 0]
        old = self.measured[:, view]
        alone = self.count == old
        if self.weights[new & alone].sum() < self.weights[old & alone].sum() + accepted:
            return False
        self.count += new
        self.count -= old
        self.measured[:, view] = new
        self.views = self.views.at(view, T_object_scanner, self.pool, candidate)
        return True

    def _perturbed(self) -> Floats:
        """Return (n, _PROPOSALS, 4, 4) poses around those of the views [m]: shifted, and turned about their aim."""
        n, T = len(self.views), self.views.T_object_scanner
        u = self.rng.random((n * _PROPOSALS, 7))
        scale = _SMALLEST ** u[:, 6:]
        distance = np.repeat(self.views.distance, _PROPOSALS)
        turn = rotation_matrices((2 * u[:, 3:6] - 1) * (_MAX_TURN * scale))
        R, t = (np.repeat(each, _PROPOSALS, axis=0) for each in (T[:, :3, :3], T[:, :3, 3]))
        aim = t + distance[:, None] * R[:, :, 2]
        found = np.tile(np.eye(4), (n * _PROPOSALS, 1, 1))
        found[:, :3, :3] = turn @ R
        found[:, :3, 3] = aim + np.einsum("nij,nj->ni", turn, t - aim)
        found[:, :3, 3] += (2 * u[:, :3] - 1) * (_MAX_SHIFT * scale * distance[:, None])
        return found.reshape(n, _PROPOSALS, 4, 4)

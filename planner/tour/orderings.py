"""Visiting order of the views and the joint solution for each, at the shortest motion time.

The baseline is the usual two steps: a Christofides tour (networkx) through the scanner's positions in task space,
then the best joint solutions along it. The joint-space ordering starts there and solves order and joint solutions
together, as the generalised travelling salesman that they are (`planner.tour.generalised_tsp`), with the time of the
synchronised joint move as cost and home at both ends: exactly where that is affordable, else by search with a lower
bound.

Visiting orders that are given: only joint solutions are chosen, and the places of views that the order leaves out.

Each view that is left out goes, one after the other, where the tour becomes the fastest with its best joint solutions.

Visiting orders in which each view overlaps an earlier one, so that scans can be registered as they come in.

The fastest order without this wish is taken first. Where it breaks the wish, orders that keep it are grown: from every
first view, always the view that overlaps an earlier one and comes next in the fastest order; the best of them is then
improved by moving single views to places that keep the wish. Every order is judged with its best joint solutions. This
is a heuristic: the lower bound is that of orders without the wish.
"""

from collections.abc import Sequence as Numbers
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Annotated, Any, Protocol

import numpy as np

from planner.errors import PlannerError
from planner.tour import bounds
from planner.tour import generalised_tsp as gtsp
from planner.tour.visits import TourProblem
from planner.values import Bools, Floats, Ints, Value, readonly
from planner.worded import Worded

_MATCHED = 10  # nearest places with which one of odd degree may be matched; more where these leave one alone


class OrderStatus(Worded):
    """What is known about a sequence."""

    OPTIMAL = 0, "no order and choice of joint solutions takes less time"
    HEURISTIC = 1, "the best order found within the budget"
    NO_TOUR = 2, "every order that was found needs a move that cannot be driven"


@dataclass(frozen=True, slots=True, eq=False)
class OrderedViews(Value):
    """Views in visiting order with a joint solution each; home comes before the first and after the last.

    Attributes:
        order: (n,) views, as indices into the configurations.
        choice: (n,) joint solution taken for each view of `order`, as an index into that view's configurations.
        q: (n, axes) joint angles in visiting order [rad].
        duration: time of all moves [s], standstill not counted; inf where `status` is NO_TOUR.
        baseline_duration: time along the Christofides tour with its best joint solutions [s]; inf if it cannot be
            driven.
        lower_bound: no order of these views through these joint solutions takes less [s].
        status: what is known about the result.
    """

    order: Annotated[Ints, "n"]
    choice: Annotated[Ints, "n"]
    q: Annotated[Floats, "n axes"]
    duration: float
    baseline_duration: float
    lower_bound: float
    status: OrderStatus


class Ordering(Protocol):
    """What orders views; `sequence` says what the arguments are."""

    def __call__(
        self,
        moves: TourProblem,
        T_base_scanner: Floats,
        rng: np.random.Generator,
        *,
        budget: int = ...,
        bound_work: int | None = ...,
        T_base_home: Floats | None = ...,
        start: Ints | None = ...,
    ) -> OrderedViews:
        """Order views."""
        ...


def order_views(
    moves: TourProblem,
    T_base_scanner: Floats,
    rng: np.random.Generator,
    *,
    budget: int = gtsp.STEPS,
    bound_work: int | None = gtsp.BOUND_EFFORT,
    T_base_home: Floats | None = None,
    start: Ints | None = None,
) -> OrderedViews:
    """Order the views in joint space.

    Args:
        moves: the joint solutions of n views and home, and what moves between them cost.
        T_base_scanner: (n, 4, 4) scanner pose of each view [m], base frame.
        rng: source of the search's randomness.
        budget: tours that the search may look at; the exact search takes its place wherever that is no dearer, and for
            small problems always.
        bound_work: edges that the lower bound may look at; 0 takes the quick, weak bound, None no bound at all.
        T_base_home: (4, 4) scanner pose at home [m]; without it, home enters the baseline where it costs least.
        start: (k,) order known from before, of all views or of some: the others are put where they lengthen it least.
            Where it beats the baseline, the search goes on from it (`generalised_tsp.solve`: warm).

    Returns:
        The sequence. Its duration is never above the baseline's.

    Raises:
        PlannerError: if shapes do not fit, or `start` is no order.
    """
    problem = moves.instance()
    baseline = _christofides(problem, T_base_scanner, T_base_home)
    starts = [baseline] if start is None else [baseline, _completed(problem, start)]
    best = int(np.argmin([gtsp.best_nodes(problem, order)[0] for order in starts]))
    found = gtsp.solve(problem, starts[best], rng, budget, bound_work, warm=best == 1)
    return _result(problem, moves, found, baseline)


def _completed(problem: gtsp.Instance, start: Ints) -> Ints:
    """(n,) order of the clusters 1.. that keeps a given one of some views and inserts each other where it costs least.

    What an insertion costs is taken from the cheapest edges between clusters: a first tour to search on from.
    """
    n = problem.n_clusters - 1
    start = readonly("start", start, (None,), np.int64)
    missing = np.setdiff1d(np.arange(n), start)
    if len(start) + len(missing) != n or len(np.unique(start)) != len(start):
        raise PlannerError(f"start is no order of the views; it must hold numbers of 0 to {n - 1}, each at most once")
    order = [0, *(start + 1).tolist()]
    if len(missing):
        between = bounds.cluster_distances(problem.either, problem.first)
        for k in missing + 1:
            after = np.roll(order, -1)
            order.insert(1 + int(np.argmin(between[order, k] + between[k, after] - between[order, after])), int(k))
    return np.array(order[1:], dtype=np.int64)


def _christofides(problem: gtsp.Instance, T_base_scanner: Floats, T_base_home: Floats | None) -> Ints:
    """(n,) order of the clusters 1.. along a Christofides tour through the scanner's positions."""
    n = problem.n_clusters - 1
    positions = readonly("T_base_scanner", T_base_scanner, (n, 4, 4))[:, :3, 3]
    if T_base_home is not None:
        positions = np.concatenate((readonly("T_base_home", T_base_home, (4, 4))[None, :3, 3], positions))
    tour = _task_space_tour(positions)
    if T_base_home is not None:
        return np.roll(tour, -int(np.flatnonzero(tour == 0)[0]))[1:]
    cuts = [np.roll(tour, -k) + 1 for k in range(max(n, 1))]
    return cuts[int(np.argmin([gtsp.best_nodes(problem, cut)[0] for cut in cuts]))]


def _task_space_tour(positions: Floats) -> Ints:
    """(m,) cyclic Christofides tour through (m, 3) positions [m]."""
    m = len(positions)
    if m < 4:  # every cyclic order has the same length
        return np.arange(m, dtype=np.int64)
    return np.array(_christofides_tour(np.ascontiguousarray(positions).tobytes(), m), dtype=np.int64)


@lru_cache(maxsize=16)
def _christofides_tour(positions: bytes, m: int) -> tuple[int, ...]:
    """The same of the bytes of the positions: the rounds of one search ask again and again.

    As `networkx.approximation.christofides`, but each place of odd degree is matched with one of its nearest: among all
    of them 250 places would take eight seconds.
    """
    import networkx as nx  # 0.1 s that a help text should not cost

    points = np.frombuffer(positions).reshape(m, 3)
    lengths = np.linalg.norm(points[:, None] - points[None], axis=2)
    graph = nx.Graph()
    graph.add_weighted_edges_from((a, b, float(lengths[a, b])) for a in range(m) for b in range(a))
    tree = nx.minimum_spanning_tree(graph)
    odd = np.array([place for place, degree in tree.degree if degree % 2])
    between = lengths[np.ix_(odd, odd)]
    rank, nearest = between.argsort(axis=1, kind="stable").argsort(axis=1), _MATCHED
    matched: set[tuple[int, int]] = set()
    while 2 * len(matched) < len(odd):
        near = nx.Graph()
        pairs = np.argwhere(np.tril(np.minimum(rank, rank.T) <= nearest, -1))
        near.add_weighted_edges_from((int(odd[a]), int(odd[b]), float(between[a, b])) for a, b in pairs)
        matched, nearest = nx.min_weight_matching(near), 2 * nearest
    both = nx.MultiGraph([*tree.edges, *matched])
    return tuple(dict.fromkeys(a for a, _ in nx.eulerian_circuit(both)))


def _result(problem: gtsp.Instance, moves: TourProblem, found: gtsp.TourSolution, baseline: Ints) -> OrderedViews:
    """What was found, with its status."""
    clusters = problem.clusters_of(found.tour)[1:]
    if found.cost >= gtsp.BLOCKED:
        status = OrderStatus.NO_TOUR
    else:
        status = OrderStatus.OPTIMAL if found.optimal else OrderStatus.HEURISTIC
    return OrderedViews(
        order=clusters - 1,
        choice=found.tour[1:] - problem.first[clusters],
        q=moves.q[found.tour[1:]],
        duration=_time(found.cost),
        baseline_duration=_time(gtsp.best_nodes(problem, baseline)[0]),
        lower_bound=_time(found.lower_bound),
        status=status,
    )


def _time(cost: float) -> float:
    """The cost as a time: infinite where a blocked edge is in it."""
    return cost if cost < gtsp.BLOCKED else float("inf")


def fixed_order(given: Numbers[int]) -> Ordering:
    """An ordering that keeps a given order; without effect where views of it are missing.

    Where a bound is asked for, baseline and bound are those of the free order.

    Args:
        given: views in visiting order, each at most once.
    """

    def ordering(moves: TourProblem, *arguments: Any, **options: Any) -> OrderedViews:
        problem = moves.instance()
        n = problem.n_clusters - 1
        if n <= max(given, default=-1):
            return order_views(moves, *arguments, **options)  # the caller says what is missing
        order = np.array(given, dtype=np.int64)
        for view in sorted(set(range(n)) - set(given)):
            trials = [np.insert(order, place, view) for place in range(len(order) + 1)]
            order = min(trials, key=lambda trial: gtsp.best_nodes(problem, trial + 1)[0])
        cost, tour = gtsp.best_nodes(problem, order + 1)
        free = order_views(moves, *arguments, **options) if options.get("bound_work") is not None else None
        drivable = cost < gtsp.BLOCKED
        return OrderedViews(
            order=order,
            choice=tour[1:] - problem.first[order + 1],
            q=moves.q[tour[1:]],
            duration=cost if drivable else float("inf"),
            baseline_duration=float("inf") if free is None else free.baseline_duration,
            lower_bound=0.0 if free is None else free.lower_bound,
            status=OrderStatus.HEURISTIC if drivable else OrderStatus.NO_TOUR,
        )

    return ordering


Joined = Bools
"""(n, n) which views overlap."""

_STEPS_PER_TRIAL = 30
"""Steps of the free search's budget that one trial of an order costs: judging an order takes about as long."""


def is_connected_order(joined: Joined, order: Ints) -> bool:
    """Whether each view of an order but the first overlaps an earlier one."""
    return all(joined[order[k], order[:k]].any() for k in range(1, len(order)))


def grow_order(joined: Joined, wanted: Ints, first: int) -> Ints | None:
    """The order from a first view on that keeps the wish and follows another order where it may; None without any.

    Args:
        joined: which views overlap.
        wanted: (n,) the order that is followed, cyclically from the first view on.
        first: view to begin with.
    """
    waiting = np.roll(wanted, -int(np.flatnonzero(wanted == first)[0])).tolist()
    order = [waiting.pop(0)]
    while waiting:
        following = next((view for view in waiting if joined[view, order].any()), None)
        if following is None:
            return None
        waiting.remove(following)
        order.append(following)
    return np.array(order, dtype=np.int64)


def overlapping_order(joined: Joined) -> Ordering:
    """An ordering of views that overlap; without effect where some of them are missing.

    Args:
        joined: (n, n) which views overlap, in the order in which they are numbered.
    """

    def ordering(moves: TourProblem, *arguments: Any, **options: Any) -> OrderedViews:
        free = order_views(moves, *arguments, **options)
        if len(free.order) != len(joined) or is_connected_order(joined, free.order):
            return free
        problem = moves.instance()
        both = (free.order, free.order[::-1])
        starts = [grow_order(joined, wanted, first) for wanted in both for first in range(len(joined))]
        kept = [order for order in starts if order is not None]
        if not kept:
            return free  # the graph does not hold together; the caller says so
        (cost, tour), best = min(
            ((gtsp.best_nodes(problem, order + 1), order) for order in kept), key=lambda j: j[0][0]
        )
        trials = options.get("budget", gtsp.STEPS) // _STEPS_PER_TRIAL
        for view in range(len(joined)):
            rest = best[best != view]
            for place in range(len(best)):
                trial = np.insert(rest, place, view)
                if trials <= 0 or not is_connected_order(joined, trial):
                    continue
                trials -= 1
                found = gtsp.best_nodes(problem, trial + 1)
                if found[0] < cost * (1 - 1e-12):
                    (cost, tour), best = found, trial
        clusters = problem.clusters_of(tour)[1:]
        choice = tour[1:] - problem.first[clusters]
        return replace(
            free,
            order=clusters - 1,
            choice=choice,
            q=moves.q[tour[1:]],
            duration=cost if cost < gtsp.BLOCKED else float("inf"),
            status=OrderStatus.HEURISTIC if cost < gtsp.BLOCKED else OrderStatus.NO_TOUR,
        )

    return ordering

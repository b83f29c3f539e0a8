"""Order the views and choose their configurations for the shortest motion.

The baseline has the usual two steps: a Christofides tour (networkx) through the scanner's positions in task space, then
the best configurations along it. The ordering in joint space starts there and solves order and configurations together,
as a generalised travelling salesman problem (`planner.tour.generalised_tsp`). Its cost is the time of the synchronised
joint moves, with home at both ends; it is solved exactly if affordable, else by search with a lower bound.

`fixed_order` and `overlapping_order` are orderings with side conditions, by heuristics; their lower bound is that of
the free order.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Annotated, Any, Protocol

import numpy as np

from planner.errors import PlannerError
from planner.tour import bounds
from planner.tour import generalised_tsp as gtsp
from planner.tour.visits import TourProblem
from planner.values import Bools, DescribedEnum, Floats, Ints, Value, readonly

_MATCHED = 10  # nearest places that are candidates for the match of a place of odd degree; more if one stays alone

_STEPS_PER_TRIAL = 30  # steps of the free search's budget per trial of an order: evaluating an order takes as long


class OrderStatus(DescribedEnum):
    """Quality of an order."""

    OPTIMAL = 0, "no order and choice of configurations takes less time"
    HEURISTIC = 1, "the best order found within the budget"
    NO_TOUR = 2, "every order that was found needs a move that cannot be driven"


@dataclass(frozen=True, slots=True, eq=False)
class OrderedViews(Value):
    """Views in visiting order with a configuration each; home comes before the first and after the last.

    Attributes:
        order: (n,) views, as indices into the configurations.
        choice: (n,) configuration of each view of `order`, as an index into that view's configurations.
        q: (n, axes) joint angles in visiting order [rad].
        duration: time of all moves [s], without dwell times; inf if `status` is NO_TOUR.
        baseline_duration: time along the Christofides tour with its best configurations [s]; inf if it cannot be
            driven.
        lower_bound: no order of these views through these configurations takes less [s].
        status: quality of the result.
    """

    order: Annotated[Ints, "n"]
    choice: Annotated[Ints, "n"]
    q: Annotated[Floats, "n axes"]
    duration: float
    baseline_duration: float
    lower_bound: float
    status: OrderStatus


class Ordering(Protocol):
    """A function that orders views; `order_views` documents the arguments."""

    def __call__(
        self,
        problem: TourProblem,
        T_base_scanner: Floats,
        rng: np.random.Generator,
        *,
        budget: int = ...,
        bound_effort: int | None = ...,
        T_base_home: Floats | None = ...,
        start: Ints | None = ...,
    ) -> OrderedViews:
        """Order views."""


def order_views(
    problem: TourProblem,
    T_base_scanner: Floats,
    rng: np.random.Generator,
    *,
    budget: int = gtsp.STEPS,
    bound_effort: int | None = gtsp.BOUND_EFFORT,
    T_base_home: Floats | None = None,
    start: Ints | None = None,
) -> OrderedViews:
    """Order the views in joint space.

    Args:
        problem: configurations of n views and home, with the times of the moves.
        T_base_scanner: (n, 4, 4) scanner pose of each view [m].
        rng: source of the search's randomness.
        budget: tours that the search may evaluate; the exact search replaces it if it costs no more, and for small
            problems always.
        bound_effort: edges that the lower bound may evaluate; 0: the quick, weak bound; None: no bound.
        T_base_home: (4, 4) scanner pose at home [m]; without it, home enters the baseline at its cheapest place.
        start: (k,) known order of some or all views; the others are inserted at their cheapest places. If it beats the
            baseline, the search continues from it (`generalised_tsp.solve`: warm).

    Returns:
        The order; its duration is never above the baseline's.
    """
    instance = problem.instance()
    baseline = _christofides(instance, T_base_scanner, T_base_home)
    starts = [baseline] if start is None else [baseline, _complete(instance, start)]
    best = int(np.argmin([gtsp.best_nodes(instance, order)[0] for order in starts]))
    solution = gtsp.solve(instance, starts[best], rng, budget, bound_effort, warm=best == 1)
    return OrderedViews(
        **_order_of(instance, problem, solution.cost, solution.tour, optimal=solution.optimal),
        baseline_duration=_time(gtsp.best_nodes(instance, baseline)[0]),
        lower_bound=_time(solution.lower_bound),
    )


def fixed_order(views: Sequence[int]) -> Ordering:
    """Return an ordering that keeps a given order of some views; without effect if one of them is missing.

    Each remaining view is inserted in turn at the place with the fastest tour, with the best configurations. If a bound
    is wanted, baseline and bound are those of the free order.
    """

    def ordering(problem: TourProblem, *arguments: Any, **options: Any) -> OrderedViews:
        instance = problem.instance()
        n = instance.n_clusters - 1
        if n <= max(views, default=-1):
            return order_views(problem, *arguments, **options)  # the caller reports the missing views
        order = np.array(views, dtype=np.int64)
        for view in sorted(set(range(n)) - set(views)):
            trials = [np.insert(order, place, view) for place in range(len(order) + 1)]
            order = min(trials, key=lambda trial: gtsp.best_nodes(instance, trial + 1)[0])
        has_bound = options.get("bound_effort") is not None
        free = order_views(problem, *arguments, **options) if has_bound else None
        return OrderedViews(
            **_order_of(instance, problem, *gtsp.best_nodes(instance, order + 1)),
            baseline_duration=float("inf") if free is None else free.baseline_duration,
            lower_bound=0.0 if free is None else free.lower_bound,
        )

    return ordering


def overlapping_order(overlap: Bools) -> Ordering:
    """Return an ordering in which each view overlaps an earlier one, so that scans can be registered as they arrive.

    It starts with the fastest free order. If this breaks the condition, orders that keep it are grown from every first
    view: the next view is the first one in the fastest order that overlaps an earlier view. The best of them is then
    improved by moving single views to places that keep the condition. Without effect if views are missing.

    Args:
        overlap: (n, n) whether views overlap, by their numbers.
    """

    def ordering(problem: TourProblem, *arguments: Any, **options: Any) -> OrderedViews:
        free = order_views(problem, *arguments, **options)
        if len(free.order) != len(overlap) or is_connected_order(overlap, free.order):
            return free
        instance = problem.instance()
        both = (free.order, free.order[::-1])
        grown = [grow_order(overlap, guide, first) for guide in both for first in range(len(overlap))]
        starts = [order for order in grown if order is not None]
        if not starts:
            return free  # the overlap graph is not connected; the caller reports it
        evaluated = [(gtsp.best_nodes(instance, order + 1), order) for order in starts]
        (cost, tour), best = min(evaluated, key=lambda each: each[0][0])
        trials = options.get("budget", gtsp.STEPS) // _STEPS_PER_TRIAL
        for view in range(len(overlap)):
            rest = best[best != view]
            for place in range(len(best)):
                trial = np.insert(rest, place, view)
                if trials <= 0 or not is_connected_order(overlap, trial):
                    continue
                trials -= 1
                solution = gtsp.best_nodes(instance, trial + 1)
                if solution[0] < cost * (1 - 1e-12):
                    (cost, tour), best = solution, trial
        return replace(free, **_order_of(instance, problem, cost, tour))

    return ordering


def is_connected_order(overlap: Bools, order: Ints) -> bool:
    """Return whether each view of an order except the first overlaps an earlier one, by `overlap` (n, n)."""
    return bool(np.tril(overlap[np.ix_(order, order)], -1)[1:].any(axis=1).all())


def grow_order(overlap: Bools, guide: Ints, first: int) -> Ints | None:
    """Return the connected order from a first view that follows another order where it can, or None without any.

    Args:
        overlap: (n, n) whether views overlap.
        guide: (n,) the order to follow, cyclically from the first view.
        first: the first view.
    """
    waiting = np.roll(guide, -int(np.flatnonzero(guide == first)[0]))
    order, reached = [waiting[0]], overlap[:, waiting[0]]
    while len(waiting := waiting[waiting != order[-1]]):
        if not (is_next := reached[waiting]).any():
            return None
        order.append(waiting[is_next.argmax()])
        reached = reached | overlap[:, order[-1]]
    return np.array(order, dtype=np.int64)


def _order_of(
    instance: gtsp.Instance, problem: TourProblem, cost: float, tour: Ints, *, optimal: bool = False
) -> dict[str, Any]:
    """Return the fields of `OrderedViews` that a closed tour of nodes determines."""
    clusters = instance.clusters_of(tour)[1:]
    status = OrderStatus.OPTIMAL if optimal else OrderStatus.HEURISTIC
    return {
        "order": clusters - 1,
        "choice": tour[1:] - instance.first[clusters],
        "q": problem.q[tour[1:]],
        "duration": _time(cost),
        "status": status if cost < gtsp.BLOCKED else OrderStatus.NO_TOUR,
    }


def _time(cost: float) -> float:
    """Return a cost as a time: infinite if it contains a blocked edge."""
    return cost if cost < gtsp.BLOCKED else float("inf")


def _complete(instance: gtsp.Instance, start: Ints) -> Ints:
    """Return (n,) an order of the clusters 1.. that keeps `start` and inserts the other views at their cheapest places.

    The cost of an insertion comes from the cheapest edges between clusters: the result is an initial tour.
    """
    n = instance.n_clusters - 1
    start = readonly("start", start, (None,), np.int64)
    missing = np.setdiff1d(np.arange(n), start)
    if len(start) + len(missing) != n or len(np.unique(start)) != len(start):
        raise PlannerError(
            f"start is not an order of the views; it must hold numbers of 0 to {n - 1}, each at most once"
        )
    order = [0, *(start + 1).tolist()]
    if len(missing):
        between = bounds.cluster_distances(instance.either, instance.first)
        for k in missing + 1:
            after = np.roll(order, -1)
            order.insert(1 + int(np.argmin(between[order, k] + between[k, after] - between[order, after])), int(k))
    return np.array(order[1:], dtype=np.int64)


def _christofides(instance: gtsp.Instance, T_base_scanner: Floats, T_base_home: Floats | None) -> Ints:
    """Return (n,) the order of the clusters 1.. along a Christofides tour through the scanner's positions."""
    n = instance.n_clusters - 1
    positions = readonly("T_base_scanner", T_base_scanner, (n, 4, 4))[:, :3, 3]
    if T_base_home is not None:
        positions = np.concatenate((readonly("T_base_home", T_base_home, (4, 4))[None, :3, 3], positions))
    m = len(positions)
    tour = np.arange(m, dtype=np.int64)  # up to three places every cyclic order has the same length
    if m > 3:
        tour = np.array(_christofides_tour(np.ascontiguousarray(positions).tobytes(), m), dtype=np.int64)
    if T_base_home is not None:
        return np.roll(tour, -int(np.flatnonzero(tour == 0)[0]))[1:]
    cuts = [np.roll(tour, -k) + 1 for k in range(max(n, 1))]
    return cuts[int(np.argmin([gtsp.best_nodes(instance, cut)[0] for cut in cuts]))]


@lru_cache(maxsize=16)  # the rounds of one search ask for the same tour again and again
def _christofides_tour(positions: bytes, m: int) -> tuple[int, ...]:
    """Return the cyclic Christofides tour through (m, 3) positions [m], given as bytes.

    As `networkx.approximation.christofides`, but each place of odd degree is matched with one of its nearest: among all
    of them 250 places would take eight seconds.
    """
    import networkx as nx  # 0.1 s that a help text does not pay for

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

"""Visiting order of the views and the joint solution for each, at the shortest motion time.

The baseline is the usual two steps: a Christofides tour (networkx) through the scanner's positions in task space,
then the best joint solutions along it. The joint-space ordering starts there and solves order and joint solutions
together, as the generalised travelling salesman that they are (`planner.order.generalised_tsp`), with the time of the
synchronised joint move as cost and home at both ends: exactly where that is affordable, else by search with a lower
bound.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Protocol

import numpy as np

from planner.errors import PlannerError
from planner.order import generalised_tsp as gtsp
from planner.order import tour_bound
from planner.order.moves import Moves
from planner.values import Floats, Ints, Value, readonly
from planner.worded import Worded

_MATCHED = 10  # nearest places with which one of odd degree may be matched; more where these leave one alone


class OrderStatus(Worded):
    """What is known about a sequence."""

    OPTIMAL = 0, "no order and choice of joint solutions takes less time"
    HEURISTIC = 1, "the best order found within the budget"
    NO_TOUR = 2, "every order that was found needs a move that cannot be driven"


@dataclass(frozen=True, slots=True, eq=False)
class Sequence(Value):
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
        moves: Moves,
        T_base_scanner: Floats,
        rng: np.random.Generator,
        *,
        budget: int = ...,
        bound_work: int | None = ...,
        T_base_home: Floats | None = ...,
        start: Ints | None = ...,
    ) -> Sequence:
        """Order views."""
        ...


def sequence(
    moves: Moves,
    T_base_scanner: Floats,
    rng: np.random.Generator,
    *,
    budget: int = gtsp.STEPS,
    bound_work: int | None = gtsp.BOUND_WORK,
    T_base_home: Floats | None = None,
    start: Ints | None = None,
) -> Sequence:
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
        between = tour_bound.between_clusters(problem.either, problem.first)
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


def _result(problem: gtsp.Instance, moves: Moves, found: gtsp.Found, baseline: Ints) -> Sequence:
    """What was found, with its status."""
    clusters = problem.clusters_of(found.tour)[1:]
    if found.cost >= gtsp.BLOCKED:
        status = OrderStatus.NO_TOUR
    else:
        status = OrderStatus.OPTIMAL if found.optimal else OrderStatus.HEURISTIC
    return Sequence(
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

"""Visiting order of the views and the joint solution for each, at the shortest motion time.

The baseline is the usual two steps: a Christofides tour (networkx) through the scanner's positions in task space,
then the best joint solutions along it. The joint-space ordering starts there and solves order and joint solutions
together, as the generalised travelling salesman that they are (`planner.order.generalised_tsp`), with the time of the
synchronised joint move as cost and home at both ends: exactly where that is affordable, else by search with a lower
bound.

Nodes are numbered as `node_offsets` says: 0 is home, then the joint solutions view by view.
"""

from collections.abc import Callable, Mapping
from collections.abc import Sequence as Many
from dataclasses import dataclass
from enum import IntEnum
from functools import lru_cache
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from planner.errors import PlannerError
from planner.order import generalised_tsp as gtsp
from planner.order.tour_bound import one_tree
from planner.ports import Floats, JointLimits
from planner.timing.motion import check_inside, move_time
from planner.values import Value, readonly

EdgeTimes = Mapping[tuple[int, int], float]


class OrderStatus(IntEnum):
    """What is known about a sequence."""

    OPTIMAL = 0
    HEURISTIC = 1
    NO_TOUR = 2

    @property
    def sentence(self) -> str:
        """The status in words, for reports."""
        return _SENTENCES[self]


_SENTENCES = {
    OrderStatus.OPTIMAL: "no order and choice of joint solutions takes less time",
    OrderStatus.HEURISTIC: "the best order found within the budget",
    OrderStatus.NO_TOUR: "every order that was found needs a move that cannot be driven",
}


@dataclass(frozen=True, slots=True, eq=False)
class Sequence(Value):
    """Views in visiting order with a joint solution each; home comes before the first and after the last.

    Attributes:
        order: (n,) views, as indices into the configurations.
        choice: (n,) joint solution taken for each view of `order`, as an index into that view's configurations.
        q: (n, 6) joint angles in visiting order [rad].
        duration: time of all moves [s], standstill not counted; inf where `status` is NO_TOUR.
        baseline_duration: time along the Christofides tour with its best joint solutions [s]; inf if it cannot be
            driven.
        lower_bound: no order of these views through these joint solutions takes less [s].
        status: what is known about the result.
        steps: tours that were looked at.
    """

    order: Annotated[NDArray[np.int64], "n"]
    choice: Annotated[NDArray[np.int64], "n"]
    q: Annotated[Floats, "n 6"]
    duration: float
    baseline_duration: float
    lower_bound: float
    status: OrderStatus
    steps: int


def node_offsets(configurations: Many[Floats]) -> NDArray[np.int64]:
    """Node numbers: solution i of view k is node `offsets[k] + i`, home is node 0.

    Args:
        configurations: per view, (n_i, 6) joint solutions [rad].

    Returns:
        (n + 1,) first node of each view, and the number of nodes.
    """
    return np.cumsum([1, *(len(q) for q in configurations)])


def sequence(
    configurations: Many[Floats],
    home: Floats,
    limits: JointLimits,
    *,
    T_base_scanner: Floats,
    rng: np.random.Generator,
    budget: int = gtsp.STEPS,
    bound_work: int | None = gtsp.BOUND_WORK,
    edge_time: EdgeTimes | None = None,
    T_base_home: Floats | None = None,
    start: NDArray[np.int64] | None = None,
    leaves: Many[NDArray[np.int64]] | None = None,
    stays: Many[Floats] | None = None,
    times: Floats | None = None,
) -> Sequence:
    """Order the views in joint space.

    Args:
        configurations: per view, (n_i, 6) collision-free joint solutions [rad]; at least one each.
        home: (6,) joint angles at which the tour begins and ends [rad].
        limits: limits of the axes; the cost of a move is its time under them.
        T_base_scanner: (n, 4, 4) scanner pose of each view [m], base frame.
        rng: source of the search's randomness.
        budget: tours that the search may look at; the exact search takes its place wherever that is no dearer, and for
            small problems always.
        bound_work: edges that the lower bound may look at; 0 takes the quick, weak bound, None no bound at all.
        edge_time: times [s] of single edges between nodes, in either direction, that replace the straight move's time;
            inf where no path exists.
        T_base_home: (4, 4) scanner pose at home [m]; without it, home enters the baseline where it costs least.
        start: (n,) order known from before; the search begins with it where it beats the baseline.
        leaves: per view, (n_i,) the joint solution of the same view at which the arm leaves, when it arrived at each:
            a sweep ends where its reverse begins. None: where it arrived.
        stays: per view, (n_i,) time between arriving and leaving [s], part of the durations. None: none is counted.
        times: (N, N) times [s] between all nodes where they are known already; None: those of straight moves.

    Returns:
        The sequence. Its duration is never above the baseline's.

    Raises:
        PlannerError: if a view has no joint solution, a joint angle is outside its range, or shapes do not fit.
    """
    problem = instance(configurations, home, limits, edge_time, leaves, stays, times)
    baseline = _christofides(problem, T_base_scanner, T_base_home)
    starts = [baseline] if start is None else [baseline, 1 + _permutation(start, len(configurations))]
    costs = [gtsp.best_nodes(problem, order)[0] for order in starts]
    return _result(
        problem,
        configurations,
        gtsp.solve(problem, starts[int(np.argmin(costs))], rng, budget, bound_work),
        baseline,
    )


def christofides(
    configurations: Many[Floats],
    home: Floats,
    limits: JointLimits,
    *,
    T_base_scanner: Floats,
    rng: np.random.Generator,
    budget: int = gtsp.STEPS,
    bound_work: int | None = gtsp.BOUND_WORK,
    edge_time: EdgeTimes | None = None,
    T_base_home: Floats | None = None,
    start: NDArray[np.int64] | None = None,
    leaves: Many[NDArray[np.int64]] | None = None,
    stays: Many[Floats] | None = None,
    times: Floats | None = None,
) -> Sequence:
    """The baseline: a Christofides tour in task space, then its best joint solutions; arguments as in `sequence`.

    The tour's length is at most 1.5 times the shortest in task space (Christofides 1976); its time has no such bound.
    """
    problem = instance(configurations, home, limits, edge_time, leaves, stays, times)
    baseline = _christofides(problem, T_base_scanner, T_base_home)
    cost, tour = gtsp.best_nodes(problem, baseline)
    quick = one_tree(problem.either, problem.first)
    return _result(problem, configurations, gtsp.Found(tour, cost, min(quick, cost), 1), baseline)


Ordering = Callable[..., Sequence]
"""Takes what `sequence` takes."""

ORDERINGS: dict[str, Ordering] = {"joint-space": sequence, "christofides": christofides}


def instance(
    configurations: Many[Floats],
    home: Floats,
    limits: JointLimits,
    edge_time: EdgeTimes | None,
    leaves: Many[NDArray[np.int64]] | None,
    stays: Many[Floats] | None,
    times: Floats | None = None,
) -> gtsp.Instance:
    """The travelling salesman's instance: one cluster per view, straight-move times, single edges replaced."""
    solutions = [readonly(f"configurations of view {k}", q, (None, 6)) for k, q in enumerate(configurations)]
    for k, q in enumerate(solutions):
        if len(q) == 0:
            raise PlannerError(f"view {k} has no joint solution; drop it before ordering")
        check_inside(f"joint solution of view {k}: number", q, limits)
    start = readonly("home", home, (6,))
    check_inside("home: number", start[None], limits)
    nodes = np.concatenate([start[None], *solutions])
    if times is None:
        cost = move_time(nodes[:, None], nodes, limits)
    else:
        cost = readonly("times", times, (len(nodes), len(nodes))).copy()
    for (a, b), time in (edge_time or {}).items():
        if not (0 <= a < len(nodes) and 0 <= b < len(nodes)) or not time >= 0:
            raise PlannerError(
                f"edge_time[({a}, {b})] is {time}; nodes are 0 to {len(nodes) - 1} and a time is at least 0 s"
            )
        cost[a, b] = cost[b, a] = time
    if leaves is not None:
        cost = cost[leaving(solutions, leaves)]
    if stays is not None:
        cost = cost + np.concatenate([np.zeros(1), *stays])
    return gtsp.instance(cost, np.concatenate(([0], node_offsets(solutions))))


def leaving(configurations: Many[Floats], leaves: Many[NDArray[np.int64]]) -> NDArray[np.int64]:
    """The node at which the arm leaves, for each node at which it arrives.

    Args:
        configurations: per view, (n_i, 6) joint solutions [rad].
        leaves: per view, (n_i,) joint solution of the same view, as `sequence` takes them.

    Raises:
        PlannerError: if an entry is no joint solution of its view.
    """
    first = node_offsets(configurations)[:-1]
    found = [np.zeros(1, dtype=np.int64)]
    for k, (q, to) in enumerate(zip(configurations, leaves, strict=True)):
        to = readonly(f"leaves of view {k}", to, (len(q),), np.int64)
        if ((to < 0) | (to >= len(q))).any():
            raise PlannerError(f"leaves of view {k} must be joint solutions of it, 0 to {len(q) - 1}")
        found.append(first[k] + to)
    return np.concatenate(found)


def _permutation(order: NDArray[np.int64], n: int) -> NDArray[np.int64]:
    """The order, if it names each of n views once."""
    order = readonly("start", order, (n,), np.int64)
    if not np.array_equal(np.sort(order), np.arange(n)):
        raise PlannerError(f"start is no order of the views; it must hold each of 0 to {n - 1} once")
    return np.asarray(order)


def _christofides(problem: gtsp.Instance, T_base_scanner: Floats, T_base_home: Floats | None) -> NDArray[np.int64]:
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


def _task_space_tour(positions: Floats) -> NDArray[np.int64]:
    """(m,) cyclic Christofides tour through (m, 3) positions [m]."""
    m = len(positions)
    if m < 4:  # every cyclic order has the same length
        return np.arange(m, dtype=np.int64)
    return np.array(_christofides_tour(np.ascontiguousarray(positions).tobytes(), m), dtype=np.int64)


@lru_cache(maxsize=16)
def _christofides_tour(positions: bytes, m: int) -> tuple[int, ...]:
    """The same of the bytes of the positions: the rounds of one search ask again and again."""
    import networkx as nx  # 0.1 s that a help text should not cost

    points = np.frombuffer(positions).reshape(m, 3)
    graph = nx.Graph()
    lengths = np.linalg.norm(points[:, None] - points[None], axis=2)
    graph.add_weighted_edges_from((a, b, float(lengths[a, b])) for a in range(m) for b in range(a))
    tour: list[int] = nx.approximation.christofides(graph)
    return tuple(tour[:-1])


def _result(
    problem: gtsp.Instance, configurations: Many[Floats], found: gtsp.Found, baseline: NDArray[np.int64]
) -> Sequence:
    """What was found, with its status."""
    clusters = problem.clusters_of(found.tour)[1:]
    choice = found.tour[1:] - problem.first[clusters]
    order = clusters - 1
    if found.cost >= gtsp.BLOCKED:
        status = OrderStatus.NO_TOUR
    else:
        status = OrderStatus.OPTIMAL if found.optimal else OrderStatus.HEURISTIC
    return Sequence(
        order=order,
        choice=choice,
        q=np.array([configurations[k][i] for k, i in zip(order, choice, strict=True)]).reshape(-1, 6),
        duration=_time(found.cost),
        baseline_duration=_time(gtsp.best_nodes(problem, baseline)[0]),
        lower_bound=_time(found.lower_bound),
        status=status,
        steps=found.steps,
    )


def _time(cost: float) -> float:
    """The cost as a time: infinite where a blocked edge is in it."""
    return cost if cost < gtsp.BLOCKED else float("inf")

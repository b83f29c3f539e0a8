"""Generalised travelling salesman problem: a closed tour through one node of every cluster.

Pure combinatorics on a matrix of edge costs. For one order of the clusters the best nodes follow from an exact dynamic
programme over layers (`best_nodes`). Over orders, `solve_exactly` runs the dynamic programme of Held and Karp (1962,
doi:10.1137/0110015) on subsets of clusters, with nodes as states. If that is too expensive, `search` finds a good tour
(`planner.tour.ruin_and_recreate`), and a lower bound limits its gap, up to a proof (`planner.tour.bounds`).

Costs may depend on the direction (a sweep begins and ends at different configurations); the bounds then hold for the
cheaper direction of each edge, which no tour undercuts. An edge that cannot be used costs `BLOCKED`, far more than any
real cost: tours are then compared first by the number of such edges, which infinite costs would not allow.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from planner.errors import PlannerError
from planner.tour import bounds
from planner.tour.ruin_and_recreate import anneal
from planner.values import Floats, Ints, readonly

BLOCKED = 1e7
"""Cost of an edge that cannot be used."""

ALWAYS_EXACT = 15_000_000
"""Effort (`exact_effort`) up to which the exact search is always used: 8 clusters of 24 nodes, 20 ms."""

STEPS = 10_000
"""Default budget of the search with up to 22 clusters, in tours ruined and rebuilt: 0.04 s; see `scale_steps`."""

BOUND_EFFORT = 400_000_000
"""Default budget of the bound in evaluated edges; about 0.3 s."""

_EXACT_PER_STEP = 45_000
"""Additions of the exact search per step of the search; with the default steps, 12 clusters of 24 nodes."""

_FIRST = 10  # one part in this many of the steps comes before the first strong bound

_PER_SUBSET = 20_000  # overhead of one subset in additions

MANY_CLUSTERS = 22
"""Number of clusters above which the steps grow with its square: 0.6 s at 80, 4 s at 200."""

_HOT, _COLD, _WARM = 2.5, 0.1, 0.03
"""Temperatures of the search, in mean costs of a cluster's two cheapest edges: first, last, and from a good tour."""


@dataclass(frozen=True, slots=True, eq=False)
class Instance:
    """Nodes, their clusters and the costs between them.

    Attributes:
        cost: (N, N) from node to node, finite, not negative. Entries inside one cluster are never used.
        back: (N, N) the transposed costs; `cost` itself if it is symmetric.
        either: (N, N) the cheaper direction of each edge; `cost` itself if it is symmetric.
        first: (m + 1,) cluster k holds the nodes first[k] to first[k + 1] - 1. Tours begin and end in cluster 0 (home).
    """

    cost: Floats
    back: Floats
    either: Floats
    first: Ints

    @property
    def symmetric(self) -> bool:
        """Whether no edge's cost depends on its direction."""
        return self.back is self.cost

    @property
    def n_clusters(self) -> int:
        """Number of clusters, with the start."""
        return len(self.first) - 1

    def clusters_of(self, nodes: Ints) -> Ints:
        """Return the cluster of each node."""
        return np.asarray(np.searchsorted(self.first, nodes, side="right") - 1)

    def length(self, tour: Ints) -> float:
        """Return the cost of a closed tour (m,) of nodes."""
        return float(self.cost[tour, np.roll(tour, -1)].sum()) if len(tour) > 1 else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class TourSolution:
    """A tour with its cost and a lower bound.

    Attributes:
        tour: (m,) nodes in visiting order, beginning in cluster 0; for symmetric costs in the direction in which the
            neighbour of the start with the smaller cluster number comes first.
        cost: cost of the closed tour.
        lower_bound: no tour costs less.
    """

    tour: Ints
    cost: float
    lower_bound: float

    @property
    def optimal(self) -> bool:
        """Whether no tour is cheaper, up to rounding."""
        return self.cost <= self.lower_bound * (1.0 + 1e-9) + 1e-12


def make_instance(cost: Floats, first: Ints) -> Instance:
    """Check costs and clusters and return the instance.

    Args:
        cost: (N, N) costs from node to node, not negative; inf for an edge that cannot be used.
        first: (m + 1,) first node of each cluster, and the number of nodes.
    """
    first = readonly("first", first, (None,), np.int64)
    if len(first) < 2 or first[0] != 0 or (np.diff(first) < 1).any():
        raise PlannerError("every cluster needs at least one node, and the first cluster begins at node 0")
    cost = readonly("cost", np.minimum(cost, BLOCKED), (int(first[-1]), int(first[-1])))
    if (cost < 0).any():
        raise PlannerError("the costs must not be negative")
    if np.array_equal(cost, cost.T):
        return Instance(cost, cost, cost, first)
    either = readonly("cost", np.minimum(cost, cost.T), cost.shape)
    return Instance(cost, readonly("cost", cost.T, cost.shape), either, first)


def scale_steps(problem: Instance, steps: int, *, warm: bool = False) -> int:
    """Return the steps for an instance: they grow with the square of the number of clusters beyond `MANY_CLUSTERS`.

    From a good tour (`warm`) they grow linearly: each part of it is changed as often as in a small tour.
    """
    return int(steps * max(1.0, (problem.n_clusters / MANY_CLUSTERS) ** (1 if warm else 2)))


def solve(
    problem: Instance,
    start: Ints,
    rng: np.random.Generator,
    steps: int = STEPS,
    bound_effort: int | None = BOUND_EFFORT,
    *,
    warm: bool = False,
) -> TourSolution:
    """Find the best tour within the budgets, with a bound: by `solve_exactly` if affordable, else by `search`.

    Args:
        problem: the instance.
        start: (m - 1,) clusters 1.. in an initial visiting order.
        rng: source of the search's randomness.
        steps: budget of the search with up to 22 clusters; larger instances get more (`scale_steps`).
        bound_effort: budget of the bound; 0: the quick one only; None: no bound (0).
        warm: whether `start` is the order of a good tour of nearly the same instance. Beyond 22 clusters the search
            then uses a temperature below its usual final one, because a higher one would destroy the tour, and fewer
            steps.

    Returns:
        A tour that is never worse than the best one for the order `start`.
    """
    if exact_effort(problem) <= max(ALWAYS_EXACT, _EXACT_PER_STEP * steps):
        return solve_exactly(problem)
    cost, tour = best_nodes(problem, start)
    steps = scale_steps(problem, steps, warm=warm)
    hot = _WARM if warm and problem.n_clusters > MANY_CLUSTERS else _HOT
    if bound_effort is None:
        cost, tour = search(problem, tour, int(rng.integers(2**63)), steps, hot)
        return _solution(problem, tour, cost, 0.0)
    quick = min(bounds.one_tree_bound(problem.either, problem.first), cost)
    seed, bound = int(rng.integers(2**63)), quick
    # A first part of the search often ends at a tour that the strong bound proves; the rest only runs if not.
    for part in (steps // _FIRST, steps) if bound_effort > 0 else (steps,):
        if cost > bound * (1.0 + 1e-9):
            cost, tour = search(problem, tour, seed, part, hot)
        if cost > bound * (1.0 + 1e-9) and bound == quick and bound_effort > 0 and cost < BLOCKED:
            strong = bounds.walk_bound(problem.either, problem.first, cost, bound_effort)
            bound = max(quick, strong.value)
            if strong.tour is not None and problem.length(strong.tour) < cost:
                tour = strong.tour
                cost = problem.length(tour)
    return _solution(problem, tour, cost, bound)


def best_nodes(problem: Instance, order: Ints) -> tuple[float, Ints]:
    """Return the cost and the closed tour (m,) of the best nodes for one order of the clusters 1.., exactly."""
    cost, first = problem.cost, problem.first
    best, tour = np.inf, np.zeros(1, dtype=np.int64)
    if len(order) == 0:
        return 0.0, tour
    members = [slice(int(first[k]), int(first[k + 1])) for k in order]
    for start in range(int(first[1])):
        reached, came_from = cost[start, members[0]], []
        for before, after in pairwise(members):
            through = reached[:, None] + cost[before, after]
            came_from.append(through.argmin(axis=0))
            reached = through.min(axis=0)
        total = reached + cost[members[-1], start]
        if float(total.min()) < best:
            best = float(total.min())
            path_nodes = [int(total.argmin())]
            for parents in reversed(came_from):
                path_nodes.append(int(parents[path_nodes[-1]]))
            tour = np.array(
                [start, *(m.start + i for m, i in zip(members, path_nodes[::-1], strict=True))], dtype=np.int64
            )
    return best, tour


def exact_effort(problem: Instance) -> int:
    """Return the effort of `solve_exactly` in additions: subsets times squared nodes, for each node of the start."""
    return int(2 ** min(problem.n_clusters - 1, 60)) * (len(problem.cost) ** 2 + _PER_SUBSET) * int(problem.first[1])


def solve_exactly(problem: Instance) -> TourSolution:
    """Find the optimum over all orders and nodes by dynamic programming over subsets; see `exact_effort`."""
    if problem.n_clusters == 1:
        return TourSolution(np.zeros(1, dtype=np.int64), 0.0, 0.0)
    solutions = [_exact_from(problem, start) for start in range(int(problem.first[1]))]
    cost, tour = min(solutions, key=lambda pair: pair[0])
    return _solution(problem, tour, cost, cost)


def search(problem: Instance, tour: Ints, seed: int, steps: int, hot: float = _HOT) -> tuple[float, Ints]:
    """Search a good tour within a number of steps, never worse than the initial one.

    Args:
        problem: the instance, of at least three clusters.
        tour: (m,) nodes of the initial tour.
        seed: from 0 to 2^63 - 1; equal seeds give equal tours.
        steps: tours to ruin and rebuild.
        hot: temperature at the first step, in mean costs of the two cheapest edges of a cluster.

    Returns:
        The cost, and the tour (m,), beginning in cluster 0.
    """
    if steps <= 0 or problem.n_clusters < 4:  # up to three clusters have one cyclic order
        return best_nodes(problem, problem.clusters_of(tour)[1:])
    between = bounds.cluster_distances(problem.either, problem.first)
    np.fill_diagonal(between, -1.0)  # each cluster is its own nearest
    near = np.argsort(between, axis=1, kind="stable")
    usable = np.where(between < BLOCKED, between, np.nan)
    two = np.sort(usable, axis=1)[:, 1:3]  # NaN comes last
    scale = max(float(np.nanmean(two)), 1e-12) if np.isfinite(two).any() else 1.0
    best = anneal(
        problem.cost, problem.back, problem.first, near, tour, steps, hot * scale, min(hot, _COLD) * scale, seed
    )
    return problem.length(best), best


def _exact_from(problem: Instance, start: int) -> tuple[float, Ints]:
    """Return the best tour through one node of the start."""
    n, cost, first = problem.n_clusters - 1, problem.cost, problem.first
    nodes = [slice(int(first[k]), int(first[k + 1])) for k in range(1, n + 1)]
    full = 2**n - 1
    best = np.full((full + 1, len(cost)), np.inf)  # cheapest path from the start through the subset, by last node
    for k in range(n):
        best[1 << k, nodes[k]] = cost[start, nodes[k]]
    for subset in range(1, full):
        inside = np.concatenate([np.arange(s.start, s.stop) for k, s in enumerate(nodes) if subset >> k & 1])
        onward = (best[subset, inside, None] + cost[inside]).min(axis=0)
        for k in range(n):
            if not subset >> k & 1:
                best[subset | 1 << k, nodes[k]] = onward[nodes[k]]
    tour, subset, ends = [], full, best[full] + cost[:, start]
    total = float(ends.min())
    while True:
        last = int(ends.argmin())
        tour.append(last)
        subset &= ~(1 << (int(problem.clusters_of(np.array(last))) - 1))
        if subset == 0:
            return total, np.array([start, *tour[::-1]], dtype=np.int64)
        ends = best[subset] + cost[:, last]


def _solution(problem: Instance, tour: Ints, cost: float, lower_bound: float) -> TourSolution:
    """Return the solution; for symmetric costs in the direction in which the second cluster has the smaller number."""
    clusters = problem.clusters_of(tour)
    if problem.symmetric and len(tour) > 2 and clusters[1] > clusters[-1]:
        tour = np.concatenate((tour[:1], tour[:0:-1]))
    if lower_bound > 0 and (problem.cost == np.floor(problem.cost)).all():  # the costs of all tours are integers too
        lower_bound = float(np.ceil(lower_bound * (1.0 - 1e-9)))
    return TourSolution(tour, cost, min(lower_bound, cost))

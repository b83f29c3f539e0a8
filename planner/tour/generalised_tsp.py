"""The generalised travelling salesman: visit every cluster once through one of its nodes, from the first and back.

Pure combinatorics on a matrix of edge costs. For one order of the clusters the best nodes follow from an exact dynamic
programme over layers (`best_nodes`). Over orders, `exact` runs the dynamic programme of Held and Karp (1962,
doi:10.1137/0110015) on subsets of clusters, with nodes as states. Where that is too dear, `search` looks for a good
tour (`planner.tour.ruin_and_recreate`), and `bound` says how good it is, up to a proof (`planner.tour.bounds`).

Costs may depend on the direction (a sweep ends elsewhere than it begins); the bounds then hold for the cheaper
direction of each edge, which no tour undercuts. An edge that cannot be used costs `BLOCKED`, a number that dwarfs every
real cost: a tour is then compared first by how many such edges it needs, which an infinite cost could not do.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from planner.errors import PlannerError
from planner.tour import bounds
from planner.values import Floats, Ints, readonly

BLOCKED = 1e7
"""Cost of an edge that cannot be used."""

ALWAYS_EXACT = 15_000_000
"""Price (`exact_work`) up to which the exact search is always run: 8 clusters of 24 nodes, 20 ms."""

STEPS = 10_000
"""Default budget of the search: tours ruined and rebuilt with up to 22 clusters, 0.04 s; more get more (`grown`)."""

BOUND_EFFORT = 400_000_000
"""Default budget of the bound: edges looked at; about 0.3 s."""

_EXACT_PER_STEP = 45_000
"""Additions of the exact search that are worth one step of the search; at the default, 12 clusters of 24 nodes."""

_FIRST = 10  # share of the steps, as its inverse, after which the strong bound is asked for a proof

_PER_SUBSET = 20_000  # additions that handling one subset costs beside its own

MANY_CLUSTERS = 22
"""Clusters from which on the steps grow with the square of their number: 0.6 s at 80, 4 s at 200."""

_HOT, _COLD, _WARM = 2.5, 0.1, 0.03
"""Temperatures of the search, in mean costs of the two cheapest edges of a cluster: at its begin and end, and all the
way from a tour that is good already."""


@dataclass(frozen=True, slots=True, eq=False)
class Instance:
    """Nodes, their clusters and the costs between them.

    Attributes:
        cost: (N, N) from node to node, finite, not negative. Entries inside one cluster are never used.
        back: (N, N) the same transposed; `cost` itself where it is symmetric.
        either: (N, N) the cheaper direction of each edge; `cost` itself where it is symmetric.
        first: (m + 1,) cluster k holds the nodes first[k] to first[k + 1] - 1. Tours begin and end in cluster 0; where
            that is a place such as home, it is its only node.
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
        """Number of clusters, that of the start included."""
        return len(self.first) - 1

    def clusters_of(self, nodes: Ints) -> Ints:
        """The cluster of each node."""
        return np.asarray(np.searchsorted(self.first, nodes, side="right") - 1)

    def length(self, tour: Ints) -> float:
        """Cost of a closed tour (m,) of nodes."""
        return float(self.cost[tour, np.roll(tour, -1)].sum()) if len(tour) > 1 else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class TourSolution:
    """A tour and what is known about it.

    Attributes:
        tour: (m,) nodes in visiting order, beginning in cluster 0; where costs are symmetric, the one of its two
            directions in which the lower of the two neighbours of the start comes first.
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
    """Check an instance.

    Args:
        cost: (N, N) costs from node to node, not negative; inf where an edge cannot be used.
        first: (m + 1,) first node of each cluster, and the number of nodes.

    Raises:
        PlannerError: if a cluster is empty or a cost negative.
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
    """A number of steps as it is spent on an instance: with the square of the number of clusters beyond 22.

    From a tour that is good already (`warm`), each part of it is only looked at as often as in a small one: linear.
    """
    return int(steps * max(1.0, (problem.n_clusters / MANY_CLUSTERS) ** (1 if warm else 2)))


def solve(
    problem: Instance,
    start: Ints,
    rng: np.random.Generator,
    steps: int = STEPS,
    bound_work: int | None = BOUND_EFFORT,
    *,
    warm: bool = False,
) -> TourSolution:
    """The best tour that the budgets allow, and a bound: by `exact` where that is affordable, else by `search`.

    Args:
        problem: the instance.
        start: (m - 1,) clusters 1.. in the visiting order to begin with.
        rng: source of the search's randomness.
        steps: budget of the search with up to 22 clusters; larger instances get more (`grown`).
        bound_work: budget of the bound; with 0 it is the quick one, with None there is none (0).
        warm: whether `start` is the order of a good tour of nearly the same instance. Beyond 22 clusters it is then
            searched on at a temperature below that at which a search ends, as a hot one would destroy it, with fewer
            steps.

    Returns:
        A tour that is never worse than the best one for the order `start`.
    """
    if exact_effort(problem) <= max(ALWAYS_EXACT, _EXACT_PER_STEP * steps):
        return solve_exactly(problem)
    cost, tour = best_nodes(problem, start)
    steps = scale_steps(problem, steps, warm=warm)
    hot = _WARM if warm and problem.n_clusters > MANY_CLUSTERS else _HOT
    if bound_work is None:
        cost, tour = search(problem, tour, int(rng.integers(2**63)), steps, hot)
        return _found(problem, tour, cost, 0.0)
    quick = min(bounds.one_tree_bound(problem.either, problem.first), cost)
    seed, bound = int(rng.integers(2**63)), quick
    # A first part of the search often ends at a tour that the strong bound proves; the rest is only run where not.
    for part in (steps // _FIRST, steps) if bound_work > 0 else (steps,):
        if cost > bound * (1.0 + 1e-9):
            cost, tour = search(problem, tour, seed, part, hot)
        if cost > bound * (1.0 + 1e-9) and bound == quick and bound_work > 0 and cost < BLOCKED:
            strong = bounds.walk_bound(problem.either, problem.first, cost, bound_work)
            bound = max(quick, strong.value)
            if strong.tour is not None and problem.length(strong.tour) < cost:
                tour = strong.tour
                cost = problem.length(tour)
    return _found(problem, tour, cost, bound)


def best_nodes(problem: Instance, order: Ints) -> tuple[float, Ints]:
    """The exact best node of each cluster for one order.

    Returns:
        The cost, and the closed tour (m,) of nodes that begins in cluster 0.
    """
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
            chosen = [int(total.argmin())]
            for parents in reversed(came_from):
                chosen.append(int(parents[chosen[-1]]))
            tour = np.array([start, *(m.start + i for m, i in zip(members, chosen[::-1], strict=True))], dtype=np.int64)
    return best, tour


def exact_effort(problem: Instance) -> int:
    """What `exact` needs, in additions: subsets times nodes squared and a share each, for each node of the start."""
    return int(2 ** min(problem.n_clusters - 1, 60)) * (len(problem.cost) ** 2 + _PER_SUBSET) * int(problem.first[1])


def solve_exactly(problem: Instance) -> TourSolution:
    """The optimum over all orders and nodes, by dynamic programming over subsets; see `exact_work` for its price."""
    if problem.n_clusters == 1:
        return TourSolution(np.zeros(1, dtype=np.int64), 0.0, 0.0)
    found = [_exact_from(problem, start) for start in range(int(problem.first[1]))]
    cost, tour = min(found, key=lambda pair: pair[0])
    return _found(problem, tour, cost, cost)


def search(problem: Instance, tour: Ints, seed: int, steps: int, hot: float = _HOT) -> tuple[float, Ints]:
    """A good tour within a number of steps, never worse than the one to begin with.

    Args:
        problem: the instance, of at least three clusters.
        tour: (m,) nodes of the tour to begin with.
        seed: from 0 to 2^63 - 1; equal seeds give equal tours.
        steps: tours to ruin and rebuild.
        hot: temperature at the first step, in mean costs of the two cheapest edges of a cluster.

    Returns:
        The cost, and the tour (m,), beginning in cluster 0.
    """
    if steps <= 0 or problem.n_clusters < 4:  # three clusters and fewer have one cyclic order, which has its best nodes
        return best_nodes(problem, problem.clusters_of(tour)[1:])
    from planner.tour.ruin_and_recreate import anneal  # importing numba costs 0.3 s, and small tours do without

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
    """The best tour through one node of the start."""
    n, cost, first = problem.n_clusters - 1, problem.cost, problem.first
    nodes = [slice(int(first[k]), int(first[k + 1])) for k in range(1, n + 1)]
    full = 2**n - 1
    best = np.full((full + 1, len(cost)), np.inf)  # cheapest way from the start through the subset, by last node
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


def _found(problem: Instance, tour: Ints, cost: float, lower_bound: float) -> TourSolution:
    """The tour; where costs are symmetric, in the direction in which its second cluster has the smaller number."""
    clusters = problem.clusters_of(tour)
    if problem.symmetric and len(tour) > 2 and clusters[1] > clusters[-1]:
        tour = np.concatenate((tour[:1], tour[:0:-1]))
    if lower_bound > 0 and (problem.cost == np.floor(problem.cost)).all():  # so is every tour's
        lower_bound = float(np.ceil(lower_bound * (1.0 - 1e-9)))
    return TourSolution(tour, cost, min(lower_bound, cost))

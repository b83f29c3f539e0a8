"""Lower bounds on the tours of a generalised travelling salesman problem.

`one_tree_bound` is quick and weak. It is the bound of Held and Karp (1970, doi:10.1287/opre.18.6.1138) on the clusters:
each pair of them costs as much as its cheapest pair of nodes, so a tour may change its node between arriving and
leaving.

`walk_bound` keeps the nodes. It is the shortest closed walk of `planner.tour.walk_relaxation` with prizes for visiting
each cluster, raised in rounds: a subgradient ascent in the prizes (Held, Wolfe and Crowder 1974,
doi:10.1007/BF01580223), with deflected directions (Camerini, Fratta and Maffioli 1975, doi:10.1007/BFb0120697). Then
the clusters that the walk visits again are remembered along the cycle (dynamic ng-sets: Roberti and Mingozzi 2014,
doi:10.1287/trsc.2013.0474), and nodes are eliminated through which no walk is cheaper than the known tour. A walk that
visits every cluster once is a tour, and no tour is shorter.

Up to about 100 clusters the second bound is the larger one by far; beyond, its effort is too high and the first one
applies.
"""

from dataclasses import dataclass

import numpy as np

from planner.tour import walk_relaxation as walks
from planner.values import Floats, Ints

_ONE_TREE_STEPS = 40
_MEMORIES = 11  # largest number of members of an NG set: 2048 memories per cluster
_NEAREST, _EVALUATIONS = 5, 30  # initial members, if the effort allows this many evaluations with them
_FEWEST = 10  # evaluations: after fewer the walks still go back and forth, far below the quick bound
_DEFLECTION = 0.6  # share of the last direction in the next one
_PATIENCE, _PROGRESS = 6, 1e-3  # evaluations without progress (a share of the gap) before the step is halved
_MIN_SCALE = 0.1  # share of the full step at which a round ends
_ELIMINATION_GAP = 0.25  # gap below which nodes are eliminated: an attempt costs about three evaluations
_PER_CLUSTER = 8  # overhead of a move between clusters, in edges
_ROUNDING = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class TourBound:
    """Result of the ascent.

    Attributes:
        value: no tour costs less.
        tour: (m,) nodes of a shortest tour, beginning in cluster 0, if the ascent found one; else None.
    """

    value: float
    tour: Ints | None


def one_tree_bound(cost: Floats, first: Ints) -> float:
    """Return the quick bound.

    Args:
        cost: (N, N) symmetric costs.
        first: (m + 1,) cluster k holds the nodes first[k] to first[k + 1] - 1.
    """
    m = len(first) - 1
    if m == 1:
        return 0.0
    cheapest = cluster_distances(cost, first)
    if m == 2:
        return float(2.0 * cheapest[0, 1])
    penalty, bound, step = np.zeros(m), 0.0, 0.5 * float(np.median(cheapest[0, 1:])) / (m - 1)
    for _ in range(_ONE_TREE_STEPS):
        lifted = cheapest + penalty[:, None] + penalty[None, :]
        total, degree = _cheapest_one_tree(lifted)
        bound = max(bound, total - 2.0 * float(penalty.sum()))
        if (degree == 2).all():
            break
        penalty += step * (degree - 2)
        step *= 0.95
    return bound


def cluster_distances(cost: Floats, first: Ints) -> Floats:
    """Return (m, m) the cost of the cheapest pair of nodes of each two clusters."""
    return np.asarray(np.minimum.reduceat(np.minimum.reduceat(cost, first[:-1], axis=0), first[:-1], axis=1))


def walk_bound(cost: Floats, first: Ints, tour_cost: float, effort: int) -> TourBound:
    """Return the strong bound.

    Args:
        cost: (N, N) symmetric costs.
        first: (m + 1,) cluster k holds the nodes first[k] to first[k + 1] - 1; m at least 3. A small cluster 0 is best.
        tour_cost: cost of a known tour; the closer it is to the best, the faster the ascent.
        effort: edges to evaluate; the evaluation that reaches it is finished. A thousand million take about a second.
            If it does not suffice for ten evaluations, as with 200 clusters at the default, the result is 0.
    """
    ascent = _Ascent(cost, first, tour_cost, effort)
    if ascent.price * _FEWEST > effort:
        return TourBound(0.0, None)
    while ascent.effort < effort:
        closed = ascent.raise_prizes(effort)
        if closed or not ascent.remember():
            break
        if tour_cost - ascent.best < _ELIMINATION_GAP * tour_cost:
            ascent.eliminate()
    return TourBound(min(ascent.best, tour_cost), ascent.tour)


class _Ascent:
    """Prizes, memories, remaining nodes and the best bound so far."""

    def __init__(self, cost: Floats, first: Ints, tour_cost: float, effort: int) -> None:
        m = len(first) - 1
        self.cost, self.first, self.upper = np.array(cost), np.array(first), tour_cost
        self.number = np.arange(len(cost))  # of the remaining nodes in the caller's numbering
        self.neighbours, self.count = np.zeros((m, _MEMORIES), dtype=np.int64), np.zeros(m, dtype=np.int64)
        self.prize, self.best, self.effort = np.zeros(m), -np.inf, 0
        self.walk: Ints = np.zeros(0, dtype=np.int64)
        self.tour: Ints | None = None
        visits = m - 1
        self.far = (visits + 2) // 2
        self.near = visits + 1 - self.far
        self._index()
        cheapest = cluster_distances(self.cost, self.first)
        cheapest[:, 0] = np.inf  # the start is never visited
        np.fill_diagonal(cheapest, np.inf)
        nearest = np.argsort(cheapest, axis=1, kind="stable")
        members = min(_NEAREST, visits - 1)
        while members > 0 and (self.price << members) * _EVALUATIONS > effort:  # the effort doubles with each member
            members -= 1
        self.neighbours[:, :members], self.count[1:] = nearest[:, :members], members
        self._index()

    def raise_prizes(self, effort: int) -> bool:
        """Execute one round of the ascent from the best prizes; return whether the gap is closed."""
        prize, direction = self.prize.copy(), np.zeros(len(self.prize) - 1)
        scale, since, reached = 1.0, 0, -np.inf
        while self.effort < effort and scale >= _MIN_SCALE:
            bound, walk = self._shortest(prize)
            visited = np.bincount(np.searchsorted(self.first, walk, side="right") - 1, minlength=len(prize))
            missed = (1 - visited)[1:]
            if bound > self.best:
                self.best, self.prize = bound, prize.copy()
            if not missed.any():
                self.best, self.tour = bound, self.number[walk]
                return True
            if self.best >= self.upper * (1.0 - _ROUNDING):
                return True
            if reached == -np.inf or bound > reached + _PROGRESS * (self.upper - reached):
                reached, since, self.walk = bound, 0, walk
            else:
                since += 1
            if since == _PATIENCE:
                prize, direction = self.prize.copy(), np.zeros_like(direction)
                scale, since = scale / 2.0, 0
                continue
            direction = missed + _DEFLECTION * direction
            prize[1:] += scale * (self.upper - bound) / max(float((direction**2).sum()), 1.0) * direction
        return False

    def remember(self) -> bool:
        """Forbid the cycles of the last good walk by remembering their first cluster; return whether any is new."""
        clusters = np.searchsorted(self.first, self.walk[1:], side="right") - 1
        last: dict[int, int] = {}
        grown = False
        for i, k in enumerate(clusters.tolist()):
            for inner in clusters[last[k] + 1 : i].tolist() if k in last else []:
                size = self.count[inner]
                if size < _MEMORIES and k not in self.neighbours[inner, :size]:
                    self.neighbours[inner, size] = k
                    self.count[inner] += 1
                    grown = True
            last[k] = i
        if grown:
            self._index()
        return grown

    def eliminate(self) -> None:
        """Eliminate nodes through which every walk, and so every tour, costs more than the known tour."""
        through = np.full(len(self.cost), np.inf)
        visits = self.near + self.far - 1
        for start in range(self.first[1]):
            value = self._layers(self.prize, start, visits)
            self.effort += self.price * visits // self.far
            from_start = np.inf
            for near in range(1, visits + 1):
                met = walks.join_walks(
                    value, self.first, self.prize, self.count, self.base, near, visits + 1 - near, through
                )
                from_start = min(from_start, met[0])
            through[start] = from_start
        is_retained = through + self.prize[1:].sum() <= self.upper * (1.0 + _ROUNDING)
        if is_retained.all():
            return
        sizes = np.add.reduceat(is_retained.astype(np.int64), self.first[:-1])
        if (sizes == 0).any():  # no tour is as cheap as the upper bound, which a given tour can only reach by rounding
            return
        self.cost = np.ascontiguousarray(self.cost[np.ix_(is_retained, is_retained)])
        self.number, self.first = self.number[is_retained], np.concatenate(([0], np.cumsum(sizes)))
        self._index()

    def _index(self) -> None:
        """Number the states after memories or nodes changed."""
        sizes = np.diff(self.first)
        states = sizes << self.count
        self.table, self.rows = walks.memory_table(self.neighbours, self.count)
        self.base = np.concatenate(([0], np.cumsum(states)))
        within = np.arange(self.base[-1]) - np.repeat(self.base[:-1], states)
        self.node_of = np.repeat(self.first[:-1], states) + within % np.repeat(sizes, states)
        self.row_of = np.repeat(self.rows, states) + within // np.repeat(sizes, states)
        moves = _PER_CLUSTER * int((1 << self.count[1:]).sum()) * len(sizes)
        self.price = (int(states[1:].sum()) * int(sizes[1:].sum()) + moves) * self.far

    def _layers(self, prize: Floats, start: int, depth: int) -> Floats:
        """Return the cost of the cheapest walk from a start to each state, by number of visits up to `depth`."""
        value = np.full((depth + 1, self.base[-1]), np.inf)
        walks.extend_walks(self.cost, self.first, prize, start, self.table, self.rows, self.count, self.base, value)
        return value

    def _shortest(self, prize: Floats) -> tuple[float, Ints]:
        """Return the bound under these prizes and the nodes of its walk."""
        best, walk = np.inf, self.walk
        for start in range(self.first[1]):
            value = self._layers(prize, start, self.far)
            self.effort += self.price
            length, cluster, node, memory, other = walks.join_walks(
                value, self.first, prize, self.count, self.base, self.near, self.far, np.full(len(self.cost), np.inf)
            )
            if length < best:
                best = length
                size = self.first[cluster + 1] - self.first[cluster]
                there = self._walked(value, prize, self.near, self.base[cluster] + memory * size + node)
                back = self._walked(value, prize, self.far, self.base[cluster] + other * size + node)
                walk = np.concatenate(([start], there[::-1], back[1:]))
        return best + float(prize[1:].sum()), walk

    def _walked(self, value: Floats, prize: Floats, depth: int, state: int) -> Ints:
        """Return (depth,) nodes of the cheapest walk to a state, from its last visit back to its first."""
        nodes = [self.node_of[state]]
        for k in range(depth, 1, -1):
            row, node = self.row_of[state], self.node_of[state]
            cluster = int(np.searchsorted(self.rows, row, side="right")) - 1
            before = np.flatnonzero((self.table[:, cluster] == row - self.rows[cluster])[self.row_of])
            reached = value[k - 1, before] - prize[cluster] + self.cost[self.node_of[before], node]
            state = before[np.abs(reached - value[k, state]).argmin()]
            nodes.append(self.node_of[state])
        return np.array(nodes)


def _cheapest_one_tree(cost: Floats) -> tuple[float, Ints]:
    """Return cost and degrees of the cheapest spanning tree on clusters 1.. and the two cheapest edges of cluster 0."""
    count = len(cost)
    degree = np.zeros(count, dtype=np.int64)
    near, parent = cost[1].copy(), np.ones(count, dtype=np.int64)
    near[[0, 1]] = np.inf
    total = 0.0
    for _ in range(count - 2):
        k = int(near.argmin())
        total += float(near[k])
        degree[k] += 1
        degree[parent[k]] += 1
        near[k] = np.inf
        closer = np.isfinite(near) & (cost[k] < near)
        near[closer] = cost[k, closer]
        parent[closer] = k
    two = np.argsort(cost[0, 1:], kind="stable")[:2] + 1
    degree[two] += 1
    degree[0] += 2
    return total + float(cost[0, two].sum()), degree

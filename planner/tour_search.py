"""The lazy search of a tour: order with cheap times, look at the edges, price what collides anew, order again.

The order is found with the times of straight moves; the edges of its tour are looked at, and those that collide are
priced anew, until every edge of the tour is real (the lazy evaluation of Bohlin and Kavraki 2000,
doi:10.1109/ROBOT.2000.844107, on a travelling salesman). As no path is faster than the straight move, a tour that is
optimal under these prices and whose edges are all real is optimal over the real times as well, as far as the guessed
prices of colliding moves are not too high.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from planner import generalised_tsp as gtsp
from planner import order as ordering_of_views
from planner.path import CHECKS, path_time
from planner.ports import Floats, JointLimits
from planner.roadmap import Edge, Roadmap

Progress = Callable[[int, int], None]
"""Called with the number of real edges and the number of edges of the tour under work."""


@dataclass(frozen=True, slots=True)
class MotionBudget:
    """Work that planning a motion may use; no clock is read, so equal input gives an equal motion.

    Attributes:
        orders: tours that one full ordering may look at (`planner.order.sequence`).
        bound: edges that the lower bound may look at.
        path_checks: configurations that the search of one detour may check.
        checks: configurations after which detours get only a token search.
        rounds: orderings at most; after them the edges of the last tour are made real without ordering again.
    """

    orders: int = gtsp.STEPS
    bound: int = gtsp.BOUND_WORK
    path_checks: int = CHECKS
    checks: int = 1_000_000
    rounds: int = 60


DEFAULT_BUDGET = MotionBudget()


class TourSearch:
    """The loop of ordering and looking; holds what changes between rounds.

    Attributes:
        views: views that still have a joint solution on the roadmap.
        unconnected: views that lost their last one.
        baseline: time of the Christofides tour with straight moves [s].
        lower_bound: no motion over all views is faster [s].
        rounds: orderings computed.
    """

    def __init__(
        self,
        roadmap: Roadmap,
        poses: Floats,
        T_base_home: Floats | None,
        limits: JointLimits,
        seed: int,
        budget: MotionBudget,
        ordering: str | ordering_of_views.Ordering,
        progress: Progress | None,
        stays: Floats | None = None,
    ) -> None:
        self.roadmap, self.poses, self.T_base_home, self.limits = roadmap, poses, T_base_home, limits
        self.seed, self.budget, self.progress = seed, budget, progress
        self.ordering = ordering_of_views.ORDERINGS[ordering] if isinstance(ordering, str) else ordering
        self.views = [k for k in range(len(poses)) if len(roadmap.nodes_of(k))]
        self.unconnected: list[int] = []
        self.baseline, self.lower_bound = 0.0, 0.0
        self.rounds = 0
        self.best: list[int] = []
        self.best_time = float("inf")
        self.stays = np.zeros(len(roadmap.q)) if stays is None else stays  # time between arriving and leaving, by node

    def run(self) -> list[int]:
        """Nodes of the best tour in visiting order, home at both ends; every edge of it is real."""
        wanted = list(self.views)
        nodes, full = self.order(self.budget.orders, []), True
        while self.rounds < self.budget.rounds:
            if self.make_real(nodes):
                if not self.keep(nodes) or full:
                    break
                # Quick orderings brought all edges to light; a full one may find a faster tour over them.
                full = True
                nodes = self.order(self.budget.orders, nodes)
            else:
                full = False
                nodes = self.order(self.budget.orders // 10, nodes)
        else:
            while not self.make_real(nodes):
                self.drop_unconnected()
                nodes = [node for node in nodes if node == 0 or self.usable(node)]
            self.keep(nodes)
        kept = {self.view_of(node) for node in self.best[1:-1]}
        self.unconnected = [k for k in wanted if k not in kept]
        return self.best

    def keep(self, nodes: list[int]) -> bool:
        """Keep a tour of real edges if it visits more views than the best so far, or as many in less time."""
        time = sum(path_time(self.path(a, b), self.limits) for a, b in self.edges(nodes))
        time += float(self.stays[nodes].sum())
        better = (-len(nodes), time) < (-len(self.best), self.best_time * (1 - 1e-9))
        if better:
            self.best, self.best_time = nodes, time
        return better

    def make_real(self, nodes: list[int]) -> bool:
        """Look at the tour's edges; where all straight moves were looked at before, search the blocked ones.

        Returns:
            Whether every edge of this tour is real now, and was priced so when the tour was ordered.
        """
        edges = self.edges(nodes)
        if not self.roadmap.look(edges):
            self.tell(edges)
            return False
        blocked = [e for e in edges if self.roadmap.blocked(*e)]
        for a, b in blocked:
            if self.roadmap.active[a] and self.roadmap.active[b]:
                self.roadmap.search(a, b)
                self.tell(edges)
        self.tell(edges)
        return not blocked

    def order(self, steps: int, before: list[int]) -> list[int]:
        """Order the views under the current prices, beginning with the order of an earlier tour."""
        self.drop_unconnected()
        roadmap, nodes = self.roadmap, [self.roadmap.nodes_of(k) for k in self.views]
        numbers = np.full(len(roadmap.q), -1)
        flat = np.concatenate([np.zeros(1, dtype=np.int64), *nodes])
        numbers[flat] = np.arange(len(flat))
        edge_time = {
            (int(numbers[a]), int(numbers[b])): time
            for (a, b), time in roadmap.prices().items()
            if numbers[a] >= 0 and numbers[b] >= 0
        }
        place = {view: k for k, view in enumerate(self.views)}
        start = [place[v] for node in before[1:-1] if (v := self.view_of(node)) in place]
        found = self.ordering(
            [roadmap.q[n] for n in nodes],
            roadmap.q[0],
            self.limits,
            T_base_scanner=self.poses[self.views],
            T_base_home=self.T_base_home,
            rng=np.random.default_rng([self.seed, self.rounds]),
            budget=steps,
            bound_work=self.budget.bound if self.rounds == 0 else 0,
            edge_time=edge_time,
            start=np.array(start) if len(start) == len(self.views) and start else None,
            leaves=None if self.at_rest else [numbers[roadmap.leave[n]] - numbers[n[0]] for n in nodes],
            stays=None if self.at_rest else [self.stays[n] for n in nodes],
        )
        if self.rounds == 0:  # no edge was looked at: times of straight moves, which no path undercuts
            self.baseline, self.lower_bound = found.baseline_duration, found.lower_bound
        self.rounds += 1
        return [0, *(int(nodes[k][i]) for k, i in zip(found.order, found.choice, strict=True)), 0]

    def drop_unconnected(self) -> None:
        """Move views that lost their last joint solution to `unconnected`."""
        lost = [k for k in self.views if len(self.roadmap.nodes_of(k)) == 0]
        self.unconnected += lost
        self.views = [k for k in self.views if k not in lost]

    @property
    def at_rest(self) -> bool:
        """Whether every view is left where it is entered, at once."""
        return bool((self.roadmap.leave == np.arange(len(self.roadmap.q))).all() and not self.stays.any())

    def usable(self, node: int) -> bool:
        """Whether a node can still be entered and left."""
        return bool(self.roadmap.active[node] and self.roadmap.active[self.roadmap.leave[node]])

    def edges(self, nodes: list[int]) -> list[Edge]:
        """Edges of the roadmap that a tour drives: from where each view is left to where the next is entered."""
        return [(int(self.roadmap.leave[a]), b) for a, b in edges_of(nodes)]

    def view_of(self, node: int) -> int:
        """View to which a node belongs."""
        return int(np.searchsorted(self.roadmap.offsets, node, side="right")) - 1

    def path(self, a: int, b: int) -> Floats:
        """Certified via points of a real edge."""
        found = self.roadmap.path(a, b)
        assert found is not None, "only real edges are asked for"
        return found

    def tell(self, edges: list[Edge]) -> None:
        """Report how many of the tour's edges are real."""
        if self.progress is not None:
            self.progress(sum(self.roadmap.path(a, b) is not None for a, b in edges), len(edges))


def edges_of(nodes: list[int]) -> list[Edge]:
    """Edges of a tour given by its nodes; none where it visits no view."""
    return list(pairwise(nodes)) if len(nodes) > 2 else []

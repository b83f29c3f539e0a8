"""The lazy search of a tour: order with cheap times, look at the edges, price what collides anew, order again.

The order is found with the times of straight moves; the edges of its tour are looked at, and those that collide are
priced anew, until every edge of the tour is real (the lazy evaluation of Bohlin and Kavraki 2000,
doi:10.1109/ROBOT.2000.844107, on a travelling salesman). As no path is faster than the straight move, a tour that is
optimal under these prices and whose edges are all real is optimal over the real times as well, as far as the guessed
prices of colliding moves are not too high.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from planner.path.path import MAX_CHECKS, is_detour, path_time
from planner.ports import ARM_AXES, JointLimits, Progress
from planner.tour import generalised_tsp as gtsp
from planner.tour.orderings import Ordering
from planner.tour.roadmap import Edge, Roadmap
from planner.tour.visits import TourProblem, Visits, best_nodes_on_tour, node_offsets, too_many_nodes
from planner.values import Floats, Ints


@dataclass(frozen=True, slots=True)
class MotionBudget:
    """Work that planning a motion may use; no clock is read, so equal input gives an equal motion.

    Attributes:
        orders: tours that one full ordering may look at (`planner.tour.orderings.order_views`).
        bound: edges that the lower bound may look at.
        path_checks: configurations that the search of one detour may check.
        checks: configurations after which detours get only a token search.
        rounds: orderings at most, shared evenly among the guesses; after them the edges of the last tour are made real
            without ordering again, where no tour is real yet.
        quick: share of `orders` that every ordering after the first gets, but the last, as its inverse.
        looks: how often the edges of a tour are looked at, and its joint solutions chosen anew, before it is ordered
            again.
        around: edges of the next best tours in the same order that are looked at each time; more of very many
            views.
        before_settling: configurations checked under each guess after which the search settles for what it has.
        polish: further searches for each detour of the final tour.
        guesses: what a colliding move is priced at until a detour is searched, one after the other: so many times the
            straight move's time, and so much more [s] (`planner.tour.roadmap`). A high guess finds a good tour with
            few searches; a low one after it searches what may still be faster.
    """

    orders: int = gtsp.STEPS
    bound: int = gtsp.BOUND_EFFORT
    path_checks: int = MAX_CHECKS
    checks: int = 1_000_000
    rounds: int = 600
    quick: int = 20
    looks: int = 12
    around: int = 4
    before_settling: int = 200_000
    polish: int = 4
    guesses: tuple[tuple[float, float], ...] = ((1.1, 1.2), (1.1, 0.35))


_DOUBT = 0.02
"""What an edge that nobody looked at costs more in quick orderings of many views [s]: they keep to what is known."""

_VERY_MANY = 100
"""Views from which on some edge of every ordering is new: orderings then go on until one is real and good enough."""

_THOROUGH = 4  # share of `orders`, as its inverse, that an ordering of very many views gets where quick ones settled

_WORTH = 0.005
"""Share of the motion below which what many views may still save is not searched for."""

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
        visits: Visits,
        limits: JointLimits,
        seed: int,
        budget: MotionBudget,
        ordering: Ordering,
        progress: Progress | None,
    ) -> None:
        self.roadmap, self.visits, self.limits = roadmap, visits, limits
        self.seed, self.budget, self.ordering, self.progress = seed, budget, ordering, progress
        self.views = [k for k in range(len(visits.configurations)) if len(roadmap.nodes_of(k))]
        self.unconnected: list[int] = []
        self.baseline, self.lower_bound = 0.0, 0.0
        self.rounds = 0
        self.best: list[int] = []
        self.best_time, self.promised = float("inf"), 0.0
        self.stays = visits.stays
        self.many, self.very_many = len(self.views) > gtsp.MANY_CLUSTERS, len(self.views) > _VERY_MANY

    def run(self) -> list[int]:
        """Nodes of the best tour in visiting order, home at both ends; every edge of it is real."""
        wanted = list(self.views)
        guesses = self.budget.guesses
        if self.many:  # low guesses have many detours searched: more than the checks last for
            guesses = guesses[:1]
        elif self.roadmap.q.shape[1] > ARM_AXES:  # many angles of a table are cheaper than a dear guess: all looked at
            guesses = guesses[-1:]
        for guess in guesses:
            guessed = self.roadmap.guess_by(*guess)
            if self.best and (not guessed or self.rounds >= self.budget.rounds):
                break
            self.settle()
        self.polish()
        kept = {self.view_of(node) for node in self.best[1:-1]}
        self.unconnected = [k for k in wanted if k not in kept]
        return self.best

    def settle(self) -> None:
        """Order and look in turns under one guess, until no ordering promises a faster tour than the best real one."""
        last_round = self.rounds + max(1, self.budget.rounds // len(self.budget.guesses))
        last_check = self.roadmap.checks + self.budget.before_settling * max(1, len(self.views) // gtsp.MANY_CLUSTERS)
        nodes, full = self.order(self.budget.orders, self.best), True
        while self.rounds < last_round and self.roadmap.checks < last_check:
            worth = _WORTH if self.many else 1e-9
            if full and self.promised >= self.best_time * (1 - worth) and len(nodes) <= len(self.best):
                return
            nodes, known = self.look_around(nodes)
            if known and self.make_real(nodes):
                if not self.keep(nodes) or full:
                    return
                # Quick orderings brought all edges to light; a full one may find a faster tour over them.
                full = True
            else:  # tours with edges that are all real are kept, whatever collides beside them
                full = self.very_many and self.kept(nodes) and self.promised >= self.best_time * (1 - worth)
            thorough = self.budget.orders // (_THOROUGH if self.very_many else 1)
            nodes = self.order(thorough if full else self.budget.orders // self.budget.quick, nodes)
        if self.best:
            return
        while not self.make_real(nodes):
            self.drop_unconnected()
            nodes = [node for node in nodes if node == 0 or self.usable(node)]
        self.keep(nodes)

    def look_around(self, nodes: list[int]) -> tuple[list[int], bool]:
        """Look at the edges of a tour and of the next best ones in its order of views, until its best one is known.

        Returns:
            The best tour in this order under the prices known now, and whether nothing was found to collide.
        """
        if len(nodes) < 3 or not self.budget.looks:
            return nodes, True
        known = True
        for _ in range(self.budget.looks):
            between = [self.roadmap.nodes_of(self.view_of(node)) for node in nodes[1:-1]]
            nodes, edges = self.through([np.array([0]), *between, np.array([0])])
            unseen = [e for e in self.edges(nodes) if self.roadmap.uninspected[e]]
            if not unseen:
                return nodes, known
            known = self.roadmap.look([*unseen, *edges]) and known
        return nodes, False

    def through(self, layers: list[Ints]) -> tuple[list[int], list[Edge]]:
        """The best tour through one node of each layer, and the unseen edges of the next best tours.

        Two dynamic programmes over the layers, one from each end, give for each edge the best tour that uses it.
        """
        times, unseen, leave = self.roadmap.times, self.roadmap.uninspected, self.roadmap.leave
        steps = [times[leave[a][:, None], b] + self.stays[b] for a, b in pairwise(layers)]
        onward = [np.zeros(1)]
        for step in reversed(steps):
            onward.append((step + onward[-1]).min(axis=1))
        onward.reverse()
        reached, nodes, at = np.zeros(1), [0], 0
        slack: list[Floats] = []
        found: list[Ints] = []
        for step, a, b, rest in zip(steps, layers, layers[1:], onward[1:], strict=False):
            total = reached[:, None] + step + rest
            i, j = np.nonzero(unseen[leave[a][:, None], b])
            slack.append(total[i, j])
            found.append(np.stack((leave[a][i], b[j]), axis=1))
            at = int((step[at] + rest).argmin())
            nodes.append(int(b[at]))
            reached = (reached[:, None] + step).min(axis=0)
        around = self.budget.around * (len(self.views) // gtsp.MANY_CLUSTERS if self.very_many else 1)
        best = _smallest(np.concatenate(slack), around)
        return nodes, [(int(a), int(b)) for a, b in np.concatenate(found)[best]]

    def polish(self) -> None:
        """Search the detours of the best tour again with more work."""
        for a, b in self.edges(self.best):
            if self.budget.polish and is_detour(self.path(a, b)):
                self.roadmap.improve(a, b, self.budget.polish)

    def kept(self, nodes: list[int]) -> bool:
        """Keep a tour if all its edges are real and it is the best so far; whether a real one is known."""
        if not any(self.roadmap.uninspected[e] or self.roadmap.blocked[e] for e in self.edges(nodes)):
            self.keep(nodes)
        return bool(self.best)

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
        blocked = [e for e in edges if self.roadmap.blocked[e]]
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
        if self.rounds and too_many_nodes(nodes):  # not in the first round, whose bound holds for all of them
            nodes = self.near(nodes, before)
        flat = np.concatenate([np.zeros(1, dtype=np.int64), *nodes])
        numbers = np.full(len(roadmap.q), -1)
        numbers[flat] = np.arange(len(flat))
        times, leave = roadmap.times[np.ix_(flat, flat)], numbers[roadmap.leave[flat]]
        if self.many and steps < self.budget.orders:
            times += _DOUBT * roadmap.uninspected[np.ix_(flat, flat)]
        place = {view: k for k, view in enumerate(self.views)}
        known = [self.view_of(node) for node in before[1:-1]] or self.visits.known
        start = [place[view] for view in known if view in place]
        found = self.ordering(
            TourProblem(roadmap.q[flat], node_offsets(nodes), times, leave, self.stays[flat]),
            self.visits.T_base_scanner[self.views],
            np.random.default_rng([self.seed, self.rounds]),
            budget=steps,
            bound_work=self.budget.bound if self.rounds == 0 else None,
            T_base_home=self.visits.T_base_home,
            start=np.array(start) if start else None,
        )
        if self.rounds == 0:  # no edge was looked at: times of straight moves, which no path undercuts
            self.baseline, self.lower_bound = found.baseline_duration, found.lower_bound
        self.rounds += 1
        self.promised = found.duration
        return [0, *(int(nodes[k][i]) for k, i in zip(found.order, found.choice, strict=True)), 0]

    def near(self, nodes: list[Ints], tour: list[int]) -> list[Ints]:
        """Those nodes of each view that make a tour through it least longer; all of a view that it does not visit."""
        times, leave = self.roadmap.times, self.roadmap.leave
        place = {self.view_of(node): k for k, node in enumerate(tour)}
        kept = []
        for view, own in zip(self.views, nodes, strict=True):
            if (k := place.get(view)) is not None:
                longer = times[leave[tour[k - 1]], own] + self.stays[own] + times[leave[own], tour[k + 1]]
                own = own[best_nodes_on_tour(longer, len(nodes))]
            kept.append(own)
        return kept

    def drop_unconnected(self) -> None:
        """Move views that lost their last joint solution to `unconnected`."""
        lost = [k for k in self.views if len(self.roadmap.nodes_of(k)) == 0]
        self.unconnected += lost
        self.views = [k for k in self.views if k not in lost]

    def usable(self, node: int) -> bool:
        """Whether a node can still be entered and left."""
        return bool(self.roadmap.active[node] and self.roadmap.active[self.roadmap.leave[node]])

    def edges(self, nodes: list[int]) -> list[Edge]:
        """Edges that a tour drives, from where each view is left to where the next is entered; none without a view."""
        return [(int(self.roadmap.leave[a]), b) for a, b in pairwise(nodes)] if len(nodes) > 2 else []

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


def _smallest(values: Floats, count: int) -> Ints:
    """Where the `count` smallest of (n,) values are, in order; of equal ones the first."""
    if len(values) > count:
        among = np.flatnonzero(values <= np.partition(values, count - 1)[count - 1])
        return among[np.argsort(values[among], kind="stable")[:count]]
    return np.argsort(values, kind="stable")

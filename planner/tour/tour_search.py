"""Lazy search of a tour: order with cheap times, inspect the edges, price the colliding ones, order again.

The first order uses the times of straight moves. The edges of its tour are inspected, and those that collide get new
prices, until every edge of the tour is real (the lazy evaluation of Bohlin and Kavraki 2000,
doi:10.1109/ROBOT.2000.844107, applied to a travelling salesman problem). No path is faster than the straight move. So a
tour that is optimal under these prices and whose edges are all real is also optimal over the real times, as far as the
guessed prices of colliding moves are not too high.
"""

from dataclasses import dataclass, replace
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
    """Effort for planning a motion; no clock is read, so equal input gives an equal motion.

    Attributes:
        orders: tours that a full ordering may evaluate (`planner.tour.orderings.order_views`).
        bound: edges that the lower bound may evaluate.
        path_checks: checks of the search of one detour.
        checks: checks after which detours get a small search only.
        rounds: largest number of orderings, shared evenly among the guesses. After them the edges of the last tour are
            made real without ordering again, if no tour is real yet.
        quick: inverse share of `orders` for each ordering between the first and the last.
        inspections: number of times that the edges of a tour are inspected, and its configurations chosen again, before
            it is ordered again.
        neighbours: edges of the next best tours in the same order that are inspected each time; more for very many
            views.
        guess_checks: checks under each guess after which the search accepts its result.
        polish: further searches for each detour of the final tour.
        guesses: prices of a colliding move until a detour is searched, used in turn: a factor on the straight move's
            time, and an offset [s] (`planner.tour.roadmap`). A high guess finds a good tour with few searches; a low
            one after it searches for faster ones.
    """

    orders: int = gtsp.STEPS
    bound: int = gtsp.BOUND_EFFORT
    path_checks: int = MAX_CHECKS
    checks: int = 1_000_000
    rounds: int = 600
    quick: int = 20
    inspections: int = 12
    neighbours: int = 4
    guess_checks: int = 200_000
    polish: int = 4
    guesses: tuple[tuple[float, float], ...] = ((1.1, 1.2), (1.1, 0.35))

    def scaled(self, share: float) -> "MotionBudget":
        """Return the budget with a share of the effort for detours."""
        path_checks, guess_checks = round(share * self.path_checks), round(share * self.guess_checks)
        return replace(self, path_checks=path_checks, guess_checks=guess_checks, polish=round(share * self.polish))


_UNINSPECTED_COST = 0.02
"""Additional cost of an uninspected edge in quick orderings of many views [s]: they prefer known edges."""

_VERY_MANY = 100
"""Views above which every ordering has a new edge: orderings then continue until one is real and good enough."""

_THOROUGH = 4  # inverse share of `orders` for an ordering of very many views after the quick ones converged

_MIN_SAVING = 0.005
"""Share of the motion below which possible savings for many views are not searched."""

DEFAULT_BUDGET = MotionBudget()


class TourSearch:
    """The loop of ordering and inspecting, with its state between rounds.

    Attributes:
        views: views that still have a configuration on the roadmap.
        unconnected: views that lost their last one.
        baseline: time of the Christofides tour with straight moves [s].
        lower_bound: no motion over all views is faster [s].
        rounds: number of orderings.
    """

    def __init__(
        self,
        roadmap: Roadmap,
        visits: Visits,
        limits: JointLimits,
        seed: int,
        budget: MotionBudget,
        ordering: Ordering,
        progress: Progress,
    ) -> None:
        self.roadmap, self.visits, self.limits = roadmap, visits, limits
        self.seed, self.budget, self.ordering, self.progress = seed, budget, ordering, progress
        self.views = [k for k in range(len(visits.configurations)) if len(roadmap.nodes_of(k))]
        self.unconnected: list[int] = []
        self.baseline, self.lower_bound = 0.0, 0.0
        self.rounds = 0
        self.best: list[int] = []
        self.best_time, self.ordered_time = float("inf"), 0.0
        self.stays = visits.stays
        self.many, self.very_many = len(self.views) > gtsp.MANY_CLUSTERS, len(self.views) > _VERY_MANY

    def run(self) -> list[int]:
        """Return the nodes of the best tour in visiting order, home at both ends; every edge of it is real."""
        initial = list(self.views)
        guesses = self.budget.guesses
        if self.many:  # low guesses cause many searches of detours: more than the checks last for
            guesses = guesses[:1]
        elif self.roadmap.q.shape[1] > ARM_AXES:  # many table angles are cheaper than a high guess: inspect them all
            guesses = guesses[-1:]
        for guess in guesses:
            has_guesses = self.roadmap.set_guess(*guess)
            if self.best and (not has_guesses or self.rounds >= self.budget.rounds):
                break
            self.settle()
        self.polish()
        visited = {self.view_of(node) for node in self.best[1:-1]}
        self.unconnected = [k for k in initial if k not in visited]
        return self.best

    def settle(self) -> None:
        """Order and inspect in turns under one guess, until no ordering gives a faster tour than the best real one."""
        last_round = self.rounds + max(1, self.budget.rounds // len(self.budget.guesses))
        last_check = self.roadmap.checks + self.budget.guess_checks * max(1, len(self.views) // gtsp.MANY_CLUSTERS)
        nodes, full = self.order(self.budget.orders, self.best), True
        min_saving = _MIN_SAVING if self.many else 1e-9
        while self.rounds < last_round and self.roadmap.checks < last_check:
            if full and self.ordered_time >= self.best_time * (1 - min_saving) and len(nodes) <= len(self.best):
                return
            nodes, known = self.inspect_around(nodes)
            if known and self.make_real(nodes):
                if not self.keep(nodes) or full:
                    return
                # Quick orderings have revealed all edges; a full one may find a faster tour over them.
                full = True
            else:  # tours with real edges only are kept, even if other edges collide
                full = self.very_many and self.keep_if_real(nodes)
                full = full and self.ordered_time >= self.best_time * (1 - min_saving)
            thorough = self.budget.orders // (_THOROUGH if self.very_many else 1)
            nodes = self.order(thorough if full else self.budget.orders // self.budget.quick, nodes)
        if self.best:
            return
        while not self.make_real(nodes):
            self.drop_unconnected()
            nodes = [node for node in nodes if node == 0 or self.usable(node)]
        self.keep(nodes)

    def inspect_around(self, nodes: list[int]) -> tuple[list[int], bool]:
        """Inspect the edges of a tour and of the next best ones in its order, until the best one is known.

        Returns:
            The best tour in this order under the current prices, and whether no inspected edge collides.
        """
        if len(nodes) < 3 or not self.budget.inspections:
            return nodes, True
        known = True
        for _ in range(self.budget.inspections):
            between = [self.roadmap.nodes_of(self.view_of(node)) for node in nodes[1:-1]]
            nodes, edges = self.through([np.array([0]), *between, np.array([0])])
            new = [e for e in self.edges(nodes) if self.roadmap.uninspected[e]]
            if not new:
                return nodes, known
            known = self.roadmap.inspect([*new, *edges]) and known
        return nodes, False

    def through(self, layers: list[Ints]) -> tuple[list[int], list[Edge]]:
        """Return the best tour through one node of each layer, and the uninspected edges of the next best tours.

        Two dynamic programmes over the layers, one from each end, give for each edge the best tour that uses it.
        """
        times, uninspected, leave = self.roadmap.times, self.roadmap.uninspected, self.roadmap.leave
        steps = [times[leave[a][:, None], b] + self.stays[b] for a, b in pairwise(layers)]
        onward = [np.zeros(1)]
        for step in reversed(steps):
            onward.append((step + onward[-1]).min(axis=1))
        onward.reverse()
        reached, nodes, at = np.zeros(1), [0], 0
        totals: list[Floats] = []
        edges: list[Ints] = []
        for step, a, b, rest in zip(steps, layers, layers[1:], onward[1:], strict=False):
            total = reached[:, None] + step + rest
            i, j = np.nonzero(uninspected[leave[a][:, None], b])
            totals.append(total[i, j])
            edges.append(np.stack((leave[a][i], b[j]), axis=1))
            at = int((step[at] + rest).argmin())
            nodes.append(int(b[at]))
            reached = (reached[:, None] + step).min(axis=0)
        count = self.budget.neighbours * (len(self.views) // gtsp.MANY_CLUSTERS if self.very_many else 1)
        best = _smallest(np.concatenate(totals), count)
        return nodes, [(int(a), int(b)) for a, b in np.concatenate(edges)[best]]

    def polish(self) -> None:
        """Search the detours of the best tour again with more effort."""
        for a, b in self.edges(self.best):
            if self.budget.polish and is_detour(self.path(a, b)):
                self.roadmap.improve(a, b, self.budget.polish)

    def keep_if_real(self, nodes: list[int]) -> bool:
        """Keep a tour if all its edges are real and it is the best so far; return whether a real tour is known."""
        if not any(self.roadmap.uninspected[e] or self.roadmap.blocked[e] for e in self.edges(nodes)):
            self.keep(nodes)
        return bool(self.best)

    def keep(self, nodes: list[int]) -> bool:
        """Keep a tour of real edges if it visits more views than the best, or as many in less time."""
        time = sum(path_time(self.path(a, b), self.limits) for a, b in self.edges(nodes))
        time += float(self.stays[nodes].sum())
        better = (-len(nodes), time) < (-len(self.best), self.best_time * (1 - 1e-9))
        if better:
            self.best, self.best_time = nodes, time
        return better

    def make_real(self, nodes: list[int]) -> bool:
        """Inspect the tour's edges; if all of them were inspected before, search paths for the blocked ones.

        Returns:
            Whether every edge of this tour is real, and had its real price when the tour was ordered.
        """
        edges = self.edges(nodes)
        if not self.roadmap.inspect(edges):
            self.report(edges)
            return False
        blocked = [e for e in edges if self.roadmap.blocked[e]]
        for a, b in blocked:
            if self.roadmap.active[a] and self.roadmap.active[b]:
                self.roadmap.search(a, b)
                self.report(edges)
        self.report(edges)
        return not blocked

    def order(self, steps: int, before: list[int]) -> list[int]:
        """Order the views under the current prices, starting with the order of an earlier tour."""
        self.drop_unconnected()
        roadmap, nodes = self.roadmap, [self.roadmap.nodes_of(k) for k in self.views]
        if self.rounds and too_many_nodes(nodes):  # not in the first round, whose bound holds for all of them
            nodes = self.best_of(nodes, before)
        flat = np.concatenate([np.zeros(1, dtype=np.int64), *nodes])
        numbers = np.full(len(roadmap.q), -1)
        numbers[flat] = np.arange(len(flat))
        times, leave = roadmap.times[np.ix_(flat, flat)], numbers[roadmap.leave[flat]]
        if self.many and steps < self.budget.orders:
            times += _UNINSPECTED_COST * roadmap.uninspected[np.ix_(flat, flat)]
        place = {view: k for k, view in enumerate(self.views)}
        known = [self.view_of(node) for node in before[1:-1]] or self.visits.known
        start = [place[view] for view in known if view in place]
        ordering = self.ordering(
            TourProblem(roadmap.q[flat], node_offsets(nodes), times, leave, self.stays[flat]),
            self.visits.T_base_scanner[self.views],
            np.random.default_rng([self.seed, self.rounds]),
            budget=steps,
            bound_effort=self.budget.bound if self.rounds == 0 else None,
            T_base_home=self.visits.T_base_home,
            start=np.array(start) if start else None,
        )
        if self.rounds == 0:  # before any inspection: times of straight moves, which no path undercuts
            self.baseline, self.lower_bound = ordering.baseline_duration, ordering.lower_bound
        self.rounds += 1
        self.ordered_time = ordering.duration
        return [0, *(int(nodes[k][i]) for k, i in zip(ordering.order, ordering.choice, strict=True)), 0]

    def best_of(self, nodes: list[Ints], tour: list[int]) -> list[Ints]:
        """Return the nodes of each view with the shortest detours from a tour; all nodes of a view not on the tour."""
        times, leave = self.roadmap.times, self.roadmap.leave
        place = {self.view_of(node): k for k, node in enumerate(tour)}
        nearest_nodes = []
        for view, view_nodes in zip(self.views, nodes, strict=True):
            if (k := place.get(view)) is not None:
                detours = (
                    times[leave[tour[k - 1]], view_nodes]
                    + self.stays[view_nodes]
                    + times[leave[view_nodes], tour[k + 1]]
                )
                view_nodes = view_nodes[best_nodes_on_tour(detours, len(nodes))]
            nearest_nodes.append(view_nodes)
        return nearest_nodes

    def drop_unconnected(self) -> None:
        """Move views that lost their last configuration to `unconnected`."""
        unconnected_views = [k for k in self.views if len(self.roadmap.nodes_of(k)) == 0]
        self.unconnected += unconnected_views
        self.views = [k for k in self.views if k not in unconnected_views]

    def usable(self, node: int) -> bool:
        """Return whether a node can still be entered and left."""
        return bool(self.roadmap.active[node] and self.roadmap.active[self.roadmap.leave[node]])

    def edges(self, nodes: list[int]) -> list[Edge]:
        """Return the driven edges of a tour, each from the departure of a view to the arrival at the next."""
        return [(int(self.roadmap.leave[a]), b) for a, b in pairwise(nodes)] if len(nodes) > 2 else []

    def view_of(self, node: int) -> int:
        """Return the view of a node."""
        return int(np.searchsorted(self.roadmap.offsets, node, side="right")) - 1

    def path(self, a: int, b: int) -> Floats:
        """Return the certified via points of a real edge."""
        path = self.roadmap.path(a, b)
        assert path is not None, "the edge is real"
        return path

    def report(self, edges: list[Edge]) -> None:
        """Report the number of real edges of the tour."""
        self.progress(sum(self.roadmap.path(a, b) is not None for a, b in edges), len(edges))


def _smallest(values: Floats, count: int) -> Ints:
    """Return the indices of the `count` smallest of (n,) values, in order; of equal ones the first."""
    if len(values) > count:
        among = np.flatnonzero(values <= np.partition(values, count - 1)[count - 1])
        return among[np.argsort(values[among], kind="stable")[:count]]
    return np.argsort(values, kind="stable")

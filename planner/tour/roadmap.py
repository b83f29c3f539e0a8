"""The edges between joint solutions: not looked at yet, straight move free, straight move blocked, real path.

The roadmap is lazy: an edge is looked at when a tour wants to use it. Its price is

    the straight move's time        until it is looked at (no path can be faster), and after the move is certified free;
    a guess above that              after the straight move was found to collide, until a detour was searched;
    the detour's real time          after one was found.

What a detour costs can hardly be told from the straight move: measured, 0.3 to 2.2 s more, for one stop more and the
way around. The guess decides what is searched: a low one finds every detour worth having and spends its work on many
that are not; a high one prefers moves that are free.

A node to which no path is found, neither from a neighbour nor from home, is *isolated* and leaves the roadmap: every
other pair can be connected at the worst through home.
"""

from collections.abc import Iterable

import numpy as np

from planner.kinematics.setpoints import to_steps
from planner.path import indexed
from planner.path.certified_edge import certify_many, quantise_inside
from planner.path.path import connect, path_time, shorten
from planner.ports import CollisionChecker, JointLimits
from planner.timing.move_time import move_time
from planner.tour.visits import Visits
from planner.values import Floats, Ints

Edge = tuple[int, int]

_LEAST_SEARCH = 1000  # checks that a search may use even when the total is spent, so that an easy detour is still found


class Roadmap:
    """Edges between the joint solutions of all views and home, priced on demand.

    Attributes:
        times: (N, N) prices of all edges [s]; they change as edges are looked at and searched.
        unseen: (N, N) edges of which nothing is known yet.
        blocked: (N, N) straight moves known, or by a turned copy expected, to collide, without a known detour.
    """

    def __init__(
        self,
        visits: Visits,
        checker: CollisionChecker,
        limits: JointLimits,
        seed: int,
        path_checks: int,
        total_checks: int,
    ) -> None:
        """Drop the nodes that are not free.

        Args:
            visits: joint solutions of views and home: the nodes.
            checker: the collision checker.
            limits: range and speeds.
            seed: seed of all searches; each edge's search depends on it and on the edge alone.
            path_checks: checks that one search may use.
            total_checks: checks after which a search gets no more than a token share.
        """
        self.checker, self.limits = checker, limits
        self.q = quantise_inside(visits.q, limits)
        self.offsets, self.leave = visits.offsets, visits.leave
        self.active = checker.free(self.q)
        self.checks = len(self.q)
        self.isolated: set[int] = set()
        self._seed, self._path_checks, self._total_checks = seed, path_checks, total_checks
        self._paths: dict[Edge, Floats] = {}
        self._failed: set[Edge] = set()
        self._clear: dict[int, bool] = {}  # nodes at which an indexed table may turn
        self._straight = move_time(self.q[:, None], self.q, limits)
        self.times = self._straight.copy()
        self.blocked = np.zeros(self.times.shape, dtype=bool)
        self.uninspected = np.ones(self.times.shape, dtype=bool)
        self._guess_factor, self._guess_more = 1.0, 0.0
        # Nodes that differ by whole turns hold the arm in the same place: a straight move between two of them that
        # collides does so for every pair with the same difference.
        self._steps = to_steps(self.q)
        self._pose = np.unique(self._steps % 3_600_000, axis=0, return_inverse=True)[1].reshape(-1)

    def nodes_of(self, view: int) -> Ints:
        """Active nodes of a view that can be left again."""
        nodes = np.arange(self.offsets[view], self.offsets[view + 1])
        return nodes[self.active[nodes] & self.active[self.leave[nodes]]]

    def guess_by(self, factor: float, more: float) -> bool:
        """Price colliding moves at `factor` times the straight move's time and `more` [s], until they are searched.

        Returns:
            Whether any move is priced so now.
        """
        self._guess_factor, self._guess_more = factor, more
        self.times[self.blocked] = self._straight[self.blocked] * factor + more
        return bool(self.blocked.any())

    def path(self, a: int, b: int) -> Floats | None:
        """(m, axes) certified via points from node a to node b [rad]; None where the edge is not real yet."""
        found = self._paths.get((min(a, b), max(a, b)))
        return found if found is None or a <= b else found[::-1]

    def look(self, edges: Iterable[Edge]) -> bool:
        """Certify the straight moves of edges that nobody looked at; whether all of them are free."""
        new = sorted(e for e in {(min(e), max(e)) for e in edges} if self.uninspected[e])
        if not new:
            return True
        ways = [self._way(a, b) for a, b in new]
        moves = [way for way in ways if way is not None]
        starts, stops = (np.concatenate([way[part] for way in moves]) if moves else self.q[:0]
                         for part in (slice(None, -1), slice(1, None)))  # fmt: skip
        certified, used = certify_many(starts, stops, self.checker)
        self.checks += used
        whole, at = True, 0
        for (a, b), way in zip(new, ways, strict=True):
            count = 0 if way is None else len(way) - 1
            if way is not None and certified[at : at + count].all():
                self._know(a, b, way)
            else:
                self._guess(a, b)
                whole = False
            at += count
        return whole

    def _way(self, a: int, b: int) -> Floats | None:
        """Via points (m, axes) of straight moves between two nodes [rad]; None where a table cannot turn at either."""
        if self.limits.table_turn_q is None:
            return self.q[[a, b]]
        ends = []
        for node in (a, b):
            if node not in self._clear:
                self._clear[node], used = indexed.may_turn(self.q[node], self.checker, self.limits)
                self.checks += used
            ends.append(self._clear[node])
        return indexed.straight_path(self.q[a], self.q[b], *ends)

    def search(self, a: int, b: int) -> bool:
        """Find a real path for an edge, through home if need be, and isolate a node that has none.

        Returns:
            Whether a path is known now.
        """
        a, b = min(a, b), max(a, b)
        if self._direct(a, b):
            return True
        if a == 0:
            self._isolate(b)
            return False
        legs = []
        for node in (a, b):
            if self._direct(0, node):
                legs.append(self._paths[0, node])
            else:
                self._isolate(node)
        if len(legs) < 2:
            return False
        joined = np.concatenate((legs[0][::-1], legs[1][1:]))
        via, used = shorten(joined, self.checker, self.limits, self._rng(a, b), self._path_checks // 2)
        self.checks += used
        self._know(a, b, via)
        return True

    def improve(self, a: int, b: int, tries: int) -> bool:
        """Shorten the detour of an edge further and search it from other seeds, in turns; whether it became faster."""
        a, b = min(a, b), max(a, b)
        best = self._paths[a, b]
        before = time = path_time(best, self.limits)
        for attempt in range(tries):
            rng = np.random.default_rng([self._seed, a, b, 1 + attempt])
            if attempt % 2:
                found = connect(self.q[a], self.q[b], self.checker, self.limits, rng, self._path_checks)
                via, used = found.via, found.checks
            else:
                via, used = shorten(best, self.checker, self.limits, rng, self._path_checks // 2)
            self.checks += used
            if via is not None and path_time(via, self.limits) < time:
                best, time = via, path_time(via, self.limits)
        if time < before:
            self._know(a, b, best)
        return time < before

    def _direct(self, a: int, b: int) -> bool:
        """Whether a path that does not need home is known or found; each edge is searched once."""
        if (a, b) in self._paths:
            return True
        if (a, b) in self._failed:
            return False
        budget = self._path_checks
        if any(self._pose[node] == self._pose[other] for node in (a, b) if node for other in self.isolated):
            budget //= 4  # the same place, some turns apart, could not be reached
        budget = max(min(budget, self._total_checks - self.checks), _LEAST_SEARCH)
        found = connect(self.q[a], self.q[b], self.checker, self.limits, self._rng(a, b), budget)
        self.checks += found.checks
        if found.via is None:
            self._failed.add((a, b))
            return False
        self._know(a, b, found.via)
        return True

    def _know(self, a: int, b: int, via: Floats) -> None:
        self._paths[a, b] = via
        self.blocked[a, b] = self.blocked[b, a] = self.uninspected[a, b] = self.uninspected[b, a] = False
        time = path_time(via, self.limits) if len(via) > 2 else float(self._straight[a, b])
        self.times[a, b] = self.times[b, a] = time

    def _guess(self, a: int, b: int) -> None:
        """Price a colliding straight move, and its copies some turns away, by the guess."""
        turned_a = np.flatnonzero(self._pose == self._pose[a])
        turned_b = np.flatnonzero(self._pose == self._pose[b])
        same = (self._steps[turned_b][None] - self._steps[turned_a][:, None] == self._steps[b] - self._steps[a]).all(
            axis=2
        )
        for i, j in np.argwhere(same):
            one, other = int(turned_a[i]), int(turned_b[j])
            if (min(one, other), max(one, other)) not in self._paths:
                time = float(self._straight[one, other]) * self._guess_factor + self._guess_more
                self.blocked[one, other] = self.blocked[other, one] = True
                self.uninspected[one, other] = self.uninspected[other, one] = False
                self.times[one, other] = self.times[other, one] = time

    def _isolate(self, node: int) -> None:
        self.active[node] = False
        self.isolated.add(node)

    def _rng(self, a: int, b: int) -> np.random.Generator:
        return np.random.default_rng([self._seed, a, b])

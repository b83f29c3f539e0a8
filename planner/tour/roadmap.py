"""Lazy roadmap: edges between configurations, inspected only when a tour uses them.

The price of an edge is

    the straight move's time        until it is inspected (no path is faster), and if the move is certified free;
    a guess above that              if the straight move collides, until a detour is searched;
    the detour's real time          after one is found.

The time of a detour can hardly be predicted from the straight move: it took 0.3 to 2.2 s more, for one more stop and
the way around. The guess decides what is searched: a low one finds every useful detour and spends its effort on many
useless ones; a high one prefers free moves.

A node to which no path is found, neither from a neighbour nor from home, is *isolated* and leaves the roadmap: every
other pair can be connected through home at worst.
"""

from collections.abc import Iterable

import numpy as np

from planner.kinematics.setpoints import TURN, to_steps
from planner.path import indexed
from planner.path.certified_edge import certify_many, quantise_inside
from planner.path.path import connect, path_time, shorten
from planner.ports import CollisionChecker, JointLimits
from planner.timing.move_time import move_time
from planner.tour.visits import Visits
from planner.values import Floats, Ints

Edge = tuple[int, int]

_MIN_SEARCH = 1000  # checks of a search after the total is spent, so that an easy detour is still found


class Roadmap:
    """Edges between the configurations of all views and home, priced on demand.

    Attributes:
        times: (N, N) prices of all edges [s]; they change as edges are inspected and searched.
        uninspected: (N, N) edges that are not checked yet.
        blocked: (N, N) straight moves that collide, or are expected to by a turned copy, without a known detour.
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
        """Create the roadmap without the nodes that are not free.

        Args:
            visits: configurations of views and home: the nodes.
            checker: collision checker.
            limits: range and speeds.
            seed: seed of all searches; each edge's search depends on it and on the edge alone.
            path_checks: checks of one search.
            total_checks: checks after which a search gets a small share only.
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
        self._may_turn: dict[int, bool] = {}  # nodes at which an indexed table may turn
        self._straight = move_time(self.q[:, None], self.q, limits)
        self.times = self._straight.copy()
        self.blocked = np.zeros(self.times.shape, dtype=bool)
        self.uninspected = np.ones(self.times.shape, dtype=bool)
        self._guess_factor, self._guess_offset = 1.0, 0.0
        # Nodes that differ by full turns have the same geometry: if a straight move between two of them collides, it
        # does for every pair with the same difference.
        self._steps = to_steps(self.q)
        self._geometry = np.unique(self._steps % TURN, axis=0, return_inverse=True)[1].reshape(-1)

    def nodes_of(self, view: int) -> Ints:
        """Return the active nodes of a view that can be left again."""
        nodes = np.arange(self.offsets[view], self.offsets[view + 1])
        return nodes[self.active[nodes] & self.active[self.leave[nodes]]]

    def set_guess(self, factor: float, offset: float) -> bool:
        """Price unsearched colliding moves at `factor` x the straight move's time + `offset` [s]; return if any is."""
        self._guess_factor, self._guess_offset = factor, offset
        self.times[self.blocked] = self._straight[self.blocked] * factor + offset
        return bool(self.blocked.any())

    def path(self, a: int, b: int) -> Floats | None:
        """Return (m, axes) certified via points from node a to node b [rad], or None if the edge is not real yet."""
        path = self._paths.get((min(a, b), max(a, b)))
        return path if path is None or a <= b else path[::-1]

    def inspect(self, edges: Iterable[Edge]) -> bool:
        """Certify the straight moves of uninspected edges; return whether all of them are free."""
        new = sorted(e for e in {(min(e), max(e)) for e in edges} if self.uninspected[e])
        if not new:
            return True
        paths = [self._straight_path(a, b) for a, b in new]
        moves = [path for path in paths if path is not None]
        starts = np.concatenate([path[:-1] for path in moves]) if moves else self.q[:0]
        stops = np.concatenate([path[1:] for path in moves]) if moves else self.q[:0]
        certified, used = certify_many(starts, stops, self.checker)
        self.checks += used
        all_free, at = True, 0
        for (a, b), path in zip(new, paths, strict=True):
            count = 0 if path is None else len(path) - 1
            if path is not None and certified[at : at + count].all():
                self._set_path(a, b, path)
            else:
                self._guess(a, b)
                all_free = False
            at += count
        return all_free

    def _straight_path(self, a: int, b: int) -> Floats | None:
        """Return (m, axes) straight moves between two nodes [rad], or None if an indexed table can turn at neither."""
        if self.limits.table_turn_q is None:
            return self.q[[a, b]]
        for node in (a, b):
            if node not in self._may_turn:
                self._may_turn[node], used = indexed.may_turn(self.q[node], self.checker, self.limits)
                self.checks += used
        return indexed.straight_path(self.q[a], self.q[b], self._may_turn[a], self._may_turn[b])

    def search(self, a: int, b: int) -> bool:
        """Find a real path for an edge, through home if necessary; isolate a node that has none.

        Returns:
            Whether a path is known now.
        """
        a, b = min(a, b), max(a, b)
        if self._search_direct(a, b):
            return True
        if a == 0:
            self._isolate(b)
            return False
        from_home = []
        for node in (a, b):
            if self._search_direct(0, node):
                from_home.append(self._paths[0, node])
            else:
                self._isolate(node)
        if len(from_home) < 2:
            return False
        joined = np.concatenate((from_home[0][::-1], from_home[1][1:]))
        via, used = shorten(joined, self.checker, self.limits, self._rng(a, b), self._path_checks // 2)
        self.checks += used
        self._set_path(a, b, via)
        return True

    def improve(self, a: int, b: int, tries: int) -> bool:
        """Shorten the detour of an edge and search it with other seeds in turns; return whether it is faster."""
        a, b = min(a, b), max(a, b)
        best = self._paths[a, b]
        before = time = path_time(best, self.limits)
        for attempt in range(tries):
            rng = np.random.default_rng([self._seed, a, b, 1 + attempt])
            if attempt % 2:
                result = connect(self.q[a], self.q[b], self.checker, self.limits, rng, self._path_checks)
                via, used = result.via, result.checks
            else:
                via, used = shorten(best, self.checker, self.limits, rng, self._path_checks // 2)
            self.checks += used
            if via is not None and path_time(via, self.limits) < time:
                best, time = via, path_time(via, self.limits)
        if time < before:
            self._set_path(a, b, best)
        return time < before

    def _search_direct(self, a: int, b: int) -> bool:
        """Return whether a path without home is known or found; each edge is searched once."""
        if (a, b) in self._paths:
            return True
        if (a, b) in self._failed:
            return False
        budget = self._path_checks
        if any(self._geometry[node] == self._geometry[other] for node in (a, b) if node for other in self.isolated):
            budget //= 4  # the same geometry, some turns apart, could not be reached
        budget = max(min(budget, self._total_checks - self.checks), _MIN_SEARCH)
        result = connect(self.q[a], self.q[b], self.checker, self.limits, self._rng(a, b), budget)
        self.checks += result.checks
        if result.via is None:
            self._failed.add((a, b))
            return False
        self._set_path(a, b, result.via)
        return True

    def _set_path(self, a: int, b: int, via: Floats) -> None:
        self._paths[a, b] = via
        time = path_time(via, self.limits) if len(via) > 2 else float(self._straight[a, b])
        self._set_edge(a, b, time, blocked=False)

    def _set_edge(self, a: int, b: int, time: float, *, blocked: bool) -> None:
        self.blocked[a, b] = self.blocked[b, a] = blocked
        self.uninspected[a, b] = self.uninspected[b, a] = False
        self.times[a, b] = self.times[b, a] = time

    def _guess(self, a: int, b: int) -> None:
        """Price a colliding straight move, and its copies some turns away, by the guess."""
        turned_a = np.flatnonzero(self._geometry == self._geometry[a])
        turned_b = np.flatnonzero(self._geometry == self._geometry[b])
        same = (self._steps[turned_b][None] - self._steps[turned_a][:, None] == self._steps[b] - self._steps[a]).all(
            axis=2
        )
        for i, j in np.argwhere(same):
            one, other = int(turned_a[i]), int(turned_b[j])
            if (min(one, other), max(one, other)) not in self._paths:
                time = float(self._straight[one, other]) * self._guess_factor + self._guess_offset
                self._set_edge(one, other, time, blocked=True)

    def _isolate(self, node: int) -> None:
        self.active[node] = False
        self.isolated.add(node)

    def _rng(self, a: int, b: int) -> np.random.Generator:
        return np.random.default_rng([self._seed, a, b])

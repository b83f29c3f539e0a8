"""The whole motion over a set of views: order, joint solutions and certified paths, from home and back.

The order is found with cheap times, the edges of its tour are looked at, and what turns out to collide is priced
anew, until every edge of the tour is real (the lazy evaluation of sampling-based planning, Bohlin and Kavraki 2000,
doi:10.1109/ROBOT.2000.844107, on a travelling salesman). As no path is faster than the straight move, a tour that is
optimal under these prices and whose edges are all real is optimal over the real times as well, as far as the guessed
prices of colliding moves are not too high.

A view to which no path is found from any of its joint solutions is dropped and said; the caller may then cover the part
anew without it.
"""

from collections.abc import Callable
from collections.abc import Sequence as Many
from dataclasses import dataclass
from enum import IntEnum
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from planner import order as ordering_of_views
from planner.edge import clearance_along
from planner.errors import PlannerError
from planner.path import CHECKS, path_time
from planner.ports import CollisionChecker, Floats, JointLimits
from planner.readonly import readonly
from planner.roadmap import Edge, Roadmap
from planner.timing import check_inside, check_limits

Progress = Callable[[int, int], None]
"""Called with the number of real edges and the number of edges of the tour under work."""


class TourStatus(IntEnum):
    """What became of the views."""

    COMPLETE = 0
    VIEWS_DROPPED = 1
    HOME_IN_COLLISION = 2

    @property
    def sentence(self) -> str:
        """The status in words, for reports."""
        return _TOUR_SENTENCES[self]


_TOUR_SENTENCES = {
    TourStatus.COMPLETE: "every view is visited",
    TourStatus.VIEWS_DROPPED: "some views cannot be visited; the tour over the others is complete",
    TourStatus.HOME_IN_COLLISION: "home is nearer to something than the clearance; there is no motion",
}


class DropReason(IntEnum):
    """Why a view is not visited."""

    NO_SOLUTION = 0
    IN_COLLISION = 1
    NO_PATH = 2
    NO_HOME = 3

    @property
    def sentence(self) -> str:
        """The reason in words, for reports."""
        return _DROP_SENTENCES[self]


_DROP_SENTENCES = {
    DropReason.NO_SOLUTION: "the view has no joint solution",
    DropReason.IN_COLLISION: "every joint solution of the view is nearer to something than the clearance",
    DropReason.NO_PATH: "no free path to any joint solution of the view was found within the budget",
    DropReason.NO_HOME: "home itself is in collision",
}


@dataclass(frozen=True, slots=True)
class Dropped:
    """A view that is not visited.

    Attributes:
        view: index into the configurations.
        reason: why.
        blocker: what its first joint solution is nearest to ("housing with part"), where it collides; else "".
    """

    view: int
    reason: DropReason
    blocker: str


@dataclass(frozen=True, slots=True)
class MotionBudget:
    """Work that planning a motion may use; no clock is read, so equal input gives an equal motion.

    Attributes:
        orders: orders that one full ordering may evaluate (`planner.order.sequence`).
        path_checks: configurations that the search of one detour may check.
        checks: configurations after which detours get only a token search.
        rounds: orderings at most; after them the edges of the last tour are made real without ordering again.
    """

    orders: int = ordering_of_views.EVALUATIONS
    path_checks: int = CHECKS
    checks: int = 1_000_000
    rounds: int = 60


@dataclass(frozen=True, slots=True, eq=False)
class Tour:
    """A certified motion over the views; leg k leads to view `order[k]`, the last leg home.

    Attributes:
        order: (n,) visited views, as indices into the configurations.
        choice: (n,) joint solution of each visited view, as an index into that view's configurations.
        q: (n, 6) joint angles at the views, in visiting order [rad], multiples of 1e-4 deg.
        via: (N, 6) via points from home to home [rad]; one row (home) without views, none where home is in collision.
        segment: (N,) leg that ends at or passes the via point; 0 for the first.
        view: (N,) view taken at the via point, -1 at home and on detours.
        clearance: (n + 1,) smallest distance found along each leg [m] (`planner.edge.clearance_along`).
        between: n + 1 names of the pair that is nearest on each leg.
        detour: (n + 1,) True where the leg is no straight move.
        duration: time of all moves [s], stopping at each via point.
        baseline_duration: time of the Christofides tour with straight moves [s], collisions not looked at.
        lower_bound: no motion over the visited views and more, through these joint solutions, is faster [s].
        dropped: views that are not visited, with reasons.
        status: what became of the views.
        home_blocker: what home is nearest to, where it collides; else "".
        checks: configurations checked.
        rounds: orderings computed.
    """

    order: NDArray[np.int64]
    choice: NDArray[np.int64]
    q: Floats
    via: Floats
    segment: NDArray[np.int64]
    view: NDArray[np.int64]
    clearance: Floats
    between: tuple[str, ...]
    detour: NDArray[np.bool_]
    duration: float
    baseline_duration: float
    lower_bound: float
    dropped: tuple[Dropped, ...]
    status: TourStatus
    home_blocker: str
    checks: int
    rounds: int

    def __post_init__(self) -> None:
        object.__setattr__(self, "order", readonly("order", self.order, (None,), np.int64))
        n = len(self.order)
        object.__setattr__(self, "choice", readonly("choice", self.choice, (n,), np.int64))
        object.__setattr__(self, "q", readonly("q", self.q, (n, 6)))
        object.__setattr__(self, "via", readonly("via", self.via, (None, 6)))
        object.__setattr__(self, "segment", readonly("segment", self.segment, (len(self.via),), np.int64))
        object.__setattr__(self, "view", readonly("view", self.view, (len(self.via),), np.int64))
        object.__setattr__(self, "clearance", readonly("clearance", self.clearance, (len(self.between),)))
        object.__setattr__(self, "detour", readonly("detour", self.detour, (len(self.between),), np.bool_))


def plan_motion(
    configurations: Many[Floats],
    home: Floats,
    checker: CollisionChecker,
    limits: JointLimits,
    T_base_scanner: Floats,
    rng: np.random.Generator,
    budget: MotionBudget = MotionBudget(),
    progress: Progress | None = None,
    *,
    ordering: str = "joint-space",
    T_base_home: Floats | None = None,
) -> Tour:
    """Plan the motion that visits every view once, from home and back.

    Args:
        configurations: per view, (n_i, 6) joint solutions [rad], multiples of 1e-4 deg; those not free are left out.
        home: (6,) joint angles at which the motion begins and ends [rad].
        checker: the collision checker; its clearance must be above 0.
        limits: limits of the axes; scale them (`planner.timing.scaled`) to order for a reduced speed.
        T_base_scanner: (n, 4, 4) scanner pose of each view [m], base frame; starts the ordering.
        rng: source of all randomness.
        budget: work that may be used.
        progress: told about real edges as they become known.
        ordering: a name of `planner.order.ORDERINGS`.
        T_base_home: (4, 4) scanner pose at home [m].

    Returns:
        The motion with the views that it cannot visit. It is certified: see `planner.edge`.

    Raises:
        PlannerError: if the ordering is unknown, home or a joint solution outside the joint range, a limit unusable,
            or the checker keeps no clearance.
    """
    if ordering not in ordering_of_views.ORDERINGS:
        raise PlannerError(
            f"there is no ordering {ordering!r}; it must be one of {', '.join(ordering_of_views.ORDERINGS)}"
        )
    check_limits(limits)
    home = readonly("home", home, (6,))
    check_inside("home: number", home[None], limits)
    solutions = [readonly(f"configurations of view {k}", q, (None, 6)) for k, q in enumerate(configurations)]
    for k, q in enumerate(solutions):
        check_inside(f"joint solution of view {k}: number", q, limits)
    poses = readonly("T_base_scanner", T_base_scanner, (len(solutions), 4, 4))
    if not checker.clearance > 0:
        raise PlannerError(f"the checker's clearance is {checker.clearance} m; it must be above 0 to certify a motion")
    seed = int(rng.integers(2**63))
    roadmap = Roadmap(solutions, home, checker, limits, seed, budget.path_checks, budget.checks)
    if not roadmap.active[0]:
        return _no_motion(roadmap, len(solutions))

    dropped = []
    for k, q in enumerate(solutions):
        if len(q) == 0:
            dropped.append(Dropped(k, DropReason.NO_SOLUTION, ""))
        elif len(roadmap.nodes_of(k)) == 0:
            blocker = next(iter(checker.contacts(q[0])), "")
            dropped.append(Dropped(k, DropReason.IN_COLLISION, blocker))

    planner = _Planner(roadmap, poses, T_base_home, limits, seed, budget, ordering, progress)
    planner.views = [k for k in range(len(solutions)) if len(roadmap.nodes_of(k))]
    nodes = planner.run()
    dropped += [Dropped(k, DropReason.NO_PATH, "") for k in planner.unconnected]
    return _tour(roadmap, nodes, planner, tuple(sorted(dropped, key=lambda d: d.view)))


class _Planner:
    """The loop of ordering and looking; holds what changes between rounds."""

    def __init__(
        self,
        roadmap: Roadmap,
        poses: Floats,
        T_base_home: Floats | None,
        limits: JointLimits,
        seed: int,
        budget: MotionBudget,
        ordering: str,
        progress: Progress | None,
    ) -> None:
        self.roadmap, self.poses, self.T_base_home, self.limits = roadmap, poses, T_base_home, limits
        self.seed, self.budget, self.progress = seed, budget, progress
        self.ordering = ordering_of_views.ORDERINGS[ordering]
        self.views: list[int] = []
        self.unconnected: list[int] = []
        self.baseline, self.lower_bound = 0.0, 0.0
        self.rounds = 0

    def run(self) -> list[int]:
        """Nodes of the tour in visiting order, home at both ends; every edge of it is real."""
        nodes, full, settled_cost = self.order(self.budget.orders, []), True, float("inf")
        while self.rounds < self.budget.rounds:
            if self.make_real(nodes):
                cost = sum(path_time(self.path(a, b), self.limits) for a, b in _edges(nodes))
                if full or cost >= settled_cost * (1 - 1e-9):
                    return nodes
                # Quick orderings brought all edges to light; a full one may find a faster tour over them.
                settled_cost, full = cost, True
                nodes = self.order(self.budget.orders, nodes)
            else:
                full = False
                nodes = self.order(self.budget.orders // 10, nodes)
        while not self.make_real(nodes):
            self.drop_unconnected()
            nodes = [node for node in nodes if node == 0 or self.roadmap.active[node]]
        kept = {self.view_of(node) for node in nodes[1:-1]}
        self.unconnected += [k for k in self.views if k not in kept]
        return nodes

    def make_real(self, nodes: list[int]) -> bool:
        """Look at the tour's edges; where all straight moves were looked at before, search the blocked ones.

        Returns:
            Whether every edge of this tour is real now, and was priced so when the tour was ordered.
        """
        edges = _edges(nodes)
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

    def order(self, evaluations: int, before: list[int]) -> list[int]:
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
            budget=evaluations,
            edge_time=edge_time,
            start=np.array(start) if len(start) == len(self.views) and start else None,
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


def _edges(nodes: list[int]) -> list[Edge]:
    """Edges of a tour; none where it has no view."""
    return list(pairwise(nodes)) if len(nodes) > 2 else []


def _tour(roadmap: Roadmap, nodes: list[int], planner: _Planner, dropped: tuple[Dropped, ...]) -> Tour:
    """Put the legs together and measure their clearance."""
    views = [planner.view_of(node) for node in nodes[1:-1]]
    via, segment, view = [roadmap.q[:1]], [0], [-1]
    clearance, between, detour, duration = [], [], [], 0.0
    for leg, (a, b) in enumerate(_edges(nodes)):
        path = planner.path(a, b)
        via.append(path[1:])
        segment += [leg] * (len(path) - 1)
        view += [-1] * (len(path) - 2) + [views[leg] if leg < len(views) else -1]
        nearest, pair = clearance_along(path, roadmap.checker)
        clearance.append(nearest)
        between.append(pair)
        detour.append(len(path) > 2)
        duration += path_time(path, planner.limits)
    visited = np.array(nodes[1:-1], dtype=np.int64)
    return Tour(
        order=np.array(views, dtype=np.int64),
        choice=visited - roadmap.offsets[views] if views else visited,
        q=roadmap.q[visited],
        via=np.concatenate(via),
        segment=np.array(segment),
        view=np.array(view),
        clearance=np.array(clearance),
        between=tuple(between),
        detour=np.array(detour, dtype=bool),
        duration=duration,
        baseline_duration=planner.baseline,
        lower_bound=planner.lower_bound,
        dropped=dropped,
        status=TourStatus.VIEWS_DROPPED if dropped else TourStatus.COMPLETE,
        home_blocker="",
        checks=roadmap.checks,
        rounds=planner.rounds,
    )


def _no_motion(roadmap: Roadmap, n_views: int) -> Tour:
    """The result where home collides."""
    none = np.zeros(0, dtype=np.int64)
    return Tour(
        order=none,
        choice=none,
        q=np.zeros((0, 6)),
        via=np.zeros((0, 6)),
        segment=none,
        view=none,
        clearance=np.zeros(0),
        between=(),
        detour=np.zeros(0, dtype=bool),
        duration=0.0,
        baseline_duration=0.0,
        lower_bound=0.0,
        dropped=tuple(Dropped(k, DropReason.NO_HOME, "") for k in range(n_views)),
        status=TourStatus.HOME_IN_COLLISION,
        home_blocker=next(iter(roadmap.checker.contacts(roadmap.q[0])), ""),
        checks=roadmap.checks,
        rounds=0,
    )

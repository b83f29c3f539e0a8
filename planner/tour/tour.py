"""The whole motion over a set of views: order, joint solutions and certified paths, from home and back.

The search itself is `planner.tour.tour_search`; this file checks its input and puts the legs together.

A view to which no path is found from any of its joint solutions is dropped and said; the caller may then cover the part
anew without it.
"""

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from planner.errors import PlannerError
from planner.path.path import is_detour, path_time
from planner.path.sweeps import SweepTraversal
from planner.ports import CollisionChecker, JointLimits, Progress
from planner.timing.limits import require_inside, require_usable
from planner.tour.orderings import Ordering, order_views
from planner.tour.roadmap import Roadmap
from planner.tour.tour_search import DEFAULT_BUDGET, MotionBudget, TourSearch
from planner.tour.visits import Visits
from planner.values import Bools, Floats, Ints, Value
from planner.worded import Worded


class TourStatus(Worded):
    """What became of the views."""

    COMPLETE = 0, "every view is visited"
    VIEWS_DROPPED = 1, "some views cannot be visited; the tour over the others is complete"
    HOME_IN_COLLISION = 2, "home is nearer to something than the clearance; there is no motion"


class DropReason(Worded):
    """Why a view is not visited."""

    NO_SOLUTION = 0, "the view has no joint solution"
    IN_COLLISION = 1, "every joint solution of the view is nearer to something than the clearance"
    NO_PATH = 2, "no free path to any joint solution of the view was found within the budget"
    NO_HOME = 3, "home itself is in collision"


@dataclass(frozen=True, slots=True)
class DroppedView:
    """A view that is not visited.

    Attributes:
        view: index into the configurations.
        reason: why.
        blocker: what its first joint solution is nearest to ("housing with part"), where it collides; else "".
    """

    view: int
    reason: DropReason
    blocker: str


@dataclass(frozen=True, slots=True, eq=False)
class Tour(Value):
    """A certified motion over the views; leg k leads to view `order[k]`, the last leg home.

    Attributes:
        order: (n,) visited views, as indices into the configurations.
        choice: (n,) joint solution of each visited view, as an index into that view's configurations.
        q: (n, axes) joint angles at the views, in visiting order [rad], multiples of 1e-4 deg; of a sweep at its middle
            pose.
        via: (N, axes) via points from home to home [rad]; one row (home) without views, none where home
            is in collision.
        segment: (N,) leg that ends at or passes the via point; 0 for the first.
        view: (N,) view taken at the via point, -1 at home, on detours and between the poses of a sweep.
        pose: (N,) pose of the view taken at the via point, 0 of a view at rest, -1 where none is.
        entered: (n,) via point at which each visited view is entered: where its passage begins.
        detour: (n + 1,) True where the leg takes the arm more than one straight move.
        duration: time of all moves, stopping at each via point, and of the passages [s].
        baseline_duration: time of the Christofides tour with straight moves [s], collisions not looked at.
        lower_bound: no motion over the visited views and more, through these joint solutions, is faster [s].
        dropped: views that are not visited, with reasons.
        status: what became of the views.
        home_blocker: what home is nearest to, where it collides; else "".
        rounds: orderings computed.
    """

    order: Annotated[Ints, "n"]
    choice: Annotated[Ints, "n"]
    q: Annotated[Floats, "n axes"]
    via: Annotated[Floats, "N axes"]
    segment: Annotated[Ints, "N"]
    view: Annotated[Ints, "N"]
    pose: Annotated[Ints, "N"]
    entered: Annotated[Ints, "n"]
    detour: Annotated[Bools, "legs"]
    duration: float
    baseline_duration: float
    lower_bound: float
    dropped: tuple[DroppedView, ...]
    status: TourStatus
    home_blocker: str
    rounds: int


def plan_tour(
    visits: Visits,
    checker: CollisionChecker,
    limits: JointLimits,
    rng: np.random.Generator,
    budget: MotionBudget = DEFAULT_BUDGET,
    progress: Progress | None = None,
    *,
    ordering: Ordering = order_views,
) -> Tour:
    """Plan the motion that visits every view once, from home and back.

    Args:
        visits: the views and home; joint solutions that are not free are left out.
        checker: the collision checker; its clearance must be above 0.
        limits: limits of the axes; scale them (`planner.timing.limits.scale_limits`) to order for a reduced speed.
        rng: source of all randomness.
        budget: work that may be used.
        progress: told about real edges as they become known.
        ordering: how the views are ordered.

    Returns:
        The motion with the views that it cannot visit. It is certified: see `planner.path.certified_edge`.

    Raises:
        PlannerError: if home or a joint solution is outside the joint range, a limit unusable, or the checker keeps no
            clearance.
    """
    require_usable(limits)
    require_inside("home: number", visits.home[None], limits)
    for k, q in enumerate(visits.configurations):
        require_inside(f"joint solution of view {k}: number", q, limits)
    if not checker.clearance > 0:
        raise PlannerError(f"the checker's clearance is {checker.clearance} m; it must be above 0 to certify a motion")
    seed = int(rng.integers(2**63))
    roadmap = Roadmap(visits, checker, limits, seed, budget.path_checks, budget.checks)
    search = TourSearch(roadmap, visits, limits, seed, budget, ordering, progress)
    if not roadmap.active[0]:
        everything = tuple(DroppedView(k, DropReason.NO_HOME, "") for k in range(len(visits.configurations)))
        none = np.zeros(0, dtype=np.int64)
        return replace(
            _tour(roadmap, [], search, everything),
            via=np.zeros((0, roadmap.q.shape[1])),
            segment=none,
            view=none,
            pose=none,
            status=TourStatus.HOME_IN_COLLISION,
            home_blocker=next(iter(checker.contacts(roadmap.q[0])), ""),
        )

    dropped = []
    for k, q in enumerate(visits.configurations):
        if len(q) == 0:
            dropped.append(DroppedView(k, DropReason.NO_SOLUTION, ""))
        elif len(roadmap.nodes_of(k)) == 0:
            blocker = next(iter(checker.contacts(q[0])), "")
            dropped.append(DroppedView(k, DropReason.IN_COLLISION, blocker))

    nodes = search.run()
    dropped += [DroppedView(k, DropReason.NO_PATH, "") for k in search.unconnected]
    return _tour(roadmap, nodes, search, tuple(sorted(dropped, key=lambda d: d.view)))


def _tour(roadmap: Roadmap, nodes: list[int], search: TourSearch, dropped: tuple[DroppedView, ...]) -> Tour:
    """Put the legs together."""
    passages = search.visits.traversals
    views = [search.view_of(node) for node in nodes[1:-1]]
    stands = [
        SweepTraversal(roadmap.q[[node]], np.zeros(1, dtype=np.int64), 0.0, 0)
        if passages is None
        else passages[view][node - int(roadmap.offsets[view])]
        for view, node in zip(views, nodes[1:-1], strict=True)
    ]
    via, segment, view, pose, entered = [roadmap.q[:1]], [0], [-1], [-1], []
    detour, duration = [], 0.0
    for leg, (a, b) in enumerate(search.edges(nodes)):
        path = search.path(a, b)
        duration += path_time(path, search.limits)
        via.append(path[1:])
        view += [-1] * (len(path) - 1)
        pose += [-1] * (len(path) - 1)
        if leg < len(views):
            here = stands[leg]
            entered.append(len(view) - 1)
            via.append(here.via[1:])
            view[-1:] = np.where(here.pose >= 0, views[leg], -1).tolist()
            pose[-1:] = here.pose.tolist()
            duration += here.duration
        segment += [leg] * (len(view) - len(segment))
        detour.append(is_detour(path))
    visited = np.array(nodes[1:-1], dtype=np.int64)
    return Tour(
        order=np.array(views, dtype=np.int64),
        choice=visited - roadmap.offsets[views] if views else visited,
        q=np.array([here.middle for here in stands]).reshape(-1, roadmap.q.shape[1]),
        via=np.concatenate(via),
        segment=np.array(segment),
        view=np.array(view),
        pose=np.array(pose),
        entered=np.array(entered, dtype=np.int64),
        detour=np.array(detour, dtype=bool),
        duration=duration,
        baseline_duration=search.baseline,
        lower_bound=search.lower_bound,
        dropped=dropped,
        status=TourStatus.VIEWS_DROPPED if dropped else TourStatus.COMPLETE,
        home_blocker="",
        rounds=search.rounds,
    )

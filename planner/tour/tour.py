"""Plan the complete motion over a set of views: order, configurations and certified paths, from home and back.

`planner.tour.tour_search` does the search; this module checks its input and joins the paths.

A view to which no path is found from any of its configurations is dropped and reported; the caller may then cover the
part again without it.
"""

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from planner.errors import PlannerError
from planner.path.path import is_detour, path_time
from planner.path.sweeps import SweepTraversal
from planner.ports import CollisionChecker, JointLimits, Progress, no_progress
from planner.timing.limits import require_inside, require_usable
from planner.tour.orderings import Ordering, order_views
from planner.tour.roadmap import Roadmap
from planner.tour.tour_search import DEFAULT_BUDGET, MotionBudget, TourSearch
from planner.tour.visits import Visits
from planner.values import Bools, DescribedEnum, Floats, Ints, Value


class TourStatus(DescribedEnum):
    """Result for all views."""

    COMPLETE = 0, "every view is visited"
    VIEWS_DROPPED = 1, "some views cannot be visited; the tour over the others is complete"
    HOME_IN_COLLISION = 2, "home is nearer to an object than the clearance; there is no motion"


class DropReason(DescribedEnum):
    """Reason why a view is not visited."""

    NO_SOLUTION = 0, "the view has no configuration"
    IN_COLLISION = 1, "every configuration of the view is nearer to an object than the clearance"
    NO_PATH = 2, "no free path to any configuration of the view was found within the budget"
    NO_HOME = 3, "home itself is in collision"


@dataclass(frozen=True, slots=True)
class DroppedView:
    """A view that is not visited.

    Attributes:
        view: index into the configurations.
        reason: why.
        blocker: closest pair at its first configuration ("housing with part"), if it collides; else "".
    """

    view: int
    reason: DropReason
    blocker: str


@dataclass(frozen=True, slots=True, eq=False)
class Tour(Value):
    """A certified motion over the views; segment k leads to view `order[k]`, the last segment home.

    Attributes:
        order: (n,) visited views, as indices into the configurations.
        choice: (n,) configuration of each visited view, as an index into that view's configurations.
        q: (n, axes) joint angles at the views, in visiting order [rad], multiples of 1e-4 deg; of a sweep at its middle
            pose.
        via: (N, axes) via points from home to home [rad]; one row (home) without views, none if home collides.
        segment: (N,) segment that ends at or passes the via point; 0 for the first.
        view: (N,) view taken at the via point, -1 at home, on detours and between the poses of a sweep.
        pose: (N,) pose of the view taken at the via point, 0 for a view at rest, -1 for none.
        entered: (n,) via point at which each visited view is entered: the beginning of its traversal.
        detour: (n + 1,) whether the segment has more than one straight move of the arm.
        duration: time of all moves, with a stop at each via point, and of the traversals [s].
        baseline_duration: time of the Christofides tour with straight moves, without regard to collisions [s].
        lower_bound: no motion over the visited views and more, through these configurations, is faster [s].
        dropped: views that are not visited, with reasons.
        status: result for all views.
        home_blocker: closest pair at home, if it collides; else "".
        rounds: number of orderings.
    """

    order: Annotated[Ints, "n"]
    choice: Annotated[Ints, "n"]
    q: Annotated[Floats, "n axes"]
    via: Annotated[Floats, "N axes"]
    segment: Annotated[Ints, "N"]
    view: Annotated[Ints, "N"]
    pose: Annotated[Ints, "N"]
    entered: Annotated[Ints, "n"]
    detour: Annotated[Bools, "segments"]
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
    progress: Progress = no_progress,
    *,
    ordering: Ordering = order_views,
) -> Tour:
    """Plan the motion that visits every view once, from home and back.

    Args:
        visits: views and home; configurations in collision are omitted.
        checker: collision checker with a clearance above 0.
        limits: limits of the axes; scale them (`planner.timing.limits.scale_limits`) to order for a reduced speed.
        rng: source of all randomness.
        budget: effort.
        progress: called with (real edges, edges of the current tour).
        ordering: function that orders the views.

    Returns:
        The motion, with the views that it cannot visit. It is certified: see `planner.path.certified_edge`.
    """
    require_usable(limits)
    require_inside("home: number", visits.home[None], limits)
    for k, q in enumerate(visits.configurations):
        require_inside(f"configuration of view {k}: number", q, limits)
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
    """Join the paths between the nodes."""
    traversals = search.visits.traversals
    views = [search.view_of(node) for node in nodes[1:-1]]
    stops = [
        SweepTraversal(roadmap.q[[node]], np.zeros(1, dtype=np.int64), 0.0, 0)
        if traversals is None
        else traversals[view][node - int(roadmap.offsets[view])]
        for view, node in zip(views, nodes[1:-1], strict=True)
    ]
    via, segment, view, pose, entered = [roadmap.q[:1]], [0], [-1], [-1], []
    detour, duration = [], 0.0
    for number, (a, b) in enumerate(search.edges(nodes)):
        path = search.path(a, b)
        duration += path_time(path, search.limits)
        via.append(path[1:])
        view += [-1] * (len(path) - 1)
        pose += [-1] * (len(path) - 1)
        if number < len(views):
            stop = stops[number]
            entered.append(len(view) - 1)
            via.append(stop.via[1:])
            view[-1:] = np.where(stop.pose >= 0, views[number], -1).tolist()
            pose[-1:] = stop.pose.tolist()
            duration += stop.duration
        segment += [number] * (len(view) - len(segment))
        detour.append(is_detour(path))
    visited = np.array(nodes[1:-1], dtype=np.int64)
    return Tour(
        order=np.array(views, dtype=np.int64),
        choice=visited - roadmap.offsets[views] if views else visited,
        q=np.array([stop.middle for stop in stops]).reshape(-1, roadmap.q.shape[1]),
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

"""Views to visit with their configurations, and the times of the moves between them.

Configurations are nodes, numbered as `node_offsets` says: 0 is home, then the configurations view by view.
"""

from collections.abc import Sequence, Sized
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from planner.errors import PlannerError
from planner.path.sweeps import SweepTraversal
from planner.ports import JointLimits
from planner.timing.limits import require_inside
from planner.timing.move_time import move_time
from planner.tour import generalised_tsp as gtsp
from planner.values import Floats, Ints, Value, freeze, readonly

_MAX_NODES = 1500  # configurations of all views in an ordering; more would take a few times as long as the search
_MIN_PER_VIEW = 4  # configurations of each view, for any number of views


@dataclass(frozen=True, slots=True, eq=False)
class TourProblem(Value):
    """Home and the configurations of n views, N nodes in all, with the times of the moves between them.

    Attributes:
        q: (N, axes) joint angles of the nodes [rad].
        offsets: (n + 1,) first node of each view, and the number of nodes.
        times: (N, N) time of the move from node to node [s]; inf if it cannot be driven.
        leave: (N,) node of the same view at which the arm leaves after arriving at each: a sweep ends where its reverse
            begins.
        stays: (N,) time between arriving and leaving [s], part of a tour's duration.
    """

    q: Annotated[Floats, "N axes"]
    offsets: Annotated[Ints, "n+1"]
    times: Annotated[Floats, "N N"]
    leave: Annotated[Ints, "N"]
    stays: Annotated[Floats, "N"]

    def __post_init__(self) -> None:
        freeze(self)
        empty = np.flatnonzero(np.diff(self.offsets) < 1)
        if len(empty):
            raise PlannerError(f"view {empty[0]} has no configuration; drop it before ordering")
        arrive, leave = (np.searchsorted(self.offsets, at, side="right") for at in (np.arange(len(self.q)), self.leave))
        if self.leave[0] != 0 or (arrive != leave).any():
            raise PlannerError("leave must name a node of the same view for each node, and home for home")

    @classmethod
    def straight(cls, configurations: Sequence[ArrayLike], home: ArrayLike, limits: JointLimits) -> "TourProblem":
        """Return the problem with straight moves and without stays.

        Args:
            configurations: per view, (n_i, axes) free configurations [rad], n_i >= 1.
            home: (axes,) configuration at which the tour begins and ends [rad].
            limits: limits of the axes.
        """
        start = readonly("home", home, (None,))[None]
        views = [
            readonly(f"configurations of view {k}", q, (None, start.shape[1])) for k, q in enumerate(configurations)
        ]
        for k, q in enumerate(views):
            require_inside(f"configuration of view {k}: number", q, limits)
        require_inside("home: number", start, limits)
        q = np.concatenate([start, *views])
        return cls(q, node_offsets(views), move_time(q[:, None], q, limits), np.arange(len(q)), np.zeros(len(q)))

    def instance(self) -> gtsp.Instance:
        """Return the travelling salesman problem: a cluster per view; a move costs its time and the stay at its end."""
        return gtsp.make_instance(self.times[self.leave] + self.stays, np.concatenate(([0], self.offsets)))


@dataclass(frozen=True, slots=True, eq=False)
class Visits(Value):
    """n views to visit, and home, where the motion begins and ends.

    Attributes:
        configurations: per view, (n_i, axes) [rad], multiples of 1e-4 deg; n_i may be 0.
        home: (axes,) joint angles [rad].
        T_base_scanner: (n, 4, 4) scanner pose of each view [m]; starts the ordering.
        T_base_home: (4, 4) scanner pose at home [m]; without it, home enters the baseline at its cheapest place.
        traversals: per view, one for each of its configurations, at which it begins; None: the arm stops to measure.
        known: some or all views in the order of an earlier tour, from which the search continues.
    """

    configurations: Sequence[Floats]
    home: Annotated[Floats, "axes"]
    T_base_scanner: Annotated[Floats, "n 4 4"]
    T_base_home: Annotated[Floats, "4 4"] | None = None
    traversals: Sequence[Sequence[SweepTraversal]] | None = None
    known: Sequence[int] = ()

    def __post_init__(self) -> None:
        views = [
            readonly(f"configurations of view {k}", q, (None, len(self.home)))
            for k, q in enumerate(self.configurations)
        ]
        object.__setattr__(self, "configurations", tuple(views))
        freeze(self, n=len(views))
        if self.traversals is not None:
            for k, (q, traversals) in enumerate(zip(views, self.traversals, strict=True)):
                _check_traversals(k, q, traversals)

    @property
    def q(self) -> Floats:
        """(N, axes) joint angles of the nodes [rad]."""
        return np.concatenate([self.home[None], *self.configurations])

    @property
    def offsets(self) -> Ints:
        """(n + 1,) first node of each view, and the number of nodes."""
        return node_offsets(self.configurations)

    @property
    def leave(self) -> Ints:
        """(N,) node at which the arm leaves after arriving at each."""
        if self.traversals is None:
            return np.arange(self.offsets[-1])
        views = zip(self.offsets.tolist(), self.traversals, strict=False)
        return np.array([0, *(first + traversal.leaves for first, traversals in views for traversal in traversals)])

    @property
    def stays(self) -> Floats:
        """(N,) time between arriving and leaving [s]."""
        if self.traversals is None:
            return np.zeros(self.offsets[-1])
        return np.array([0.0, *(traversal.duration for traversals in self.traversals for traversal in traversals)])


def _check_traversals(view: int, q: Floats, traversals: Sequence[SweepTraversal]) -> None:
    """Refuse traversals that do not fit the configurations of their view."""
    if len(traversals) != len(q):
        raise PlannerError(
            f"view {view} has {len(q)} configurations and {len(traversals)} traversals; give one for each"
        )
    for i, traversal in enumerate(traversals):
        if not 0 <= traversal.leaves < len(q):
            raise PlannerError(f"traversal {i} of view {view} must leave at a configuration of it, 0 to {len(q) - 1}")
        if not np.allclose(traversal.via[[0, -1]], q[[i, traversal.leaves]], rtol=0.0, atol=1e-9):
            raise PlannerError(f"traversal {i} of view {view} does not begin and end at its configurations")


def node_offsets(configurations: Sequence[Sized]) -> Ints:
    """Return (n + 1,) the first node of each view, and the number of nodes; home is node 0."""
    return np.cumsum([1, *map(len, configurations)])


def too_many_nodes(nodes: Sequence[Sized]) -> bool:
    """Return whether the views have too many configurations: the effort besides the search grows with their square."""
    return sum(map(len, nodes)) > _MAX_NODES


def best_nodes_on_tour(detours: Floats, n_views: int) -> Ints:
    """Return the configurations of one of n views that an ordering with too many nodes keeps, ascending.

    Args:
        detours: time that each configuration adds to a known tour, from the previous view to the next [s].
        n_views: number of views.
    """
    return np.sort(np.argsort(detours, kind="stable")[: max(_MIN_PER_VIEW, _MAX_NODES // n_views)])

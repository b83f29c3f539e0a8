"""What is ordered: the joint solutions of views as nodes, and what the moves between them cost.

Nodes are numbered as `node_offsets` says: 0 is home, then the joint solutions view by view.

What a tour visits: views by their joint solutions, and what the arm does at each.
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

_NODES = 1500  # joint solutions of all views that are ordered; a few times the time of a search among so many
_LEAST = 4  # of each view, however many views there are


@dataclass(frozen=True, slots=True, eq=False)
class TourProblem(Value):
    """Home and the joint solutions of n views, N nodes together, and the times of the moves between them.

    Attributes:
        q: (N, axes) joint angles of the nodes [rad].
        offsets: (n + 1,) first node of each view, and the number of nodes.
        times: (N, N) time of the move from node to node [s]; inf where it cannot be driven.
        leave: (N,) node of the same view at which the arm leaves when it arrived at each: a sweep ends where its
            reverse begins.
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
            raise PlannerError(f"view {empty[0]} has no joint solution; drop it before ordering")
        arrive, leave = (np.searchsorted(self.offsets, at, side="right") for at in (np.arange(len(self.q)), self.leave))
        if self.leave[0] != 0 or (arrive != leave).any():
            raise PlannerError("leave must name a node of the same view for each node, and home for home")

    @classmethod
    def straight(cls, configurations: Sequence[ArrayLike], home: ArrayLike, limits: JointLimits) -> "TourProblem":
        """Straight moves between views at which the arm stands still and that take no time.

        Args:
            configurations: per view, (n_i, axes) collision-free joint solutions [rad]; at least one each.
            home: (axes,) joint angles at which the tour begins and ends [rad].
            limits: limits of the axes.

        Raises:
            PlannerError: if a view has no joint solution, or a joint angle is outside its range.
        """
        start = readonly("home", home, (None,))[None]
        solutions = [
            readonly(f"configurations of view {k}", q, (None, start.shape[1])) for k, q in enumerate(configurations)
        ]
        for k, q in enumerate(solutions):
            require_inside(f"joint solution of view {k}: number", q, limits)
        require_inside("home: number", start, limits)
        q = np.concatenate([start, *solutions])
        times = move_time(q[:, None], q, limits)
        return cls(q, node_offsets(solutions), times, np.arange(len(q)), np.zeros(len(q)))

    def instance(self) -> gtsp.Instance:
        """The travelling salesman's: one cluster per view; a move costs its time and the stay where it arrives."""
        return gtsp.make_instance(self.times[self.leave] + self.stays, np.concatenate(([0], self.offsets)))


def node_offsets(configurations: Sequence[Sized]) -> Ints:
    """Node numbers: solution i of view k is node `offsets[k] + i`, home is node 0.

    Returns:
        (n + 1,) first node of each view, and the number of nodes.
    """
    return np.cumsum([1, *map(len, configurations)])


def too_many_nodes(nodes: Sequence[Sized]) -> bool:
    """Whether so many joint solutions of the views are ordered that only the best of each ought to be.

    What an ordering costs beside its search grows with the square of their number.
    """
    return sum(map(len, nodes)) > _NODES


def best_nodes_on_tour(longer: Floats, n_views: int) -> Ints:
    """Those joint solutions of one of n views that are ordered where there are too many, by number.

    Args:
        longer: how much longer each makes a tour that is known, from the view before to the one after [s].
        n_views: number of views.
    """
    return np.sort(np.argsort(longer, kind="stable")[: max(_LEAST, _NODES // n_views)])


@dataclass(frozen=True, slots=True, eq=False)
class Visits(Value):
    """n views that are to be visited, and home, at which the motion begins and ends.

    Attributes:
        configurations: per view, (n_i, axes) joint solutions [rad], multiples of 1e-4 deg; there may be none.
        home: (axes,) joint angles [rad].
        T_base_scanner: (n, 4, 4) scanner pose of each view [m], base frame; starts the ordering.
        T_base_home: (4, 4) scanner pose at home [m]; without it, home enters the baseline where it costs least.
        passages: per view, one for each of its joint solutions, beginning there; None: the arm stands and measures.
        known: views in the order of an earlier tour, some or all: the search goes on from it.
    """

    configurations: Sequence[Floats]
    home: Annotated[Floats, "axes"]
    T_base_scanner: Annotated[Floats, "n 4 4"]
    T_base_home: Annotated[Floats, "4 4"] | None = None
    traversals: Sequence[Sequence[SweepTraversal]] | None = None
    known: Sequence[int] = ()

    def __post_init__(self) -> None:
        solutions = [
            readonly(f"configurations of view {k}", q, (None, len(self.home)))
            for k, q in enumerate(self.configurations)
        ]
        object.__setattr__(self, "configurations", tuple(solutions))
        freeze(self, n=len(solutions))
        if self.traversals is not None:
            for k, (q, own) in enumerate(zip(solutions, self.traversals, strict=True)):
                _check(k, q, own)

    @property
    def q(self) -> Floats:
        """(N, axes) joint angles of the nodes [rad]: home, then the joint solutions view by view."""
        return np.concatenate([self.home[None], *self.configurations])

    @property
    def offsets(self) -> Ints:
        """(n + 1,) first node of each view, and the number of nodes."""
        return node_offsets(self.configurations)

    @property
    def leave(self) -> Ints:
        """(N,) node at which the arm leaves when it arrived at each."""
        if self.traversals is None:
            return np.arange(self.offsets[-1])
        views = zip(self.offsets.tolist(), self.traversals, strict=False)
        return np.array([0, *(first + passage.leaves for first, own in views for passage in own)])

    @property
    def stays(self) -> Floats:
        """(N,) time between arriving and leaving [s]."""
        if self.traversals is None:
            return np.zeros(self.offsets[-1])
        return np.array([0.0, *(passage.duration for own in self.traversals for passage in own)])


def _check(view: int, q: Floats, passages: Sequence[SweepTraversal]) -> None:
    """Refuse passages that do not fit the joint solutions of their view."""
    if len(passages) != len(q):
        raise PlannerError(
            f"view {view} has {len(q)} joint solutions and {len(passages)} passages; they must be as many"
        )
    for i, passage in enumerate(passages):
        if not 0 <= passage.leaves < len(q):
            raise PlannerError(f"passage {i} of view {view} must leave at a joint solution of it, 0 to {len(q) - 1}")
        if not np.allclose(passage.via[[0, -1]], q[[i, passage.leaves]], rtol=0.0, atol=1e-9):
            raise PlannerError(f"passage {i} of view {view} does not begin and end at the joint solutions it names")

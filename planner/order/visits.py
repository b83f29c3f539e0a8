"""What a tour visits: views by their joint solutions, and what the arm does at each."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from planner.errors import PlannerError
from planner.order.moves import node_offsets
from planner.path.sweeps.passage import Passage
from planner.values import Floats, Ints, Value, freeze, readonly


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
    passages: Sequence[Sequence[Passage]] | None = None
    known: Sequence[int] = ()

    def __post_init__(self) -> None:
        solutions = [
            readonly(f"configurations of view {k}", q, (None, len(self.home)))
            for k, q in enumerate(self.configurations)
        ]
        object.__setattr__(self, "configurations", tuple(solutions))
        freeze(self, n=len(solutions))
        if self.passages is not None:
            for k, (q, own) in enumerate(zip(solutions, self.passages, strict=True)):
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
        if self.passages is None:
            return np.arange(self.offsets[-1])
        views = zip(self.offsets.tolist(), self.passages, strict=False)
        return np.array([0, *(first + passage.leaves for first, own in views for passage in own)])

    @property
    def stays(self) -> Floats:
        """(N,) time between arriving and leaving [s]."""
        if self.passages is None:
            return np.zeros(self.offsets[-1])
        return np.array([0.0, *(passage.duration for own in self.passages for passage in own)])


def _check(view: int, q: Floats, passages: Sequence[Passage]) -> None:
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

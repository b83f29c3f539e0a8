"""A sweep as a tour sees it: where the arm arrives, where it leaves, and how long it takes."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from planner.values import Floats, Ints, Value


@dataclass(frozen=True, slots=True, eq=False)
class Passage(Value):
    """What the arm does at a view between arriving and leaving: the line of a sweep.

    Attributes:
        via: (m, axes) via points [rad], certified, the first where the arm arrives and the last where it leaves.
        pose: (m,) pose of the view that is taken at each, -1 for none.
        duration: of the passage [s].
        leaves: joint solution of the same view (its index) that begins where this one ends.
    """

    via: Annotated[Floats, "m axes"]
    pose: Annotated[Ints, "m"]
    duration: float
    leaves: int

    @property
    def middle(self) -> Floats:
        """(axes,) joint angles at the middle one of its poses [rad]."""
        return np.asarray(self.via[int(np.flatnonzero(self.pose == (self.pose >= 0).sum() // 2)[0])])

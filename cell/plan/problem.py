"""What selection and motion are asked: the candidates with all that is known of them, in a cell, and what is wished."""

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cell.errors import UnreachableError
from cell.plan.request import Request
from cell.world.collision import MujocoCollisionChecker
from cell.world.model import World
from cell.world.prediction import Prediction
from planner.kinematics.reach import Reach, add_configurations
from planner.measurability.matrix import Measurability
from planner.ports import JointLimits, Kinematics
from planner.values import Floats, Ints
from planner.viewpoints.viewpoints import Viewpoints


class PinnedOutError(UnreachableError):
    """A candidate that has to be in the plan cannot be part of a motion.

    Attributes:
        candidate: row of the viewpoints.
        reason: why, without a full stop.
    """

    def __init__(self, candidate: int, reason: str) -> None:
        super().__init__(
            f"candidate {candidate} is pinned and cannot be part of a motion: {reason}; pin another, or change the "
            "placement"
        )
        self.candidate, self.reason = candidate, reason


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """Candidates in a cell, and the wishes.

    Attributes:
        request: what is asked for.
        candidates: the viewpoints, columns of M; of a scanner that sweeps each has several poses.
        reached: their verdicts and joint solutions.
        M: what they measure, occluders applied.
        prediction: held-out samples, on which a coverage below 1 is kept.
        world: placement, mount and home.
        limits: of the axes, scaled to the speed that is wanted.
        kinematics: of the arm.
        checker: of the cell.
    """

    request: Request
    candidates: Viewpoints
    reached: Reach
    M: Measurability
    prediction: Prediction
    world: World
    limits: JointLimits
    kinematics: Kinematics
    checker: MujocoCollisionChecker

    @property
    def at_rest(self) -> bool:
        """Whether the arm stands still at a view; otherwise it sweeps."""
        return bool(self.candidates.T_object_scanner.shape[1] == 1)

    def usable(self, refused: Collection[int]) -> NDArray[np.bool_]:
        """(V,) candidates that the arm reaches and that neither the user bans nor the planning has refused."""
        usable = np.asarray(self.reached.reachable).copy()
        usable[[*refused, *self.request.plan.banned]] = False
        return usable

    def taking(self, views: Ints, q: Floats) -> "Problem":
        """With the joint solutions (n, axes) [rad] at which a motion takes (n,) candidates among those of their reach.

        Only angles of a rotary table may lie between those that were looked at.
        """
        return self if self.world.table is None else replace(self, reached=add_configurations(self.reached, views, q))

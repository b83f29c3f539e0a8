"""A sweep on one joint branch as a value: its set-points and speed, or why it cannot be driven."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from planner.errors import PlannerError
from planner.path.sweeps.line import SweepLine
from planner.path.sweeps.passage import Passage
from planner.reach.setpoints import to_steps
from planner.timing.s_curve import Profile
from planner.values import Floats, Ints, Value
from planner.worded import Worded


class SweepRefusal(Worded):
    """Why a sweep cannot be driven on a branch."""

    NO_LINE = 0, "the poses do not follow each other at equal steps on a line"
    OUT_OF_REACH = 1, "the line leaves the arm's reach"
    SINGULAR = 2, "the line comes too near to a singularity to be followed on one joint branch"
    JOINT_LIMIT = 3, "the line exceeds a joint limit"
    TOO_FAST = 4, "even at a quarter of the speed an axis would exceed its speed, acceleration or jerk"
    COLLISION = 5, "the line comes nearer to something than the clearance"


@dataclass(frozen=True, slots=True, eq=False)
class SweepPath(Value):
    """A sweep on one branch, in one direction.

    Attributes:
        line: in the direction in which it is driven.
        branch: slot of the inverse kinematics.
        q: (m, 6) vertices [rad], multiples of 1e-4 deg; at rest at the first and the last, passed without stop between.
        u: (m,) their parameters, rising from 0 to 1.
        pose: (m,) pose of the column that is measured at the vertex, -1 for none; falling where driven backwards.
        profile: of u over time.
        sigma: smallest singular value of the Jacobian on it (linear rows over the largest lever); 0 is singular.
    """

    line: SweepLine
    branch: int
    q: Annotated[Floats, "m 6"]
    u: Annotated[Floats, "m"]
    pose: Annotated[Ints, "m"]
    profile: Profile
    sigma: float

    @property
    def duration(self) -> float:
        """Time from rest to rest [s]."""
        return float(self.profile.duration)

    @property
    def measured_q(self) -> Floats:
        """(K, 6) set-points of the measuring poses, in the order of the column [rad]."""
        rows = np.flatnonzero(self.pose >= 0)
        return np.asarray(self.q[rows[np.argsort(self.pose[rows])]])

    def reversed(self) -> "SweepPath":
        """The same sweep driven from its end to its beginning."""
        line = SweepLine(
            self.line.at(np.ones(1))[0], -self.line.displacement, -self.line.turn, self.line.poses
        )  # the turn's axis keeps its direction
        return SweepPath(line, self.branch, self.q[::-1], 1.0 - self.u[::-1], self.pose[::-1], self.profile, self.sigma)


@dataclass(frozen=True, slots=True)
class Refused:
    """A branch on which the sweep cannot be driven.

    Attributes:
        branch: slot of the inverse kinematics; -1 where the whole sweep is meant.
        reason: why.
        detail: the axes of a singularity or a limit ("A4 and A6"), or what the line collides with; "" for none.
    """

    branch: int
    reason: SweepRefusal
    detail: str

    @property
    def sentence(self) -> str:
        """Reason and detail in words."""
        return self.reason.sentence + (f" ({self.detail})" if self.detail else "")


@dataclass(frozen=True, slots=True, eq=False)
class Sweeps:
    """What can be driven of a column of poses.

    Attributes:
        paths: every branch and turn that can be driven, each in both directions.
        refused: the other branches that exist, and why not.
    """

    paths: tuple[SweepPath, ...]
    refused: tuple[Refused, ...]


def passages_of(paths: Sequence[SweepPath]) -> list[Passage]:
    """The sweeps of one view as passages of a tour; the reverse of each must be among them, unless it stands.

    Raises:
        PlannerError: if a sweep cannot be left for want of its reverse.
    """
    begins = {tuple(to_steps(path.q[0]).tolist()): i for i, path in enumerate(paths)}
    passages = []
    for path in paths:
        leaves = begins.get(tuple(to_steps(path.q[-1]).tolist()))
        if leaves is None:
            raise PlannerError("a sweep's reverse is missing; give both directions of every sweep")
        passages.append(Passage(path.q, path.pose, path.duration, leaves))
    return passages

"""What a person releases before an arm moves: the plan's motion, or a way of its own with a digest of its own.

A way of its own is what is driven where that is not the plan's motion as a whole: to one view and back (`--view`), or
from where the arm stands to where an execution goes on (`--resume`, home with it). It passes the check of the plan's
segments before its first move; see `cell.runs.digest` for what its digest covers.
"""

from dataclasses import dataclass

import numpy as np

from cell.runs import digest
from cell.runs.verification import VerifiedPlan
from cell.scan.legs import Legs
from drivers.setpoints import from_rad


@dataclass(frozen=True, slots=True)
class Released:
    """What may be driven once a person says so.

    Attributes:
        what: in words: "the plan", "the way to view 3 and back".
        digest: of it.
        own: whether it is a way of its own.
    """

    what: str
    digest: str
    own: bool = False

    @property
    def shown(self) -> str:
        """The first characters of the digest."""
        return self.digest[: digest.SHORT_DIGEST]


def of_plan(proven: VerifiedPlan) -> Released:
    """The plan's motion."""
    return Released("the plan", proven.digest)


def of_legs(proven: VerifiedPlan, legs: Legs, what: str) -> Released:
    """A way of its own, found to keep the limits and to be free of collision.

    Args:
        proven: the plan.
        legs: what is driven.
        what: in words.

    Raises:
        FileError: if it is not free.
    """
    limits = proven.motion.limits
    start = np.clip(legs.start, limits.lower, limits.upper)  # a count beyond a limit is a rounded limit
    proven.require_path_free(np.concatenate([start[None], *(leg.via for leg in legs.legs)]))
    rows = [[0, 0, -1, *from_rad(legs.start).tolist()]]
    for number, leg in enumerate(legs.legs, start=1):
        last = len(leg.via) - 1
        for row, set_points in enumerate(leg.set_points.tolist()):
            taken = [leg.stop, leg.pose if leg.stop else -1] if row == last else [0, -1]
            rows.append([number, *taken, *set_points])
    return Released(what, digest.path_digest(proven.digest, rows), own=True)

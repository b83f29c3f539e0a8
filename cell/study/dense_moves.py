"""Straight joint moves between configurations of a cell, looked at every millimetre: what a coarser look misses.

A fixed step checks every so many degrees of the joint that turns most; `planner.path.certified_edge.certify` takes as
many steps as the bound on travel asks for. Radians, metres.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from planner.ports import CollisionChecker, Floats

TRUTH = 1e-3
"""Travel between two looks that decide what is true of a move [m]."""

_FIRST_BATCH, _GROWTH = 8, 4  # as certification does: a collision is mostly found within a few checks


@dataclass(frozen=True)
class DenseMove:
    """A straight move.

    Attributes:
        q_from: (6,) [rad].
        q_to: (6,) [rad].
        checker: keeps the clearance.
    """

    q_from: Floats
    q_to: Floats
    checker: CollisionChecker

    @cached_property
    def dense(self) -> Floats:
        """(N, 6) configurations at most `TRUTH` of travel apart."""
        n = 1 + int(np.ceil(self.checker.travel(self.q_from[None], self.q_to[None])[0] / TRUTH))
        return self.q_from + np.linspace(0.0, 1.0, n + 1)[:, None] * (self.q_to - self.q_from)

    @cached_property
    def intrusion(self) -> float:
        """How much of the clearance the move uses up at its nearest [m]; 0 where it keeps it."""
        if not len(self._near):
            return 0.0
        return max(0.0, self.checker.clearance - float(self.checker.distance(self._near)[0].min()))

    @cached_property
    def _near(self) -> Floats:
        return self.dense[~self.checker.free(self.dense)]


def passes(q_from: Floats, q_to: Floats, checker: CollisionChecker, step: float) -> bool:
    """Whether a look at a fixed step calls a move free; it stops at the first batch that holds a collision.

    Args:
        q_from: (6,) [rad].
        q_to: (6,) [rad].
        checker: the collision checker.
        step: between two looks, of the joint that turns most [rad].
    """
    count = max(1, int(np.ceil(np.abs(q_to - q_from).max() / step)))
    looks = q_from + np.linspace(0.0, 1.0, count + 1)[:, None] * (q_to - q_from)
    start, size = 0, _FIRST_BATCH
    while start < len(looks):
        if not checker.free(looks[start : start + size]).all():
            return False
        start, size = start + size, size * _GROWTH
    return True

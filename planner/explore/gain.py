"""What a view may gain of what is open: an area, and the probability that a view which should measure it does.

What is believed of a part beyond the last measured point is a guess. Views that should measure it do so the more
seldom, the more often others should have and did not: behind it is a wall of the guess itself, or nothing. How much
more seldom is learned from the exploration.
"""

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from planner.values import Floats, Ints, Value

MOST_TRIES = 4
"""Tries beyond this many are as this many."""

_KEPT = 0.5
"""Weight of earlier stages at each new one: what is believed late is more often true than what was believed early."""

_PRIOR = 0.5
"""Share of what failed with one try less that is expected to succeed before anything is known of it ..."""

_WORTH = 0.02
"""... and the weight of that expectation, as a share of the believed surface."""


@dataclass(frozen=True, slots=True, eq=False)
class Record(Value):
    """What became of believed surface that views should have measured, by the tries before.

    Attributes:
        expected: (MOST_TRIES + 1,) area that executed views should have measured [share of the believed surface].
        measured: (MOST_TRIES + 1,) of it, where points came back [share of the believed surface].
    """

    expected: Annotated[Floats, "n"]
    measured: Annotated[Floats, "n"]

    @classmethod
    def empty(cls) -> "Record":
        """Before anything was executed."""
        return cls(np.zeros(MOST_TRIES + 1), np.zeros(MOST_TRIES + 1))

    def with_stage(self, tries: Ints, shares: Floats, measured: Floats) -> "Record":
        """With a stage more.

        Args:
            tries: (N,) before, of samples that its views should have measured.
            shares: (N,) of the believed surface that each stands for.
            measured: (N,) 1 where points came back near it, else 0.
        """
        level = np.minimum(tries, MOST_TRIES)
        count = MOST_TRIES + 1
        return replace(
            self,
            expected=_KEPT * self.expected + np.bincount(level, shares, count),
            measured=_KEPT * self.measured + np.bincount(level, shares * measured, count),
        )

    @property
    def probability(self) -> Floats:
        """(MOST_TRIES + 1,) that a view which should measure something open does, by tries; never more with more.

        The share that did, shrunk towards `_PRIOR` of the one with a try less (1 for none).
        """
        found = np.empty(MOST_TRIES + 1)
        before = 1.0 / _PRIOR
        for level in range(MOST_TRIES + 1):
            share = (self.measured[level] + _WORTH * _PRIOR * before) / (self.expected[level] + _WORTH)
            found[level] = before = min(share, before, 1.0)
        return found

    def weights(self, tries: Ints) -> Floats:
        """(N,) probability for samples of so many tries."""
        return np.asarray(self.probability[np.minimum(tries, MOST_TRIES)])

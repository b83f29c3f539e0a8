"""What a view may gain of what is open: an area, and the probability that a ray to it finds something new.

What is believed of a part beyond the last measured point is a guess: a wall of the guess itself, behind which the part
lies deeper, or nothing at all. It is the better, the nearer to a measured point, where the surface goes on, and the
worse, the more often others should have measured it and did not. How much so is learned from the exploration.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated

import numpy as np

from planner.values import Bools, Floats, Ints, Value

if TYPE_CHECKING:
    from scipy.sparse import csr_array

MAX_TRIES = 2
"""Tries beyond this many are as this many."""

REACHES = (1.1, 2.0, 4.0, 8.0, 16.0, 32.0)
"""Distances from the nearest measured voxel between the classes [edges of a voxel]; the first is of gaps in it."""

_PRIOR = 0.5 * 0.5 ** np.arange(MAX_TRIES + 1)[:, None] * 0.7 ** np.maximum(np.arange(len(REACHES) + 1) - 1, 0)
"""Probability before anything is known of it: halved with each try, less by a third with each class of distance ..."""

_WORTH = 0.01
"""... and the weight of this, as a share of the believed surface."""

_KEPT = 0.7
"""Weight of earlier stages at each new one: what is believed late is more often true than what was believed early."""

_BETWEEN = 0.2
"""Share of its probability that surface between points of neighbouring rays has: most of it is measured already."""


N_LATEST_BATCHES = 4
"""Batches of which the last are asked how much came: what is left then is of another kind than what was first."""


@dataclass(frozen=True, slots=True, eq=False)
class OpenSamples(Value):
    """Which class open samples of a believed surface are of.

    Attributes:
        tries: (N,) views that should have measured each and did not.
        beside: (N,) distance to the nearest measured voxel [edges].
        between: (N,) whether it lies between points of neighbouring rays: seen, only steeply.
    """

    tries: Annotated[Ints, "N"]
    distance_edges: Annotated[Floats, "N"]
    between: Annotated[Bools, "N"]

    @property
    def classes(self) -> tuple[Ints, Ints]:
        """(N,) row and column of each in tables by class."""
        return np.minimum(self.tries, MAX_TRIES), np.digitize(self.distance_edges, REACHES)


@dataclass(frozen=True, slots=True, eq=False)
class GainRecord(Value):
    """What became of what was open where views should have measured it, by class.

    Attributes:
        expected: (MOST_TRIES + 1, len(REACHES) + 1) area [share of the believed surface].
        found: of it, where a ray came back with something new [share of the believed surface].
    """

    expected: Annotated[Floats, "T R"]
    found: Annotated[Floats, "T R"]

    @classmethod
    def empty(cls) -> "GainRecord":
        """Before anything was executed."""
        return cls(np.zeros(_PRIOR.shape), np.zeros(_PRIOR.shape))

    def with_batch(self, still_open: OpenSamples, shares: Floats, found: Floats) -> "GainRecord":
        """With a stage more; what lies between neighbouring rays says nothing of what was not seen.

        Args:
            still_open: before it, samples that its views should have measured.
            shares: (N,) of the believed surface that each stands for.
            found: (N,) 1 where a ray came back with something new, else 0.
        """
        expected, came, shares = _KEPT * self.expected, _KEPT * self.found, shares * ~still_open.between
        np.add.at(expected, still_open.classes, shares)
        np.add.at(came, still_open.classes, shares * found)
        return replace(self, expected=expected, found=came)

    def weights(self, still_open: OpenSamples) -> Floats:
        """(N,) probability that a view which should measure each finds something: the share that did, and the prior."""
        learned = ((self.found + _WORTH * _PRIOR) / (self.expected + _WORTH))[still_open.classes]
        return np.where(still_open.between, _BETWEEN * learned, learned)


def gain_ratio(batches: Sequence[tuple[float, float]]) -> float:
    """How many times as much as expected comes: the median of the latest batches, and of one more that brought it.

    Args:
        batches: area that each was expected to measure, and that it measured [m^2]; one of which nothing was expected
            does not count.
    """
    ratios = [measured / expected for expected, measured in batches if expected > 0]
    return float(np.median([1.0, *ratios[-N_LATEST_BATCHES:]]))


def select_by_gain_per_second(
    measured: "csr_array", areas: Floats, seconds: Floats, usable: Bools, count: int, least: float = 0.0
) -> Ints:
    """Up to `count` views, each with the most open area per second after those before it; ties go to the smaller.

    Args:
        measured: (S, V) what each view measures.
        areas: (S,) expected of each row [m^2].
        seconds: (V,) that each view takes, above 0.
        usable: (V,) those that may be taken.
        count: how many; fewer are returned where no other adds more than `least`.
        least: area per second that each adds at least [m^2/s].
    """
    left, taken = np.array(areas), list[int]()
    columns = measured.T.tocsr()
    while len(taken) < count:
        rates = np.where(usable, columns @ left / seconds, 0.0)
        if rates[best := int(rates.argmax())] <= least:
            break
        taken.append(best)
        left[columns[[best]].indices] = 0.0
    return np.array(taken, dtype=np.int64)

"""Expected gain of a view: uncovered area, weighted by the probability that a ray to it finds something new.

Belief surface beyond the last measured point is a guess: the part may lie deeper, or there may be nothing at all. The
guess is better near a measured point, where the surface continues, and worse the more often views failed to measure it.
The probabilities are learned during the exploration.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated

import numpy as np

from planner.values import Bools, Floats, Ints, Value

if TYPE_CHECKING:
    from scipy.sparse import csr_array

MAX_TRIES = 2
"""More tries count as this number."""

DISTANCE_CLASSES = (1.1, 2.0, 4.0, 8.0, 16.0, 32.0)
"""Limits of the classes of distance from the nearest measured voxel [edges of a voxel]; the first class is a gap."""

_PRIOR = 0.5 * 0.5 ** np.arange(MAX_TRIES + 1)[:, None] * 0.7 ** np.maximum(np.arange(len(DISTANCE_CLASSES) + 1) - 1, 0)
"""Probability without observations: halved by each try, multiplied by 0.7 by each class of distance."""

_PRIOR_WEIGHT = 0.01
"""Weight of the prior, as a share of the belief surface."""

_FORGETTING = 0.7
"""Factor of earlier observations at each new batch: late guesses are more often right than early ones."""

_BETWEEN = 0.2
"""Factor of the probability of surface between points of neighbouring rays: most of it is measured already."""


N_LATEST_BATCHES = 4
"""Number of latest batches for the gain ratio: the surface that remains differs from the first."""


@dataclass(frozen=True, slots=True, eq=False)
class OpenSamples(Value):
    """Features of uncovered samples of a belief surface, which define their class.

    Attributes:
        tries: (N,) number of views that should have measured each sample and did not.
        distance_edges: (N,) distance to the nearest measured voxel [edges].
        between: (N,) whether it lies between points of neighbouring rays: measured, only at a grazing angle.
    """

    tries: Annotated[Ints, "N"]
    distance_edges: Annotated[Floats, "N"]
    between: Annotated[Bools, "N"]

    @property
    def classes(self) -> tuple[Ints, Ints]:
        """(N,) row and column of each sample in tables by class."""
        return np.minimum(self.tries, MAX_TRIES), np.digitize(self.distance_edges, DISTANCE_CLASSES)


@dataclass(frozen=True, slots=True, eq=False)
class GainRecord(Value):
    """Expected and found area of uncovered samples, by class.

    Attributes:
        expected: (MAX_TRIES + 1, len(DISTANCE_CLASSES) + 1) area that views should have measured [share of the belief
            surface].
        found: area of it for which a ray returned a new point [share of the belief surface].
    """

    expected: Annotated[Floats, "T R"]
    found: Annotated[Floats, "T R"]

    @classmethod
    def empty(cls) -> "GainRecord":
        """Return the record before the first batch."""
        return cls(np.zeros(_PRIOR.shape), np.zeros(_PRIOR.shape))

    def with_batch(self, samples: OpenSamples, shares: Floats, found: Floats) -> "GainRecord":
        """Add a batch; samples between neighbouring rays are ignored.

        Args:
            samples: uncovered samples before the batch that its views should have measured.
            shares: (N,) share of the belief surface of each.
            found: (N,) 1 if a ray returned a new point, else 0.
        """
        expected_sum, found_sum = _FORGETTING * self.expected, _FORGETTING * self.found
        shares = shares * ~samples.between
        np.add.at(expected_sum, samples.classes, shares)
        np.add.at(found_sum, samples.classes, shares * found)
        return replace(self, expected=expected_sum, found=found_sum)

    def weights(self, samples: OpenSamples) -> Floats:
        """Return the (N,) probability that a view finds a sample that it should measure, by prior and record."""
        by_class = (self.found + _PRIOR_WEIGHT * _PRIOR) / (self.expected + _PRIOR_WEIGHT)
        learned = by_class[samples.classes]
        return np.where(samples.between, _BETWEEN * learned, learned)


def gain_ratio(batches: Sequence[tuple[float, float]]) -> float:
    """Return measured over expected area: the median of the latest batches and of one that measured what it expected.

    Args:
        batches: expected and measured area of each [m^2]; batches without expected area are ignored.
    """
    ratios = [measured / expected for expected, measured in batches if expected > 0]
    return float(np.median([1.0, *ratios[-N_LATEST_BATCHES:]]))


def select_by_gain_per_second(
    measured: "csr_array", areas: Floats, seconds: Floats, usable: Bools, count: int, min_rate: float = 0.0
) -> Ints:
    """Select up to `count` views, each with the most uncovered area per second; ties go to the smaller index.

    Args:
        measured: (S, V) whether each view measures a sample.
        areas: (S,) expected area of each row [m^2].
        seconds: (V,) duration of each view, above 0.
        usable: (V,) whether a view may be selected.
        count: largest number of views.
        min_rate: area per second that each view must exceed [m^2/s].
    """
    left, selected = np.array(areas), list[int]()
    columns = measured.T.tocsr()
    while len(selected) < count:
        rates = np.where(usable, columns @ left / seconds, 0.0)
        if rates.max(initial=min_rate) <= min_rate:
            break
        selected.append(int(rates.argmax()))
        left[columns[selected[-1:]].indices] = 0.0
    return np.array(selected, dtype=np.int64)

"""Chosen views on their way to a motion: the same for views at rest and for views that sweep."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from cell.plan.request import Selected
from planner.measurability.matrix import Measurability
from planner.path.sweeps import SweepPath, SweepTraversal
from planner.timing.motion import TimedLine
from planner.tour.tour import Tour
from planner.values import Bools, Floats, Ints


class Next(Enum):
    """What an attempt to connect chosen views leads to."""

    DONE = "every chosen view is connected"
    CONNECT = "some views have fewer joint solutions now: connect them again"
    CHOOSE = "views were refused, or measure less now: choose again"


@dataclass(frozen=True, slots=True, eq=False)
class Groups:
    """Candidates that the motion may pick from, one of each group.

    Attributes:
        members: for each view of the plan the candidates, the one that is expected first.
        owner: for each view the candidate of each row of its configurations.
        configurations: for each view (m, 6) joint solutions of its members, one after the other [rad].
        straight_before: time of straight moves over the views that were exchanged, and of standing at them where time
            counts [s]: a plan that takes no longer needs no comparison with theirs. inf where nothing was exchanged.
        visited: candidates in the order of the tour that the exchange found.
        instead: what is connected for that comparison; None: each view of the cover in a group of its own.
    """

    members: tuple[Ints, ...]
    owner: tuple[Ints, ...]
    configurations: tuple[Floats, ...]
    straight_before: float = float("inf")
    visited: tuple[int, ...] = ()
    instead: "Groups | None" = None

    @property
    def exchanged(self) -> bool:
        """Whether views of the cover were exchanged."""
        return bool(np.isfinite(self.straight_before))

    @property
    def views(self) -> Ints:
        """(n,) the candidate that is expected of each group."""
        return np.array([group[0] for group in self.members], dtype=np.int64)

    def picked(self, motion: Tour) -> Ints:
        """(n,) the candidate that a motion picked of each group; the expected one where the view is not visited."""
        picks = self.views
        for view, choice in zip(motion.order, motion.choice, strict=True):
            picks[view] = self.owner[view][choice]
        return picks


@dataclass(frozen=True, slots=True, eq=False)
class Driven:
    """The views of a motion as they are driven.

    Attributes:
        T_object_poses: (n, K, 4, 4) poses of the rounded joint angles [m], visiting order.
        sweeps: the sweeps, in visiting order; none for views at rest.
        lines: their timing, by the via point at which each begins.
        seen: (S, n) which held-out samples each view measures, visiting order.
        visible_with_arm: the same where each view's own arm hides as well, fraction of the surface; None for views that
            sweep: the arm's shadow along a sweep is not judged.
    """

    T_object_poses: Floats
    sweeps: tuple[SweepPath, ...]
    lines: Mapping[int, TimedLine]
    seen: Bools
    visible_with_arm: float | None


class Views(Protocol):
    """Candidates of one kind between selection and motion (`ViewsAtRest`, `SweepingViews`)."""

    @property
    def M(self) -> Measurability:
        """Measurability as it is known by now; it shrinks where an arm shades its own view."""
        ...

    @property
    def shaded(self) -> Mapping[int, str]:
        """Candidates from which an arm took samples, each with a sentence."""
        ...

    def refusals(self, views: Ints) -> Mapping[int, str]:
        """Which of the (n,) candidates can be no view of a plan, each with its reason."""
        ...

    def still_measure(self, views: Ints) -> bool:
        """Whether (n,) candidates measure what they were chosen for, as far as is known without a motion."""
        ...

    def groups(self, selected: Selected, usable: NDArray[np.bool_], rng: np.random.Generator) -> Groups:
        """The candidates that the motion may pick from, for each view of the cover.

        Args:
            selected: the cover.
            usable: (V,) candidates that may be used.
            rng: source of randomness.
        """
        ...

    def alone(self, views: Ints) -> Groups:
        """Each of (n,) candidates in a group of its own."""
        ...

    def traversals(self, views: Ints) -> list[list[SweepTraversal]] | None:
        """What the arm does at each joint solution of (n,) candidates; None where it stands still."""
        ...

    def judge(self, views: Ints, motion: Tour) -> Next:
        """What a motion through (n,) candidates leads to, all of them connected."""
        ...

    def finer(self, groups: Groups, motion: Tour, shares: Sequence[float]) -> Groups | None:
        """The views of a motion, each with solutions beside the one taken: shares of a rotary table's step of angle.

        None where no table turns the part.
        """
        ...

    def hides_no_more(self, views: Ints, before: Tour, motion: Tour) -> bool:
        """Whether at each of (n,) candidates the arm hides nothing that it showed in another motion through them."""
        ...

    def driven(self, views: Ints, motion: Tour) -> Driven:
        """The views of the plan as they are driven; the motion's views are indices into (n,) `views`."""
        ...

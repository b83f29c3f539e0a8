"""Views moved so that fewer of them measure as much: one view at a time, over all six degrees of freedom.

Candidates are drawn before it is known which of them will stand together. Once some are chosen, what each is needed for
is known: what no other chosen view measures. `fewer` leaves out the views that are needed least and moves the others
until nothing is missing again: each in turn to where it measures the largest area of what only it measures and of what
is open, all others staying where they are; then all of them again with other steps. The measured area never falls. A
pattern search (Kolda, Lewis, Torczon 2003, doi:10.1137/S003614450242889) whose steps are stretches of the lattice of
`pose_sampling`: nothing is random, and the work is counted in poses. `better` does the same with views
that are not to stand together. Every pose that is kept measures by the same rules as a candidate and is taken up by the
arm. Object frame, metres.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from planner.values import Bools, Floats, Ints, Value
from planner.viewpoints.growth import ViewEvaluator
from planner.viewpoints.lines_of_sight import RayTargets
from planner.viewpoints.pose_sampling import perturb_pose

EFFORT = 8_000
"""Poses that are looked at in all: one to two seconds of processor time."""

SCALES = (1.0, 0.5, 1.0, 0.25, 0.5, 0.25)
"""Largest steps of the rounds over all views after some were left out, as shares of those of `pointwise.moved`."""

SINGLE_SCALES = (1.0, 0.5, 0.25)
"""The same where each view is moved for itself."""

_POSES = 48  # that a view is compared with in a round
_ASKED = 6  # poses of them that the arm is asked about, the best first
_TOGETHER = 12  # one view of so many is left out at a time
_HOPELESS = 2.0  # times the gain of two rounds: where more than that is missing, a search is given up


@dataclass(frozen=True, slots=True, eq=False)
class ViewState(Value):
    """Views where they stand by now.

    Attributes:
        T_object_scanner: (n, 4, 4) viewpoints [m].
        distance: (n,) to the point that each is aimed at [m].
        origin: (n,) which of the views given each comes from.
        moved: (n,) whether it stands elsewhere than that.
        measured: (S, n) which rows it measures.
    """

    T_object_scanner: Annotated[Floats, "n 4 4"]
    distance: Annotated[Floats, "n"]
    origin: Annotated[Ints, "n"]
    moved: Annotated[Bools, "n"]
    measured: Annotated[Bools, "S n"]

    def __len__(self) -> int:
        return len(self.origin)

    def pick(self, which: Ints) -> "ViewState":
        """Some of them."""
        return ViewState(
            self.T_object_scanner[which], self.distance[which], self.origin[which], self.moved[which],
            self.measured[:, which],
        )  # fmt: skip

    def at(self, view: int, T_object_scanner: Floats, measured: Bools) -> "ViewState":
        """With one view elsewhere: its pose (4, 4) [m] and the (S,) rows that it measures there."""
        T, rows, elsewhere = self.T_object_scanner.copy(), self.measured.copy(), self.moved.copy()
        T[view], rows[:, view], elsewhere[view] = T_object_scanner, measured, True
        return ViewState(T, self.distance, self.origin, elsewhere, rows)


def reduce_views(
    views: ViewState,
    targets: RayTargets,
    areas: Floats,
    arm_of: Callable[[int], ViewEvaluator],
    *,
    goal: float,
    short: Callable[[ViewState], float],
    work: int = EFFORT,
) -> ViewState:
    """As few views as moving them allows.

    Args:
        views: that do; which of them are left out and moved is up to the search.
        targets: the S rows.
        areas: (S,) that each row stands for, in any unit; 0 where it does not count.
        arm_of: for each of the views given its scanner and what that can take up: of several set-ups each has its own.
        goal: area of rows that has to be measured, in the unit of `areas`.
        short: asked of views that measure so much: by how much more they should, 0 or less where they do.
        work: poses that are looked at.

    Returns:
        The views; those given where none of them can be left out.
    """
    search = _Search(targets, areas, arm_of, work)
    count = max(1, len(views) // _TOGETHER)
    while count and len(views) > count:
        found = search.restored(views.pick(search.needed_most(views, len(views) - count)), goal, short)
        views, count = (views, count // 2) if found is None else (found, count)
    return views


def improve_views(
    T_object_scanner: Floats, distance: Floats, targets: RayTargets, areas: Floats, arm: ViewEvaluator
) -> tuple[Floats, Bools]:
    """Viewpoints, each where it measures a larger area whatever the others measure, or where it was.

    Args:
        T_object_scanner: (n, 4, 4) where each begins [m].
        distance: (n,) to the point that it is aimed at [m].
        targets: the S rows.
        areas: (S,) that each row stands for, in any unit; 0 where it does not count.
        arm: the scanner and what it can take up.

    Returns:
        (n, 4, 4) and (n,) which of them moved.
    """
    n, rows = len(distance), arm.measured(T_object_scanner, targets, np.arange(len(targets)))
    views = ViewState(T_object_scanner, distance, np.arange(n), np.zeros(n, dtype=np.bool_), rows)
    found = [_Search(targets, areas, lambda _: arm).alone(views.pick(np.array([view]))) for view in range(n)]
    T = np.array([view.T_object_scanner[0] for view in found]).reshape(-1, 4, 4)
    return T, np.array([view.moved[0] for view in found], dtype=np.bool_)


class _Search:
    """Moves views, and counts the poses."""

    def __init__(
        self, targets: RayTargets, areas: Floats, arm_of: Callable[[int], ViewEvaluator], work: int = 0
    ) -> None:
        self.targets, self.areas, self.arm_of, self.left, self.rounds = targets, areas, arm_of, work, 0

    def needed_most(self, views: ViewState, count: int) -> Ints:
        """So many views, ascending: the one that measures least that no other does leaves, again and again."""
        stays, times = np.arange(len(views)), views.measured.sum(axis=1)
        while len(stays) > count:
            once = np.flatnonzero(times == 1)
            owner = views.measured[np.ix_(once, stays)].argmax(axis=1)
            least = int(np.argmin(np.bincount(owner, self.areas[once], len(stays))))
            times = times - views.measured[:, stays[least]]
            stays = np.delete(stays, least)
        return stays

    def restored(self, views: ViewState, goal: float, short: Callable[[ViewState], float]) -> ViewState | None:
        """Views moved until they measure enough; None where they do not come to it."""
        known = [self._covered(views)]
        for scale in SCALES:
            if self.left <= 0:
                return None
            views = self._round(views, scale)
            known.append(self._covered(views))
            if known[-1] >= goal:
                lacks = short(views)
                if lacks <= 0:
                    return views
                goal = known[-1] + lacks
            if len(known) > 2 and goal - known[-1] > _HOPELESS * (known[-1] - known[-3]):
                return None
        return None

    def alone(self, view: ViewState) -> ViewState:
        """One view where it measures more."""
        for scale in SINGLE_SCALES:
            view = self._better(view, 0, scale)
            self.rounds += 1
        return view

    def _covered(self, views: ViewState) -> float:
        return float(self.areas[views.measured.any(axis=1)].sum())

    def _round(self, views: ViewState, scale: float) -> ViewState:
        """Each view once, the others staying where they are."""
        for view in range(len(views)):
            views = self._better(views, view, scale)
        self.left -= _POSES * len(views)
        self.rounds += 1
        return views

    def _better(self, views: ViewState, view: int, scale: float) -> ViewState:
        """One view where it measures more of what no other does."""
        others = np.delete(views.measured, view, axis=1).any(axis=1)
        rows = np.flatnonzero(~others & (self.areas > 0))
        area, arm = self.areas[rows], self.arm_of(int(views.origin[view]))
        now = float(area[views.measured[rows, view]].sum())
        stretch = (self.rounds * _POSES, (self.rounds + 1) * _POSES)
        T = perturb_pose(views.T_object_scanner[view], float(views.distance[view]), scale, stretch, view)
        more = now * (1 + 1e-9)
        there = area @ arm.measured(T, self.targets, rows, (area, more))
        best = np.argsort(-there, kind="stable")[:_ASKED]
        best = best[there[best] > more]
        for some in (best[:1], best[1:]):  # mostly the first will do
            taken = some[arm.are_reachable(T[some, None] @ arm.T_view_scanner)] if len(some) else some
            if len(taken):
                break
        else:
            return views
        pose = T[taken[0]]
        measured = arm.measured(pose[None], self.targets, np.arange(len(self.targets)))[:, 0]
        return views.at(view, pose, measured)

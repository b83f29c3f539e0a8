"""Refine views over all six degrees of freedom, so that fewer views measure as much.

Candidates are drawn before the selection is known. After the selection, each view is needed only for the rows that no
other view measures. `reduce_views` removes the least needed views and moves the others until nothing is
missing: each view in turn moves to the pose that measures the largest area that no other view measures, with all
others fixed; then all of them again with other steps. The measured area never falls. It is a pattern search (Kolda,
Lewis, Torczon 2003, doi:10.1137/S003614450242889) whose steps are ranges of the sequence of `pose_sampling`: nothing is
random, and the effort is counted in poses. `improve_views` does the same for views that do not share the surface. Every
kept pose measures by the same rules as a candidate and is reachable. Object frame, metres.
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
"""Poses that are evaluated in all: one to two seconds of processor time."""

SCALES = (1.0, 0.5, 1.0, 0.25, 0.5, 0.25)
"""Largest steps of the rounds over all views after some were left out, as shares of those of `perturb_pose`."""

SINGLE_SCALES = (1.0, 0.5, 0.25)
"""The same for views that are refined one by one."""

_POSES = 48  # alternatives of a view in a round
_TESTED = 6  # best alternatives that are tested for reachability
_VIEWS_PER_REMOVAL = 12  # one view of this many is left out at a time
_HOPELESS = 2.0  # a search ends if more than this many times the gain of two rounds is missing


@dataclass(frozen=True, slots=True, eq=False)
class ViewState(Value):
    """Current poses of n views.

    Attributes:
        T_object_scanner: (n, 4, 4) viewpoints [m].
        distance: (n,) to the point at which each is aimed [m].
        origin: (n,) number of the initial view.
        moved: (n,) whether the pose differs from the initial one.
        measured: (S, n) whether each view measures each row.
    """

    T_object_scanner: Annotated[Floats, "n 4 4"]
    distance: Annotated[Floats, "n"]
    origin: Annotated[Ints, "n"]
    moved: Annotated[Bools, "n"]
    measured: Annotated[Bools, "S n"]

    def __len__(self) -> int:
        return len(self.origin)

    def pick(self, which: Ints) -> "ViewState":
        """Return some of the views."""
        T, measured = self.T_object_scanner[which], self.measured[:, which]
        return ViewState(T, self.distance[which], self.origin[which], self.moved[which], measured)

    def at(self, view: int, T_object_scanner: Floats, measured: Bools) -> "ViewState":
        """Return the state with one view at another pose (4, 4) [m], which measures the rows `measured` (S,)."""
        T, rows, moved = self.T_object_scanner.copy(), self.measured.copy(), self.moved.copy()
        T[view], rows[:, view], moved[view] = T_object_scanner, measured, True
        return ViewState(T, self.distance, self.origin, moved, rows)


def reduce_views(
    views: ViewState,
    targets: RayTargets,
    areas: Floats,
    evaluator_of: Callable[[int], ViewEvaluator],
    *,
    goal: float,
    shortfall: Callable[[ViewState], float],
    effort: int = EFFORT,
) -> ViewState:
    """Return as few views as refinement allows, or the given ones if none can be left out.

    Args:
        views: initial views, which reach the goal.
        targets: the S rows.
        areas: (S,) area of each row in any unit; 0 if it does not count.
        evaluator_of: scanner, occluders and reachability of each initial view; set-ups differ in them.
        goal: required area of measured rows, in the unit of `areas`.
        shortfall: called for views that reach the goal: additional area that they still need, at most 0 if none.
        effort: largest number of poses that are evaluated.
    """
    search = _Search(targets, areas, evaluator_of, effort)
    count = max(1, len(views) // _VIEWS_PER_REMOVAL)
    while count and len(views) > count:
        found = search.restored(views.pick(search.needed_most(views, len(views) - count)), goal, shortfall)
        views, count = (views, count // 2) if found is None else (found, count)
    return views


def improve_views(
    T_object_scanner: Floats, distance: Floats, targets: RayTargets, areas: Floats, evaluator: ViewEvaluator
) -> tuple[Floats, Bools]:
    """Move each viewpoint to a pose that measures a larger area, regardless of the others, or keep it.

    Args:
        T_object_scanner: (n, 4, 4) initial viewpoints [m].
        distance: (n,) to the point at which each is aimed [m].
        targets: the S rows.
        areas: (S,) area of each row in any unit; 0 if it does not count.
        evaluator: scanner, occluders and reachability.

    Returns:
        (n, 4, 4) viewpoints and (n,) whether each moved.
    """
    n, rows = len(distance), evaluator.measured(T_object_scanner, targets, np.arange(len(targets)))
    views = ViewState(T_object_scanner, distance, np.arange(n), np.zeros(n, dtype=np.bool_), rows)
    found = [_Search(targets, areas, lambda _: evaluator).alone(views.pick(np.array([view]))) for view in range(n)]
    T = np.array([view.T_object_scanner[0] for view in found]).reshape(-1, 4, 4)
    return T, np.array([view.moved[0] for view in found], dtype=np.bool_)


class _Search:
    """Moves views and counts the evaluated poses."""

    def __init__(
        self, targets: RayTargets, areas: Floats, evaluator_of: Callable[[int], ViewEvaluator], effort: int = 0
    ) -> None:
        self.targets, self.areas, self.evaluator_of = targets, areas, evaluator_of
        self.effort_left, self.rounds = effort, 0

    def needed_most(self, views: ViewState, count: int) -> Ints:
        """Return `count` views, ascending: repeatedly drop the one with the smallest area that no other measures."""
        kept, times = np.arange(len(views)), views.measured.sum(axis=1)
        while len(kept) > count:
            once = np.flatnonzero(times == 1)
            owner = views.measured[np.ix_(once, kept)].argmax(axis=1)
            least = int(np.argmin(np.bincount(owner, self.areas[once], len(kept))))
            times = times - views.measured[:, kept[least]]
            kept = np.delete(kept, least)
        return kept

    def restored(self, views: ViewState, goal: float, shortfall: Callable[[ViewState], float]) -> ViewState | None:
        """Move views until they reach the goal; return None if they do not."""
        areas = [self._measured_area(views)]
        for scale in SCALES:
            if self.effort_left <= 0:
                return None
            for view in range(len(views)):
                views = self._improve(views, view, scale)
            self.effort_left -= _POSES * len(views)
            self.rounds += 1
            areas.append(self._measured_area(views))
            if areas[-1] >= goal:
                missing = shortfall(views)
                if missing <= 0:
                    return views
                goal = areas[-1] + missing
            if len(areas) > 2 and goal - areas[-1] > _HOPELESS * (areas[-1] - areas[-3]):
                return None
        return None

    def alone(self, view: ViewState) -> ViewState:
        """Refine a single view."""
        for scale in SINGLE_SCALES:
            view = self._improve(view, 0, scale)
            self.rounds += 1
        return view

    def _measured_area(self, views: ViewState) -> float:
        return float(self.areas[views.measured.any(axis=1)].sum())

    def _improve(self, views: ViewState, view: int, scale: float) -> ViewState:
        """Move one view to a pose that measures more of what no other view measures, if one is found."""
        others = np.delete(views.measured, view, axis=1).any(axis=1)
        rows = np.flatnonzero(~others & (self.areas > 0))
        area, evaluator = self.areas[rows], self.evaluator_of(int(views.origin[view]))
        now = float(area[views.measured[rows, view]].sum())
        elements = (self.rounds * _POSES, (self.rounds + 1) * _POSES)
        T = perturb_pose(views.T_object_scanner[view], float(views.distance[view]), scale, elements, view)
        threshold = now * (1 + 1e-9)
        there = area @ evaluator.measured(T, self.targets, rows, (area, threshold))
        best = np.argsort(-there, kind="stable")[:_TESTED]
        best = best[there[best] > threshold]
        for some in (best[:1], best[1:]):  # the first one is reachable in most cases
            reachable = some[evaluator.are_reachable(T[some, None] @ evaluator.T_view_scanner)] if len(some) else some
            if len(reachable):
                pose = T[reachable[0]]
                measured = evaluator.measured(pose[None], self.targets, np.arange(len(self.targets)))[:, 0]
                return views.at(view, pose, measured)
        return views

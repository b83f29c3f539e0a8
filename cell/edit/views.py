"""What an edit makes of the views of a plan: which candidates they are then, poses that were none appended.

A candidate keeps its number: a pose that is a candidate already is that candidate, another becomes a row behind the
last. Object frame, metres, radians.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cell.edit.options import Edit, Pose
from cell.errors import UsageError
from cell.runs.cell import scene_of_run
from cell.runs.run import Run
from cell.scene.model import pose
from planner.values import Floats
from planner.viewpoints.viewpoints import Viewpoints, aim_viewpoints, join_viewpoints, pick_viewpoints

SAME = 1e-9
"""Poses whose entries differ by no more are one pose [m, and entries of rotations]."""


@dataclass(frozen=True, slots=True, eq=False)
class EditedViews:
    """The views after an edit.

    Attributes:
        views: their candidates: those that are kept in visiting order, then what is added.
        called: what each is called in sentences, by candidate.
        order: candidates in the order in which they are visited, others where they cost least; None: in any order.
        dropped: candidates that were views and are to be none.
        appended: candidates that there were not, one pose each; they have the numbers after the last.
    """

    views: tuple[int, ...]
    called: Mapping[int, str]
    order: tuple[int, ...] | None
    dropped: tuple[int, ...]
    appended: Viewpoints

    def without(self, candidates: Collection[int]) -> "EditedViews":
        """These views but for some, which are dropped."""
        views = tuple(view for view in self.views if view not in candidates)
        order = None if self.order is None else tuple(view for view in self.order if view not in candidates)
        return replace(self, views=views, order=order, dropped=(*self.dropped, *candidates))


class _Numbering:
    """Candidates with those that are appended on the way."""

    def __init__(self, known: Viewpoints) -> None:
        self._known, self._n = known, len(known)
        self.all = known

    @property
    def appended(self) -> Viewpoints:
        return pick_viewpoints(self.all, np.arange(self._n, len(self.all)))

    def of(self, T: Floats, face: int, standoff: float) -> int:
        """The candidate at a (4, 4) pose, appended where there is none."""
        apart = np.abs(self.all.T_object_scanner[:, 0] - T).max(axis=(1, 2))
        if (apart <= SAME).any():
            return int(apart.argmin())
        outward = -T[:3, 2]
        upright = aim_viewpoints(
            (T[:3, 3] - standoff * outward)[None], outward[None], np.array([face]), [standoff], [0.0]
        )
        x, y = upright.T_object_scanner[0, 0, :3, :2].T @ T[:3, 0]
        one = Viewpoints(
            T[None, None], np.array([face], dtype=np.int32), np.array([standoff]), np.array([np.arctan2(y, x)])
        )
        self.all = join_viewpoints([self.all, one])
        return len(self.all) - 1


def require_repairable(run: Run) -> None:
    """Refuse to repair a plan that was not asked for a coverage of its own.

    Raises:
        UsageError: with what to do instead.
    """
    if scene_of_run(run).plan.max_views is not None:
        raise UsageError(
            f"{run.folder} was asked for the most coverage with a number of views: there is no coverage to restore; "
            "leave repair out, or plan with a coverage"
        )
    if run.report.open_of is not None:
        raise UsageError(
            f"{run.folder} was asked only for what other set-ups leave open, and a repair would ask for the rest as "
            "well; leave repair out, or plan it again with open_of"
        )
    if run.is_setup_of_group:
        raise UsageError(
            f"{run.folder} is one of several set-ups, of which coverage was asked together, and a repair would ask "
            "it of this one alone; leave repair out, or plan the set-ups again with the candidates banned"
        )


def edited_views(
    edit: Edit, views: Sequence[int], known: Viewpoints, T_base_view: Callable[[Pose], Floats],
    standoff: Callable[[Floats], float],
) -> EditedViews:  # fmt: skip
    """Apply an edit to the views of a plan.

    Args:
        edit: what is asked for.
        views: candidates of the plan in visiting order.
        known: all candidates, one pose each (of a sweep the viewpoint that it is made about).
        T_base_view: the (4, 4) pose of a viewpoint, object frame, for a pose that a user gave.
        standoff: distance from the source at a (4, 4) pose to what it is aimed at [m].

    Raises:
        UsageError: if the edit names what is not there, takes a view twice, or leaves none.
    """
    check(edit, len(views), len(known))
    numbering, now = _Numbering(known), dict[int, int]()
    changed: dict[int, Floats] = {move.view: T_base_view(move.pose) for move in edit.move}
    for turn in edit.turn:
        changed[turn.view] = known.T_object_scanner[views[turn.view - 1], 0] @ pose((0, 0, 0), (turn.angle, 0, 0))
    turned = {turn.view for turn in edit.turn}
    for number, candidate in enumerate(views, start=1):
        if number in edit.drop:
            continue
        T = changed.get(number)
        if T is None:
            now[number] = candidate
        elif number in turned:
            now[number] = numbering.of(T, int(known.face[candidate]), float(known.standoff[candidate]))
        else:
            now[number] = numbering.of(T, -1, standoff(T))
    called = {candidate: f"view {number}" for number, candidate in now.items()}
    added = {candidate: f"candidate {candidate}" for candidate in edit.add_candidate}
    poses = [numbering.of(T, -1, standoff(T)) for T in map(T_base_view, edit.add_pose)]
    now |= enumerate([*edit.add_candidate, *poses], start=len(views) + 1)
    called = added | {candidate: f"added pose {k}" for k, candidate in enumerate(poses, start=1)} | called
    taken: dict[int, int] = {}
    for number, candidate in now.items():
        if candidate in taken:
            raise UsageError(f"view {number} would be the same pose as view {taken[candidate]}; leave one of them out")
        taken[candidate] = number
    return EditedViews(
        views=tuple(now.values()),
        called=called,
        order=_order(edit, now, len(views)),
        dropped=tuple(candidate for candidate in views if candidate not in taken),
        appended=numbering.appended,
    )


def check(edit: Edit, n: int, candidates: int) -> None:
    """Refuse an edit that names what is not there.

    Args:
        edit: what is asked for.
        n: views of the plan.
        candidates: of the plan.

    Raises:
        UsageError: with what there is.
    """
    asked = {"drop": edit.drop, "move": [each.view for each in edit.move], "turn": [each.view for each in edit.turn]}
    for key, numbers in asked.items():
        if wrong := [number for number in numbers if number > n]:
            raise UsageError(f"{key} names view {wrong[0]}; the plan has the views 1 to {n}")
    if wrong := [candidate for candidate in edit.add_candidate if candidate >= candidates]:
        raise UsageError(f"there is no candidate {wrong[0]} to add; there are candidates 0 to {candidates - 1}")
    now = [number for number in range(1, n + 1) if number not in edit.drop]
    now += range(n + 1, n + 1 + len(edit.add_candidate) + len(edit.add_pose))
    if not now:
        raise UsageError("the edit leaves no view; keep at least one")
    if edit.order and sorted(edit.order) != now:
        missing, extra = sorted({*now} - {*edit.order}), sorted({*edit.order} - {*now})
        wrong_order = f"leaves out {_listed(missing)}" if missing else f"names {_listed(extra)}"
        raise UsageError(f"the order {wrong_order}; it must name each of the views {_listed(now)} once")


def _listed(numbers: Sequence[int]) -> str:
    return ", ".join(map(str, numbers))


def _order(edit: Edit, now: Mapping[int, int], n: int) -> tuple[int, ...] | None:
    """Candidates in the order that is asked for."""
    if edit.keep_order:
        return tuple(candidate for number, candidate in now.items() if number <= n)
    return tuple(now[number] for number in edit.order) or None

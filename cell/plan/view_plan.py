"""Steps 6 to 8: choose views, connect them by a motion, refuse those that cannot be, and choose again.

A view is refused where no path leads to it, or where its sweep cannot be driven; a view that its own arm shades is
taken with other joint solutions, or measures less than the cover counted on. Views at rest and views that sweep differ
in what is looked at (`cell.plan.views_at_rest`, `cell.plan.sweeping_views`), not in the loop.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from cell.errors import SceneError, UnreachableError
from cell.plan import finer_angles, view_exchange
from cell.plan.connected_plan import ConnectedPlan, DroppedView
from cell.plan.problem import PinnedOutError, Problem
from cell.plan.request import Request, Selected, select
from cell.plan.sweeping_views import SweepingViews
from cell.plan.views import Groups, Next, Views
from cell.plan.views_at_rest import ViewsAtRest
from planner.cover import Cover, CoverStatus
from planner.cover.overlap import OverlapGraph
from planner.measurability.coverage import coverage_of_views
from planner.ports import Progress
from planner.tour import tour
from planner.tour.generalised_tsp import MANY_CLUSTERS
from planner.tour.orderings import Ordering, fixed_order, order_views, overlapping_order
from planner.tour.tour import Tour, TourStatus
from planner.tour.view_times import least_home_time
from planner.tour.visits import Visits


@dataclass(frozen=True, slots=True, eq=False)
class _Connected:
    """A motion through one candidate of each group."""

    groups: Groups
    motion: Tour


@dataclass(frozen=True, slots=True)
class _Again:
    """What comes next where chosen views could not be connected as they are, which are refused, and who was visited."""

    next: Next
    refused: Mapping[int, str] = field(default_factory=dict)
    visited: tuple[int, ...] = ()


def first_choice(
    problem: Problem, rng: np.random.Generator, *, looked: Selected | None = None, look: int = 0
) -> Selected:
    """Views that answer the request before any motion is known, for `choose_and_connect`.

    Args:
        problem: candidates, cell and wishes.
        rng: randomness of the selection.
        looked: the answer of a look at the same, or with fewer samples; it is searched on from there.
        look: work of a search that is enough, and whose views may miss what is asked for; 0: the views of a plan.

    Raises:
        UnreachableError: if no view measures anything.
    """
    return _choose(problem, _views_of(problem), {}, rng, looked=looked, look=look)


def choose_and_connect(
    problem: Problem,
    selected: Selected,
    *,
    selection_rng: np.random.Generator,
    motion_rng: np.random.Generator,
    progress: Progress | None = None,
) -> ConnectedPlan:
    """Choose the views and the motion through them.

    Args:
        problem: candidates, cell and wishes.
        selected: the first choice of views.
        selection_rng: randomness of the selection.
        motion_rng: randomness of order and paths.
        progress: told about the edges of the tour as they become real.

    Raises:
        SceneError: if home itself is nearer to something than the clearance.
        UnreachableError: if no view that measures anything can be connected, or a pinned one cannot.
    """
    views = _views_of(problem)
    refused: dict[int, str] = {}
    before: tuple[int, ...] = ()
    while isinstance(found := _connect(problem, views, selected, refused, before, motion_rng, progress), _Again):
        refused |= _not_pinned(found.refused, problem.request)
        before = found.visited or before
        if found.next is Next.CHOOSE:
            selected = _choose(problem, views, refused, selection_rng)
    found = _at_finer_angles(problem, views, selected, found, motion_rng)
    return _plan(problem, views, selected, refused, found)


def _views_of(problem: Problem) -> Views:
    return ViewsAtRest(problem) if problem.at_rest else SweepingViews(problem)


def _choose(
    problem: Problem,
    views: Views,
    refused: Mapping[int, str],
    rng: np.random.Generator,
    *,
    looked: Selected | None = None,
    look: int = 0,
) -> Selected:
    """Views that answer the request as far as is known by now."""
    selected = select(
        problem.request, views.M, problem.reached, problem.candidates, problem.prediction,
        banned=tuple(refused), rng=rng, looked=looked, look=look,
    )  # fmt: skip
    if not len(selected.cover.views):
        told = [f"candidate {view}: {reason}" for view, reason in {**refused, **views.shaded}.items()]
        why = "; ".join(told[:_TOLD] + ([f"and {len(told) - _TOLD} more"] if len(told) > _TOLD else []))
        raise UnreachableError(
            "no view is left that measures the part and can be reached by a free motion"
            + (f" ({why})" if why else "")
            + "; change the placement, the standoff or the fixtures"
        )
    return selected


def _connect(
    problem: Problem,
    views: Views,
    selected: Selected,
    refused: Collection[int],
    before: tuple[int, ...],
    rng: np.random.Generator,
    progress: Progress | None,
) -> _Connected | _Again:
    """Try to connect the chosen views: the shorter motion of two, through them and through those that may stand in.

    The motion is searched for from the candidates that the last try visited, in their order.
    """
    chosen = selected.cover.views
    if not views.still_measure(chosen):  # a first look, before a motion is planned for nothing
        return _Again(Next.CHOOSE)
    if lost := views.refusals(chosen):
        return _Again(Next.CHOOSE, lost)
    groups = views.groups(selected, problem.usable(refused), rng)
    motion = _motion(problem, views, selected, groups, before, rng, progress)
    # Detours may have cost what the exchange saved; and a motion that leaves views out is short for that alone.
    standing, least = problem.request.standing, (groups, motion)
    while groups.exchanged:
        seconds = motion.duration + standing * len(groups.members)
        spare = (
            _DETOURS * motion.duration if len(groups.members) > MANY_CLUSTERS and problem.request.costs is None else 0.0
        )
        if not motion.dropped and seconds - spare <= groups.straight_before:
            break
        groups = groups.instead or views.alone(chosen)
        motion = _motion(problem, views, selected, groups, before, rng, progress)
        least = view_exchange.shorter(least, (groups, motion), standing)
    groups, motion = least
    if motion.status is TourStatus.HOME_IN_COLLISION:
        raise SceneError(
            f"home is nearer than the clearance to something ({motion.home_blocker}); change robot.home_deg, "
            "the placement or the fixtures"
        )
    if motion.dropped:
        return _Again(Next.CHOOSE, _unconnected(groups, motion), _visited(groups, motion))
    found = views.judge(groups.picked(motion), motion)
    return _Connected(groups, motion) if found is Next.DONE else _Again(found, visited=_visited(groups, motion))


def _at_finer_angles(
    problem: Problem, views: Views, selected: Selected, found: _Connected, rng: np.random.Generator
) -> _Connected:
    """The motion, or a shorter one at angles of a rotary table between those of the scene, where no leg is a detour."""
    brief = replace(problem.request.motion, guesses=problem.request.motion.guesses[:1], polish=0)
    problem = replace(problem, request=replace(problem.request, motion=brief))
    for shares in finer_angles.STEPS:
        if found.motion.detour.any() or (groups := views.finer(found.groups, found.motion, shares)) is None:
            return found
        motion = _motion(problem, views, selected, groups, _visited(found.groups, found.motion), rng, None)
        shorter = not motion.dropped and motion.duration < found.motion.duration * (1 - 1e-9)
        # Other solutions at the scene's angles are nodes as well, at which nobody looked at the arm.
        if shorter and views.hides_no_more(groups.views, found.motion, motion):
            found = _Connected(groups, motion)
    return found


def _visited(groups: Groups, motion: Tour) -> tuple[int, ...]:
    """The candidates of a motion in visiting order."""
    return tuple(groups.picked(motion)[motion.order].tolist())


def _motion(
    problem: Problem,
    views: Views,
    selected: Selected,
    groups: Groups,
    before: tuple[int, ...],
    rng: np.random.Generator,
    progress: Progress | None,
) -> Tour:
    """The motion through one candidate of each group."""
    world = problem.world
    group = {int(candidate): k for k, members in enumerate(groups.members) for candidate in members}
    visits = Visits(
        groups.configurations,
        world.home,
        T_base_scanner=world.T_base_object @ problem.candidates.T_object_scanner[groups.views, 0],
        T_base_home=problem.kinematics.forward(world.home[None])[0] @ world.T_flange_scanner,
        traversals=views.traversals(groups.views),
        known=tuple(dict.fromkeys(group[c] for c in before or groups.visited if c in group)),
    )
    ordering = _ordering(problem.request, selected)
    return tour.plan_tour(
        visits, problem.checker, problem.limits, rng, problem.request.motion, progress, ordering=ordering
    )


def _plan(
    problem: Problem, views: Views, selected: Selected, refused: Mapping[int, str], found: _Connected
) -> ConnectedPlan:
    """The plan of connected views."""
    cover, motion = view_exchange.settled(selected.cover, views.M, found.motion, found.groups.picked(found.motion))
    if problem.request.costs is not None:
        cover = _priced(problem, selected, cover, motion)
    driven = views.driven(cover.views, motion)
    T_part_flange = problem.kinematics.forward(motion.q)  # with a table turned back
    T_base_flange = problem.world.in_base(motion.q, T_part_flange)
    T_base_scanner = T_base_flange @ problem.world.T_flange_scanner
    return ConnectedPlan(
        cover=cover,
        selected=selected,
        matrix=views.M,
        tour=motion,
        candidate=cover.views[motion.order],
        T_object_scanner=np.linalg.inv(problem.world.T_base_object) @ T_part_flange @ problem.world.T_flange_scanner,
        T_base_scanner=T_base_scanner,
        T_base_flange=T_base_flange,
        T_object_poses=driven.T_object_poses,
        sweeps=driven.sweeps,
        lines=driven.lines,
        dropped=tuple(
            DroppedView(view, reason)
            for view, reason in {**refused, **views.shaded}.items()
            if view not in cover.views  # a view that its arm shades in part may be in the plan with what is left of it
        ),
        seen=driven.seen,
        visible=coverage_of_views(driven.seen, problem.prediction.samples),
        visible_with_arm=driven.visible_with_arm,
    )


def _priced(problem: Problem, selected: Selected, cover: Cover, motion: Tour) -> Cover:
    """The cover at the seconds of its views and their motion, with the bound on both."""
    seconds = motion.duration + problem.request.standing * len(cover.views)
    share = least_home_time(problem.reached.q, problem.world.home, problem.limits) if problem.at_rest else 0.0
    bound = min(selected.cost_bound + share, seconds)
    status = CoverStatus.BOUNDED if cover.status is CoverStatus.PROVEN else cover.status
    return replace(
        cover, cost_and_bound=(seconds, bound), status=CoverStatus.PROVEN if seconds <= bound * (1.0 + 1e-9) else status
    )


def _unconnected(groups: Groups, motion: Tour) -> dict[int, str]:
    """Candidates of the groups that a motion leaves out, with the reason."""
    return {
        view: lost.reason.sentence + (f" ({lost.blocker})" if lost.blocker else "")
        for lost in motion.dropped
        for view in groups.members[lost.view].tolist()
    }


def _not_pinned(lost: Mapping[int, str], request: Request) -> Mapping[int, str]:
    """The candidates that cannot be part of a motion, none of which the user asked for.

    Raises:
        PinnedOutError: if one of them is pinned.
    """
    for view, reason in lost.items():
        if view in request.plan.pinned:
            raise PinnedOutError(view, reason)
    return lost


_DETOURS = 0.02  # share that collisions lengthen a motion through many views by: whether the exchange saved them or not
_TOLD = 3  # candidates whose reasons are given when none is left


def _ordering(request: Request, selected: Selected) -> Ordering:
    """How the views are ordered: as they are told, by time alone, or so that each overlaps an earlier one as well."""
    if request.order is not None:
        return fixed_order([int(np.flatnonzero(selected.cover.views == candidate)[0]) for candidate in request.order])
    if request.plan.overlap_in_order and isinstance(selected.answer, OverlapGraph):
        return overlapping_order(selected.answer.adjacent)
    return order_views

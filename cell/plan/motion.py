"""Motion through selected views: connect them, reject views without a motion, and select again.

A view is rejected if no path leads to it, or if its sweep cannot be driven. A view that is occluded by its own arm is
taken in other configurations, or measures less than the cover assumed (`cell.world.self_occlusion`). Views at rest and
sweeping views differ in the checks (`ViewsAtRest`, `SweepingViews`), not in the loop. Base frame, metres, radians.
"""

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from types import MappingProxyType
from typing import Annotated

import numpy as np

from cell.errors import SceneError
from cell.plan.improvement import EquivalentViews, cover_of_motion, shorter_motion, single_views, swap_views
from cell.plan.selection import PinnedViewError, Request, Selection, SelectionProblem, select_views
from cell.world.self_occlusion import OcclusionUpdate, SelfOcclusion, arm_caster, coverage_with_arm
from planner.cover import Cover, CoverStatus
from planner.cover.overlap import OverlapGraph
from planner.kinematics.rotary_table import ArmOnTable
from planner.kinematics.setpoints import from_steps, setpoints, to_steps
from planner.measurability.coverage import Coverage, coverage_of_views
from planner.measurability.matrix import Measurability
from planner.path.sweep_line import DEFAULT_SPEED
from planner.path.sweeps import DrivableSweeps, SweepPath, SweepTraversal, TimedSweep, find_sweeps, sweep_traversals
from planner.ports import ARM_AXES, Progress, no_progress
from planner.timing.motion import TimedLine
from planner.tour import tour
from planner.tour.generalised_tsp import MANY_CLUSTERS
from planner.tour.orderings import Ordering, fixed_order, order_views, overlapping_order
from planner.tour.tour import Tour, TourStatus
from planner.tour.tour_search import MotionBudget
from planner.tour.view_times import least_home_time
from planner.tour.visits import Visits
from planner.values import Bools, Floats, Ints, Value

TABLE_STEPS = (1 / 2, 1 / 4), (1 / 8, 1 / 16)
"""Shares of the step between the table angles of the scene that are tried to either side of a view, in two rounds."""

_DETOUR_SHARE = 0.02  # share by which collisions lengthen a motion through many views, with or without swaps


@dataclass(frozen=True, slots=True)
class DroppedView:
    """A candidate that was selected and is not in the plan, with the reason in one sentence."""

    candidate: int
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class DrivenViews(Value):
    """Views of a motion as they are driven, in visiting order.

    Attributes:
        T_object_poses: (n, K, 4, 4) poses of the rounded joint angles [m].
        seen: (S, n) whether each view measures each held-out sample.
        visible_with_arm: visible coverage with each view's own arm as an occluder, fraction of the surface; None for
            sweeps: the arm's shadow along a sweep is not evaluated.
        sweeps: sweeps; none for views at rest.
        lines: timing of the sweeps, by the via point at which each begins.
    """

    T_object_poses: Annotated[Floats, "n _ 4 4"]
    seen: Annotated[Bools, "S n"]
    visible_with_arm: float | None
    sweeps: tuple[SweepPath, ...] = ()
    lines: Mapping[int, TimedLine] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class ConnectedPlan(Value):
    """Selected views with the motion through them.

    Attributes:
        cover: views in order of their marginal area.
        selection: answer to the request, before views were swapped.
        matrix: measurability as the arm leaves it, on which the cover was solved.
        tour: motion; its views are indices into `cover.views`.
        candidate: (n,) candidates in visiting order.
        T_object_scanner: (n, 4, 4) poses of the rounded joint angles through forward kinematics [m], visiting order.
        T_base_scanner: (n, 4, 4) the same in base [m].
        T_base_flange: (n, 4, 4) the same of the flange [m].
        driven: all poses of each view (of a sweep `T_object_scanner` is the middle one), sweeps, measured samples.
        dropped: candidates that could not be connected, or that the arm shades.
        visible: visible coverage of the views on the held-out samples.
        searched: result of the pose search, a sentence; "" without one.
    """

    cover: Cover
    selection: Selection
    matrix: Measurability
    tour: Tour
    candidate: Annotated[Ints, "n"]
    T_object_scanner: Annotated[Floats, "n 4 4"]
    T_base_scanner: Annotated[Floats, "n 4 4"]
    T_base_flange: Annotated[Floats, "n 4 4"]
    driven: DrivenViews
    dropped: tuple[DroppedView, ...]
    visible: Coverage
    searched: str = ""

    @property
    def target(self) -> float:
        """Target share of the coverable samples of the matrix."""
        return self.selection.target

    @property
    def via_candidate(self) -> Ints:
        """(N,) candidate taken at each via point of the tour, -1 where none is."""
        at = self.tour.view
        return np.where(at >= 0, self.cover.views[np.maximum(at, 0)], -1)


class NextAction(Enum):
    """Result of an attempt to connect selected views."""

    FINISH = "every selected view is connected"
    CONNECT = "some views have fewer configurations now: connect them again"
    SELECT = "views were rejected, or measure less now: select again"


class ViewConnector(ABC):
    """Checks of candidates of one kind between selection and motion (`ViewsAtRest`, `SweepingViews`).

    Attributes:
        problem: candidates, cell and request.
        shaded: candidates whose arm hides samples, each with a sentence.
    """

    shaded: Mapping[int, str] = MappingProxyType({})

    def __init__(self, problem: SelectionProblem) -> None:
        self.problem = problem

    @property
    def M(self) -> Measurability:
        """Current measurability; it shrinks where an arm shades its own view."""
        return self.problem.M

    @abstractmethod
    def check(self, views: Ints) -> tuple[NextAction, Mapping[int, str]]:
        """Check (n,) selected candidates before a motion is planned; return the rejected ones with their reasons."""

    def groups(self, selection: Selection, usable: Bools, rng: np.random.Generator) -> EquivalentViews:
        """Return the candidates that the motion may pick for each view of the cover."""
        return self.alone(selection.cover.views)

    @abstractmethod
    def alone(self, views: Ints) -> EquivalentViews:
        """Return each of (n,) candidates in a group of its own."""

    def traversals(self, views: Ints) -> list[list[SweepTraversal]] | None:
        """Return the sweeps at each configuration of (n,) candidates; None for views at rest."""
        return None

    def check_motion(self, views: Ints, motion: Tour) -> NextAction:
        """Check a motion through all of (n,) candidates."""
        return NextAction.FINISH

    def between_table_angles(
        self, groups: EquivalentViews, motion: Tour, shares: Sequence[float]
    ) -> EquivalentViews | None:
        """Return the views of a motion with configurations at further table angles; None without a table."""
        return None

    def occludes_no_more(self, views: Ints, before: Tour, motion: Tour) -> bool:
        """Return whether the arm hides nothing at (n,) candidates that it showed in another motion through them."""
        return True

    @abstractmethod
    def driven(self, views: Ints, motion: Tour) -> DrivenViews:
        """Return the views as they are driven; the motion's views are indices into (n,) `views`."""


class ViewsAtRest(ViewConnector):
    """Candidates at which the arm stands still; see `ViewConnector`.

    Arm, bracket and housing occlude as well, differently in every configuration. A view that is occluded by its own arm
    is taken in other configurations. If all of them shade it, views are selected again with what the arm leaves of it.
    """

    def __init__(self, problem: SelectionProblem) -> None:
        super().__init__(problem)
        self._arm = SelfOcclusion(
            problem.M, problem.reached, problem.candidates, problem.world, problem.prediction.scanner
        )

    @property
    def M(self) -> Measurability:
        """Measurability as the arms leave it."""
        return self._arm.M

    @property
    def shaded(self) -> Mapping[int, str]:  # type: ignore[override]  # it grows with the attempts
        """Candidates occluded by their own arm, each with a sentence."""
        return self._arm.reasons

    def check(self, views: Ints) -> tuple[NextAction, Mapping[int, str]]:
        """Check the arm at the first configuration of each view; only missing paths reject a view at rest."""
        first = np.stack([self._arm.configurations(int(view))[0] for view in views])
        measures_less = self._arm.update(views, first) is OcclusionUpdate.LESS_MEASURED
        return NextAction.SELECT if measures_less else NextAction.CONNECT, {}

    def groups(self, selection: Selection, usable: Bools, rng: np.random.Generator) -> EquivalentViews:
        """Return each view with its alternatives, if the request allows swaps."""
        if not self.problem.request.allows_swaps:
            return self.alone(selection.cover.views)
        return swap_views(self.problem, self._arm, selection, usable, rng)

    def alone(self, views: Ints) -> EquivalentViews:
        """Return each view in a group of its own."""
        return EquivalentViews.of(self._arm, single_views(views))

    def check_motion(self, views: Ints, motion: Tour) -> NextAction:
        """Check the arm at the stops of the motion."""
        match self._arm.update(views[motion.order], motion.q):
            case OcclusionUpdate.CLEAR:
                return NextAction.FINISH
            case OcclusionUpdate.OTHER_CONFIGURATIONS:
                return NextAction.CONNECT
            case _:
                return NextAction.SELECT

    def between_table_angles(
        self, groups: EquivalentViews, motion: Tour, shares: Sequence[float]
    ) -> EquivalentViews | None:
        """Return the views with further configurations at table angles between those of the scene.

        A candidate is fixed to the part. Turning the table changes its configuration, not its measured samples, as long
        as the arm hides no more. Configurations of the same branch a little to either side of the current angle are
        added to each view.
        """
        chain = self.problem.cell.kinematics
        if not isinstance(chain, ArmOnTable):
            return None
        step = 2 * np.pi / self.problem.world.scene.table.angles
        aside = step * np.concatenate([shares, np.negative(shares)])
        picks, configurations_of = groups.picked_by(motion), []
        for view, q in sorted(zip(motion.order.tolist(), motion.q, strict=True), key=lambda stop: stop[0]):
            configurations = groups.configurations[view][groups.owner[view] == picks[view]]
            configurations_of.append(
                np.concatenate([configurations, self._configurations_beside(chain, int(picks[view]), q, aside)])
            )
        return EquivalentViews(
            single_views(picks),
            tuple(np.full(len(q), pick) for q, pick in zip(configurations_of, picks, strict=True)),
            tuple(configurations_of),
        )

    def _configurations_beside(self, chain: ArmOnTable, view: int, q: Floats, aside: Floats) -> Floats:
        """Return (m, 7) free configurations nearest to q (7,) with the table (n,) aside that hide no more [rad]."""
        problem, world = self.problem, self.problem.world
        T_part_scanner = world.T_base_object @ problem.candidates.T_object_scanner[view, 0]
        angles = from_steps(to_steps(q[ARM_AXES] + aside))
        branches = chain.inverse_at(T_part_scanner @ np.linalg.inv(world.T_flange_scanner), angles)
        solved = setpoints(branches, chain.limits)
        nearest = []
        for side in range(len(angles)):
            configurations = solved.q[solved.pose == side]
            if len(configurations):
                nearest.append(configurations[np.argmin(np.abs(configurations - q).max(axis=1))])
        near = np.array(nearest).reshape(-1, len(q))
        near = near[problem.cell.checker.free(near)]
        return near[self._arm.occludes_no_more(view, q, near)] if len(near) else near

    def occludes_no_more(self, views: Ints, before: Tour, motion: Tour) -> bool:
        """Return whether the arm hides nothing at (n,) candidates that it showed in the motion before."""
        q_before = dict(zip(before.order.tolist(), before.q, strict=True))
        stops = zip(motion.order.tolist(), motion.q, strict=True)
        return all(self._arm.occludes_no_more(int(views[k]), q_before[k], q[None])[0] for k, q in stops)

    def driven(self, views: Ints, motion: Tour) -> DrivenViews:
        """Return the stops, and the samples that they measure with the arm as an occluder."""
        world, prediction = self.problem.world, self.problem.prediction
        T_base_flange = self.problem.cell.kinematics.forward(motion.q)
        T_object_scanner = np.linalg.inv(world.T_base_object) @ T_base_flange @ world.T_flange_scanner
        poses = T_object_scanner[:, None]
        seen = prediction.seen(poses)
        visible = coverage_of_views(seen, prediction.samples)
        arms = [arm_caster(world, q, T, prediction.scanner) for q, T in zip(motion.q, T_object_scanner, strict=True)]
        is_near = any(caster is not None for caster in arms)
        with_arm = coverage_with_arm(prediction, poses, arms, visible.covered) if is_near else visible.fraction
        return DrivenViews(poses, seen, with_arm)


class SweepingViews(ViewConnector):
    """Candidates of several poses, each driven as a line; see `ViewConnector`.

    Reach knows whether every pose of a column can be reached. Here the line through all of them must be drivable on one
    joint branch (`planner.path.sweeps`). The sweeps of each candidate are computed once. None is swapped, because a
    sweep ends at another pose than it begins at. The arm's shadow is not evaluated, and no table turns a swept part.
    """

    def __init__(self, problem: SelectionProblem) -> None:
        super().__init__(problem)
        self._speed = DEFAULT_SPEED.slowed(problem.limits, problem.world.limits)
        self._found: dict[int, DrivableSweeps] = {}

    def check(self, views: Ints) -> tuple[NextAction, Mapping[int, str]]:
        """Reject candidates whose sweep cannot be driven; the most frequent reasons come first."""
        rejected = {}
        for view in views.tolist():
            sweeps = self._sweeps(view)
            if not sweeps.paths:
                reasons = Counter(refused.sentence for refused in sweeps.refused)
                common = "; ".join(reason for reason, _ in reasons.most_common(2))
                rejected[view] = f"its sweep cannot be driven: {common}"
        return NextAction.SELECT if rejected else NextAction.CONNECT, rejected

    def alone(self, views: Ints) -> EquivalentViews:
        """Return each view in a group of its own; its configurations are the beginnings of its sweeps."""
        paths = [self._sweeps(int(view)).paths for view in views]
        return EquivalentViews(
            single_views(views),
            tuple(np.full(len(view_paths), view) for view, view_paths in zip(views, paths, strict=True)),
            tuple(np.stack([path.q[0] for path in view_paths]) for view_paths in paths),
        )

    def traversals(self, views: Ints) -> list[list[SweepTraversal]]:
        """Return the sweeps of each view as the motion takes them."""
        return [sweep_traversals(self._sweeps(int(view)).paths) for view in views]

    def driven(self, views: Ints, motion: Tour) -> DrivenViews:
        """Return the sweeps of a motion with their poses and timing."""
        world, kinematics = self.problem.world, self.problem.cell.kinematics
        choices = zip(motion.order.tolist(), motion.choice.tolist(), strict=True)
        sweeps = tuple(self._sweeps(int(views[view])).paths[choice] for view, choice in choices)
        q = np.stack([path.measured_q for path in sweeps])
        T_base_scanner = kinematics.forward(q.reshape(-1, ARM_AXES)) @ world.T_flange_scanner
        poses = (np.linalg.inv(world.T_base_object) @ T_base_scanner).reshape(*q.shape[:2], 4, 4)
        entered = zip(motion.entered.tolist(), sweeps, strict=True)
        lines = {row: TimedSweep(path, world.T_flange_scanner, kinematics) for row, path in entered}
        return DrivenViews(poses, self.problem.prediction.seen(poses), None, sweeps, lines)

    def _sweeps(self, view: int) -> DrivableSweeps:
        if view not in self._found:
            problem, world = self.problem, self.problem.world
            column = world.T_base_object @ problem.candidates.T_object_scanner[view]
            self._found[view] = find_sweeps(
                column, world.T_flange_scanner, problem.cell.kinematics, problem.limits, self._speed,
                problem.cell.checker,
            )  # fmt: skip
        return self._found[view]


@dataclass(frozen=True, slots=True, eq=False)
class _Connected:
    """Motion through one candidate of each group."""

    groups: EquivalentViews
    motion: Tour


@dataclass(frozen=True, slots=True)
class _Retry:
    """Next action if views could not be connected, with the rejected and the visited candidates."""

    action: NextAction
    rejected: Mapping[int, str] = field(default_factory=dict)
    visited: tuple[int, ...] = ()


def connect_views(
    problem: SelectionProblem,
    selection: Selection,
    *,
    selection_rng: np.random.Generator,
    motion_rng: np.random.Generator,
    progress: Progress = no_progress,
) -> ConnectedPlan:
    """Plan a motion through selected views; select again without views that cannot be connected.

    Args:
        problem: candidates, cell and request.
        selection: first selection.
        selection_rng: randomness of further selections.
        motion_rng: randomness of tour and paths.
        progress: called with (edges of the tour checked, edges).

    Raises:
        SceneError: if home is nearer to an object than the clearance.
        UnreachableError: if no view that measures anything can be connected, or a pinned one cannot.
    """
    views: ViewConnector = ViewsAtRest(problem) if problem.is_at_rest else SweepingViews(problem)
    rejected: dict[int, str] = {}
    before: tuple[int, ...] = ()
    while isinstance(outcome := _try_to_connect(views, selection, rejected, before, motion_rng, progress), _Retry):
        for view, reason in outcome.rejected.items():
            if view in problem.request.plan.pinned:
                raise PinnedViewError(view, reason)
        rejected |= outcome.rejected
        before = outcome.visited or before
        if outcome.action is NextAction.SELECT:
            selection = select_views(problem, selection_rng, M=views.M, rejected=rejected, shaded=views.shaded)
    outcome = _between_table_angles(views, selection, outcome, motion_rng)
    return _connected_plan(views, selection, rejected, outcome)


def _try_to_connect(
    views: ViewConnector,
    selection: Selection,
    rejected: Collection[int],
    before: tuple[int, ...],
    rng: np.random.Generator,
    progress: Progress,
) -> _Connected | _Retry:
    """Plan the shorter of two motions: through the selected views, and through their alternatives.

    The search begins with the candidates that the last attempt visited, in their order.
    """
    problem, selected = views.problem, selection.cover.views
    action, rejections = views.check(selected)
    if action is NextAction.SELECT:
        return _Retry(action, rejections)
    groups = views.groups(selection, problem.usable(rejected), rng)
    motion = _plan_motion(views, selection, groups, before, rng, problem.request.motion, progress)
    # Detours may cost more than the swaps save, and a motion without some views is shorter for that reason.
    dwell, best = problem.request.dwell_s, (groups, motion)
    while groups.has_swaps:
        seconds = motion.duration + dwell * len(groups.members)
        tolerates_detours = len(groups.members) > MANY_CLUSTERS and problem.request.costs is None
        spare = _DETOUR_SHARE * motion.duration if tolerates_detours else 0.0
        if not motion.dropped and seconds - spare <= groups.straight_before:
            break
        groups = groups.fallback or views.alone(selected)
        motion = _plan_motion(views, selection, groups, before, rng, problem.request.motion, progress)
        best = shorter_motion(best, (groups, motion), dwell)
    groups, motion = best
    if motion.status is TourStatus.HOME_IN_COLLISION:
        raise SceneError(
            f"home is nearer than the clearance to an object ({motion.home_blocker}); change robot.home_deg, the "
            "placement or the fixtures"
        )
    if motion.dropped:
        unconnected = {
            candidate: exclusion.reason.sentence + (f" ({exclusion.blocker})" if exclusion.blocker else "")
            for exclusion in motion.dropped
            for candidate in groups.members[exclusion.view].tolist()
        }
        return _Retry(NextAction.SELECT, unconnected, groups.visited_by(motion))
    action = views.check_motion(groups.picked_by(motion), motion)
    if action is NextAction.FINISH:
        return _Connected(groups, motion)
    return _Retry(action, visited=groups.visited_by(motion))


def _between_table_angles(
    views: ViewConnector, selection: Selection, connection: _Connected, rng: np.random.Generator
) -> _Connected:
    """Shorten a motion without detours by table angles between those of the scene."""
    budget = views.problem.request.motion
    short = replace(budget, guesses=budget.guesses[:1], polish=0)
    for shares in TABLE_STEPS:
        if connection.motion.detour.any():
            return connection
        groups = views.between_table_angles(connection.groups, connection.motion, shares)
        if groups is None:
            return connection
        before = connection.groups.visited_by(connection.motion)
        motion = _plan_motion(views, selection, groups, before, rng, short)
        is_shorter = not motion.dropped and motion.duration < connection.motion.duration * (1 - 1e-9)
        # Other configurations at the angles of the scene are nodes as well; the arm was not checked there.
        if is_shorter and views.occludes_no_more(groups.views, connection.motion, motion):
            connection = _Connected(groups, motion)
    return connection


def _plan_motion(
    views: ViewConnector,
    selection: Selection,
    groups: EquivalentViews,
    before: tuple[int, ...],
    rng: np.random.Generator,
    budget: MotionBudget,
    progress: Progress = no_progress,
) -> Tour:
    """Plan the motion through one candidate of each group."""
    problem, world = views.problem, views.problem.world
    group_of = {int(candidate): k for k, members in enumerate(groups.members) for candidate in members}
    visits = Visits(
        groups.configurations,
        world.home,
        T_base_scanner=world.T_base_object @ problem.candidates.T_object_scanner[groups.views, 0],
        T_base_home=problem.cell.kinematics.forward(world.home[None])[0] @ world.T_flange_scanner,
        traversals=views.traversals(groups.views),
        known=tuple(dict.fromkeys(group_of[c] for c in before or groups.visited if c in group_of)),
    )
    ordering = _ordering(problem.request, selection)
    budget = budget.scaled(problem.request.effort.motion_share)
    return tour.plan_tour(visits, problem.cell.checker, problem.limits, rng, budget, progress, ordering=ordering)


def _ordering(request: Request, selection: Selection) -> Ordering:
    """Return the rule of the order: given, by time alone, or so that each view overlaps an earlier one."""
    if request.order is not None:
        views = selection.cover.views
        return fixed_order([int(np.flatnonzero(views == candidate)[0]) for candidate in request.order])
    if request.plan.overlap_in_order and isinstance(selection.details, OverlapGraph):
        return overlapping_order(selection.details.adjacent)
    return order_views


def _connected_plan(
    views: ViewConnector, selection: Selection, rejected: Mapping[int, str], connection: _Connected
) -> ConnectedPlan:
    problem = views.problem
    world, kinematics = problem.world, problem.cell.kinematics
    cover, motion = cover_of_motion(
        selection.cover, views.M, connection.motion, connection.groups.picked_by(connection.motion)
    )
    if problem.request.costs is not None:
        cover = _with_cost(problem, selection, cover, motion)
    driven = views.driven(cover.views, motion)
    T_part_flange = kinematics.forward(motion.q)  # with a table turned back
    T_base_flange = world.in_base(motion.q, T_part_flange)
    return ConnectedPlan(
        cover=cover,
        selection=selection,
        matrix=views.M,
        tour=motion,
        candidate=cover.views[motion.order],
        T_object_scanner=np.linalg.inv(world.T_base_object) @ T_part_flange @ world.T_flange_scanner,
        T_base_scanner=T_base_flange @ world.T_flange_scanner,
        T_base_flange=T_base_flange,
        driven=driven,
        dropped=tuple(
            DroppedView(view, reason)
            for view, reason in {**rejected, **views.shaded}.items()
            if view not in cover.views  # a partly shaded view may be in the plan with the samples that are left of it
        ),
        visible=coverage_of_views(driven.seen, problem.prediction.samples),
    )


def _with_cost(problem: SelectionProblem, selection: Selection, cover: Cover, motion: Tour) -> Cover:
    """Return the cover with the seconds of its views and their motion, and the bound on both."""
    seconds = motion.duration + problem.request.dwell_s * len(cover.views)
    share = least_home_time(problem.reached.q, problem.world.home, problem.limits) if problem.is_at_rest else 0.0
    bound = min(selection.cost_bound + share, seconds)
    status = CoverStatus.BOUNDED if cover.status is CoverStatus.PROVEN else cover.status
    return replace(
        cover, cost_and_bound=(seconds, bound), status=CoverStatus.PROVEN if seconds <= bound * (1.0 + 1e-9) else status
    )

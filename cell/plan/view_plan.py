"""Steps 6 to 8: choose views, order them, connect them; a view that cannot be connected is replaced or given up.

Arm, bracket and housing hide as well, differently at every configuration: a view that its own arm shades (cell/
self_shading.py) is taken with other joint solutions; where all of them do it, the cover is solved again with what they
leave of the view.

The views are selected as the request says (request.py beside). The views are ordered and connected; a view to
which no path is found is banned and the cover is solved again without it, until every view of the plan is connected.

Before that, views are exchanged for others that measure as much and make the motion shorter (view_exchange.py beside);
views that sweep are not: where their motion ends is not where it begins.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cell.errors import SceneError, UnreachableError
from cell.plan import view_exchange
from cell.plan.request import Request, Selected, select
from cell.plan.sweep_solutions import SweepSolutions
from cell.rays.prediction import Prediction
from cell.rays.self_shading import Look, OwnArm, arm_caster, visible_with_arm
from cell.world.world import World
from planner.cover import Cover
from planner.cover.overlap import OverlapCover
from planner.measurability.coverage import Coverage
from planner.measurability.matrix import Measurability
from planner.order.order_overlap import overlapping
from planner.order.orderings import Ordering
from planner.order.tour import Tour, TourStatus, plan_motion
from planner.path.sweeps.path import SweepPath
from planner.ports import CollisionChecker, Floats, JointLimits, Kinematics, Progress
from planner.reach.reach import Reach
from planner.timing.motion import TimedLine
from planner.values import readonly
from planner.viewpoints.viewpoints import Viewpoints


@dataclass(frozen=True, slots=True)
class DroppedView:
    """A candidate that was chosen and is not in the plan: it could not be connected, or its own arm shades it.

    Attributes:
        candidate: row of the viewpoints.
        reason: one sentence.
    """

    candidate: int
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class ConnectedPlan:
    """Chosen views with the motion through them.

    Attributes:
        cover: the selection, in order of the area that each view adds.
        selected: the answer to the request, before views were exchanged.
        matrix: measurability as the arm leaves it: what the cover was solved on.
        tour: the motion; its views are indices into `cover.views`.
        candidate: (n,) candidates in visiting order.
        T_object_scanner: (n, 4, 4) poses of the rounded joint angles through forward kinematics [m], visiting order.
        T_base_scanner: (n, 4, 4) the same in base [m].
        T_base_flange: (n, 4, 4) the same of the flange [m].
        T_object_poses: (n, K, 4, 4) all poses of each view; of a sweep `T_object_scanner` is the middle one.
        sweeps: the sweeps that are driven, in visiting order; none for views at rest.
        lines: their timing, by the via point at which each begins.
        dropped: candidates that could not be connected, or that the arm shades.
        visible: visible coverage of the views on the held-out samples.
        visible_with_arm: visible coverage where each view's own arm hides as well, fraction of the surface; None for
            views that sweep: the arm's shadow along a sweep is not judged.
    """

    cover: Cover
    selected: Selected
    matrix: Measurability
    tour: Tour
    candidate: NDArray[np.int64]
    T_object_scanner: Floats
    T_base_scanner: Floats
    T_base_flange: Floats
    T_object_poses: Floats
    sweeps: tuple[SweepPath, ...]
    lines: Mapping[int, TimedLine]
    dropped: tuple[DroppedView, ...]
    visible: Coverage
    visible_with_arm: float | None

    def __post_init__(self) -> None:
        n = len(self.candidate)
        object.__setattr__(self, "candidate", readonly("candidate", self.candidate, (n,), np.int64))
        for name in ("T_object_scanner", "T_base_scanner", "T_base_flange"):
            object.__setattr__(self, name, readonly(name, getattr(self, name), (n, 4, 4)))
        object.__setattr__(self, "T_object_poses", readonly("T_object_poses", self.T_object_poses, (n, None, 4, 4)))

    @property
    def target(self) -> float:
        """Share of the coverable samples of the matrix that was asked of the cover."""
        return self.selected.target

    @property
    def via_candidate(self) -> NDArray[np.int64]:
        """(N,) candidate taken at each via point of the tour, -1 where none is."""
        at = self.tour.view
        return np.where(at >= 0, self.cover.views[np.maximum(at, 0)], -1)


def select_and_connect(
    M: Measurability,
    reached: Reach,
    candidates: Viewpoints,
    world: World,
    limits: JointLimits,
    kinematics: Kinematics,
    checker: CollisionChecker,
    prediction: Prediction,
    *,
    request: Request,
    selection_rng: np.random.Generator,
    motion_rng: np.random.Generator,
    progress: Progress | None = None,
) -> ConnectedPlan:
    """Choose the views and the motion through them.

    Args:
        M: measurability with occluders applied.
        reached: reachable candidates and their joint solutions.
        candidates: the columns of M.
        world: placement, mount and home.
        limits: limits of the axes, scaled to the speed that is wanted.
        kinematics: of the arm.
        checker: of the cell.
        prediction: held-out samples, on which a coverage below 1 is kept.
        request: what is asked for.
        selection_rng: randomness of the selection.
        motion_rng: randomness of order and paths.
        progress: told about the edges of the tour as they become real.

    Raises:
        SceneError: if home itself is nearer to something than the clearance.
        UnreachableError: if no view that measures anything can be connected, or a pinned one cannot.
    """
    banned: dict[int, str] = {}
    arm = OwnArm(M, reached, candidates, world, prediction.scanner)
    at_rest = candidates.T_object_scanner.shape[1] == 1
    sweeping = None if at_rest else SweepSolutions(candidates, world, kinematics, checker, limits)

    def connect(groups: view_exchange.Groups) -> Tour:
        return plan_motion(
            groups.configurations,
            world.home,
            checker,
            limits,
            world.T_base_object @ candidates.T_object_scanner[groups.views, 0],
            motion_rng,
            progress=progress,
            ordering=_ordering(request, selected),
            T_base_home=kinematics.forward(world.home[None])[0] @ world.T_flange_scanner,
            passages=None if sweeping is None else sweeping.passages(groups.views),
            measure=False,  # the pipeline proves the clearance of the motion that is kept
        )

    stale = True
    while True:
        if stale:
            selected = select(request, arm.M, reached, candidates, prediction, banned=tuple(banned), rng=selection_rng)
            chosen = selected.cover
            stale = False
        if not len(chosen.views):
            told = [f"candidate {view}: {reason}" for view, reason in (banned | arm.reasons).items()]
            why = "; ".join(told[:_TOLD] + ([f"and {len(told) - _TOLD} more"] if len(told) > _TOLD else []))
            raise UnreachableError(
                "no view is left that measures the part and can be reached by a free motion"
                + (f" ({why})" if why else "")
                + "; change the placement, the standoff or the fixtures"
            )
        if at_rest:  # a first look, before a motion is planned for nothing
            first = np.stack([arm.configurations(int(view))[0] for view in chosen.views])
            stale = arm.look(chosen.views, first) is Look.LESS_MEASURED
            if stale:
                continue
        if sweeping is not None and (refused := sweeping.refusals(chosen.views.tolist())):
            _require_not_pinned(refused, request)
            banned |= refused
            stale = True
            continue
        usable = np.asarray(reached.reachable).copy()
        usable[[*banned, *request.plan.banned]] = False
        groups = (
            view_exchange.groups(
                arm,
                chosen,
                usable,
                candidates,
                prediction,
                world.home,
                limits,
                coverage=request.plan.coverage,
                target=selected.target,
                rng=motion_rng,
            )
            if at_rest and request.exchangeable
            else view_exchange.alone(arm, chosen.views)
            if sweeping is None
            else sweeping.groups(chosen.views)
        )
        motion = connect(groups)
        exchanged = np.isfinite(groups.straight_before)
        # Detours may have cost what the exchange saved; and a motion that leaves views out is short for that alone.
        if exchanged and (motion.dropped or motion.duration > groups.straight_before):
            own = view_exchange.alone(arm, chosen.views)
            groups, motion = view_exchange.shorter((groups, motion), (own, connect(own)))
        if motion.status is TourStatus.HOME_IN_COLLISION:
            raise SceneError(
                f"home is nearer than the clearance to something ({motion.home_blocker}); change robot.home_deg, "
                "the placement or the fixtures"
            )
        for lost in motion.dropped:
            blocker = f" ({lost.blocker})" if lost.blocker else ""
            unconnected = {view: lost.reason.sentence + blocker for view in groups.members[lost.view].tolist()}
            _require_not_pinned(unconnected, request)
            banned |= unconnected
        if motion.dropped:
            stale = True
            continue
        picks = groups.picked(motion)
        stops = picks[motion.order]
        shade = arm.look(stops, motion.q) if at_rest else Look.CLEAR
        if shade is Look.CLEAR:
            break
        stale = shade is Look.LESS_MEASURED
    chosen, motion = view_exchange.settled(chosen, arm.M, motion, picks)
    T_base_flange = kinematics.forward(motion.q)
    T_object_scanner = np.linalg.inv(world.T_base_object) @ T_base_flange @ world.T_flange_scanner
    driven = () if sweeping is None else sweeping.driven(chosen.views, motion)
    T_object_poses = T_object_scanner[:, None] if sweeping is None else sweeping.poses(driven)
    visible = prediction.visible(T_object_poses)
    with_arm = None
    if at_rest:
        poses = zip(motion.q, T_object_scanner, strict=True)
        arms = [arm_caster(world, q, T, prediction.scanner) for q, T in poses]
        near = any(caster is not None for caster in arms)
        with_arm = visible_with_arm(prediction, T_object_poses, arms) if near else visible.fraction
    return ConnectedPlan(
        cover=chosen,
        selected=selected,
        matrix=arm.M,
        tour=motion,
        candidate=chosen.views[motion.order],
        T_object_scanner=T_object_scanner,
        T_base_scanner=T_base_flange @ world.T_flange_scanner,
        T_base_flange=T_base_flange,
        dropped=tuple(
            DroppedView(view, reason)
            for view, reason in (banned | arm.reasons).items()
            if view not in chosen.views  # a view that its arm shades in part may be in the plan with what is left of it
        ),
        T_object_poses=T_object_poses,
        sweeps=driven,
        lines={} if sweeping is None else sweeping.lines(driven, motion),
        visible=visible,
        visible_with_arm=with_arm,
    )


def _require_not_pinned(lost: Mapping[int, str], request: Request) -> None:
    """Refuse to plan without a view that was asked for.

    Raises:
        UnreachableError: if one of the candidates that cannot be part of a motion is pinned.
    """
    for view, reason in lost.items():
        if view in request.plan.pinned:
            raise UnreachableError(
                f"candidate {view} is pinned and cannot be part of a motion: {reason}; pin another, or change the "
                "placement"
            )


_TOLD = 3  # candidates whose reasons are given when none is left


def _ordering(request: Request, selected: Selected) -> str | Ordering:
    """How the views are ordered: by time alone, or so that each overlaps an earlier one as well."""
    if request.plan.overlap_in_order and isinstance(selected.answer, OverlapCover):
        return overlapping(selected.answer.joined)
    return "joint-space"

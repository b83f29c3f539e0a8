"""Edited plans: views are changed by hand, and the result is a new run made by the stages of the pipeline.

Cell, candidates, reach and matrix are read from the files of the run, bit for bit. A candidate keeps its number: a pose
that is a candidate already is that candidate, another pose is appended behind the last one. Own arm, motion, clearance,
timing and coverage are computed again. If the placement changes, the views move with the part. In the part's own frame
candidates, samples and lines of sight past the part stay the same; reach and occlusion by the surroundings are computed
again for every candidate. Object frame, metres, radians.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from cell import scanners
from cell.errors import UnreachableError, UsageError
from cell.formatting import comma_list
from cell.part.workpiece import Workpiece
from cell.plan import files, pipeline
from cell.plan.candidates import (
    Cell,
    MeasuredSet,
    PlanSession,
    append_viewpoints,
    limited_scanner,
    reach_viewpoints,
    unreachable_reason,
)
from cell.plan.edit_options import Edit, Pose
from cell.plan.evaluation import Verdict, judge_plan
from cell.plan.motion import ConnectedPlan
from cell.plan.selection import PinnedViewError, SelectionProblem
from cell.runs.cell import scene_of_run, with_placement
from cell.runs.run import Run
from cell.runs.schema import Report
from cell.scene.model import PlanSettings, pose
from cell.scene.settle import SettledScene
from cell.session import Session
from cell.world.measurability import PartSurface
from cell.world.prediction import Prediction, held_out_samples
from planner.cover import CoverStatus
from planner.kinematics import reach
from planner.kinematics.reach import Reach, join_reach
from planner.ports import ARM_AXES
from planner.values import Bools, Floats
from planner.viewpoints.viewpoints import Viewpoints, aim_viewpoints

SAME_POSE = 1e-9
"""Largest difference of the entries of equal poses [m, and entries of rotations]."""

_ROUNDING = 1e-9  # of shares that are summed in another order
_REPAIR = "--repair adds the fewest views that restore it"


@dataclass(frozen=True, slots=True, eq=False)
class EditedViews:
    """Views after an edit.

    Attributes:
        views: candidates: kept ones in visiting order, then added ones.
        names: of the views in sentences, by candidate.
        order: candidates in visiting order, others are inserted where they cost least; None: any order.
        dropped: candidates that were views and are none now.
        appended: new candidates, one pose each; they are numbered after the last candidate.
    """

    views: tuple[int, ...]
    names: Mapping[int, str]
    order: tuple[int, ...] | None
    dropped: tuple[int, ...]
    appended: Viewpoints

    def without(self, candidates: Collection[int]) -> "EditedViews":
        """Return these views without some candidates, which are dropped."""
        views = tuple(view for view in self.views if view not in candidates)
        order = None if self.order is None else tuple(view for view in self.order if view not in candidates)
        return replace(self, views=views, order=order, dropped=(*self.dropped, *candidates))


@dataclass(frozen=True, slots=True, eq=False)
class Neighbourhood:
    """Poses near dropped or banned views, in which no other view is added.

    Attributes:
        T_object_view: (n, 4, 4) poses of these views [m].
        distance: between positions [m].
        angle: between viewing axes [rad]; a view that is turned about its axis sees the same from the same place.
    """

    T_object_view: Floats
    distance: float
    angle: float

    def contains(self, T_object_view: Floats) -> Bools:
        """Return (m,) whether each of (m, 4, 4) poses is near one of the views; these are themselves."""
        apart = np.linalg.norm(T_object_view[:, None, :3, 3] - self.T_object_view[None, :, :3, 3], axis=2)
        cosine = np.einsum("mi,ni->mn", T_object_view[:, :3, 2], self.T_object_view[:, :3, 2])
        is_near = (apart <= self.distance + SAME_POSE) & (cosine >= np.cos(self.angle) - SAME_POSE)
        if self.distance == self.angle == 0:
            difference = np.abs(T_object_view[:, None] - self.T_object_view[None]).max(axis=(2, 3))
            is_near = difference <= SAME_POSE
        return np.asarray(is_near.any(axis=1))


class _Numbering:
    """Candidates with those that are appended by an edit."""

    def __init__(self, known: Viewpoints) -> None:
        self._n_known = len(known)
        self.all = known

    @property
    def appended(self) -> Viewpoints:
        return self.all.pick(np.arange(self._n_known, len(self.all)))

    def number_of(self, T: Floats, face: int, standoff: float) -> int:
        """Return the candidate at a (4, 4) pose; append it if there is none."""
        difference = np.abs(self.all.T_object_scanner[:, 0] - T).max(axis=(1, 2))
        if (difference <= SAME_POSE).any():
            return int(difference.argmin())
        outward = -T[:3, 2]
        upright = aim_viewpoints(
            (T[:3, 3] - standoff * outward)[None], outward[None], np.array([face]), [standoff], [0.0]
        )
        x, y = upright.T_object_scanner[0, 0, :3, :2].T @ T[:3, 0]
        one = Viewpoints(
            T[None, None], np.array([face], dtype=np.int32), np.array([standoff]), np.array([np.arctan2(y, x)])
        )
        self.all = Viewpoints.join([self.all, one])
        return len(self.all) - 1


def edit(session: Session[None], run: Run, changes: Edit, *, T_base_object: Floats | None = None) -> Path:
    """Make a new run of an edited plan; see `cell.api.edit`."""
    if changes.repair:
        require_repairable(run)
    check_edit(changes, len(run.candidate), run.report.verdicts.total)
    if changes.table_angle_deg and run.scene.table is None:
        raise UsageError(f"{run.folder} has no rotary table; omit table_angle")
    scene = scene_of_run(run)
    if T_base_object is not None:
        scene = with_placement(scene, T_base_object, run.scene)
    session = replace(session, origin=replace(session.origin, scene_path=run.folder / "scene.toml"))
    opened = None
    try:
        part = Workpiece(run.scene.part.name, run.reference, run.scene.part.sha256)
        with pipeline.open_run(session, scene, part) as opened:
            opened.conclude(_plan(opened.session, opened.settled, run, changes, is_moved=T_base_object is not None))
        return opened.path
    except (UsageError, UnreachableError):  # nothing in the folder explains more than the message
        if opened is not None:
            opened.session.folder.discard()
        raise


def _plan(session: PlanSession, settled: SettledScene, before: Run, changes: Edit, *, is_moved: bool) -> Verdict:
    """Plan the edited views into the open run folder; `is_moved`: the part has another placement than in the run."""
    surface = pipeline.copy_surface(session, settled, before)
    viewpoints, T_scanner_view = scanners.viewpoints_of_columns(settled.scanner, before.candidates)
    if changes.drop:
        settled = _with_bans(session, settled, before, changes, viewpoints)
    cell = pipeline.compile_cell(session, settled, surface)
    edited = _edited(settled, before, changes, cell, surface, (viewpoints, T_scanner_view))
    if is_moved:
        with session.stage("reach") as progress:
            moved = Viewpoints.join([viewpoints, edited.appended])
            candidates = reach_viewpoints(settled, cell, moved, progress)
        measured = pipeline.measure_candidates(session, settled, surface, cell, candidates, may_be_empty=True)
        edited = _still_reachable(session, before, edited, measured.reached, may_leave_out=changes.repair)
    else:
        measured = _measured_before(session, settled, before, cell, surface, edited)
    append = pipeline.appending(session, settled, cell, surface) if changes.repair else None
    near_banned = _near(changes, viewpoints, list(settled.scene.plan.banned))
    pinned = tuple(view for view in settled.scene.plan.pinned if view not in edited.dropped)
    settled = _with_plan(settled, settled.scene.plan.model_copy(update={"pinned": pinned}))
    while True:
        problem = _problem(session, settled, before, changes, cell, measured, edited, is_moved=is_moved)
        try:
            problem, plan = pipeline.select_and_connect(
                session, problem, surface, append, is_allowed=lambda T: ~near_banned.contains(T)
            )
            break
        except PinnedViewError as error:
            edited = _without(session, error, edited, may_leave_out=is_moved and changes.repair)
    is_bounded, plan = _with_bound(before, edited, problem, plan, is_moved=is_moved)
    annotations: dict[str, object] = {"part": before.report.part, "common_cover": before.is_setup_of_group or None}
    if not is_bounded:
        status = "Edited by hand; the smallest number of views is not known"
        annotations["status"] = f"{status}. {plan.searched}" if plan.searched else status
    for view in edited.views:
        if not (plan.matrix.indices == view).any():
            session.note(f"{edited.names[view]} measures none of the samples")
    if changes.repair:
        added = [f"{view}" for view in plan.candidate.tolist() if view not in edited.views]
        session.note(f"repaired by adding candidate {', '.join(added)}" if added else "no candidate is added")
    report = pipeline.finish(session, settled, surface.planning, problem, plan, annotations)
    if before.is_setup_of_group:
        session.note(
            "the coverage was requested for several set-ups together; their combined coverage is not known now"
        )
        return Verdict()
    return _judge(report, plan, settled.scene.plan, is_repaired=changes.repair)


def _judge(report: Report, plan: ConnectedPlan, options: PlanSettings, *, is_repaired: bool) -> Verdict:
    """Judge an edited plan; a repair also has to restore a coverage of 1 of the samples of the matrix."""
    has_target = options.max_views is None and options.multiplicity == 1
    has_target &= options.pose_sd_mm == options.pose_sd_deg == 0
    remedy = _REPAIR
    if is_repaired:
        remedy = "plan again, or edit with a smaller --dropped-range" if options.banned else "plan again"
    verdict = judge_plan(report, (remedy, remedy), has_target=has_target)
    share = plan.cover.covered_area / plan.cover.coverable_area
    if is_repaired and has_target and report.regions is None and options.coverage >= 1 > share + _ROUNDING:
        sentence = f"the plan measures {100 * share:.2f} % of the coverable samples, less than the requested 100 %: "
        return Verdict((sentence + remedy, *verdict.missed))
    return verdict


def _with_bans(
    session: PlanSession, settled: SettledScene, before: Run, changes: Edit, viewpoints: Viewpoints
) -> SettledScene:
    """Ban dropped views and the candidates near them, but neither other views nor candidates that the edit adds."""
    dropped = before.candidate[[number - 1 for number in changes.drop]]
    is_near = _near(changes, viewpoints, dropped).contains(viewpoints.T_object_scanner[:, 0])
    is_near[[*np.setdiff1d(before.candidate, dropped), *changes.add_candidate]] = False
    options = settled.scene.plan
    pinned = tuple(view for view in options.pinned if view not in dropped)
    banned = tuple(sorted({*options.banned, *np.flatnonzero(is_near).tolist()} - {*pinned, *changes.add_candidate}))
    if others := int(is_near.sum() - np.isin(dropped, np.flatnonzero(is_near)).sum()):
        session.note(
            f"{others} candidates within {changes.dropped_range_mm:g} mm and {changes.dropped_range_deg:g} deg of a "
            "dropped view are banned; --dropped-range changes this"
        )
    return _with_plan(settled, options.model_copy(update={"pinned": pinned, "banned": banned}))


def _near(changes: Edit, viewpoints: Viewpoints, which: ArrayLike) -> Neighbourhood:
    """Return the poses within the range of the edit around some viewpoints."""
    T = viewpoints.T_object_scanner[np.asarray(which, dtype=np.int64), 0]
    return Neighbourhood(T, changes.dropped_range_mm / 1000, float(np.radians(changes.dropped_range_deg)))


def _with_plan(settled: SettledScene, plan: PlanSettings) -> SettledScene:
    return replace(settled, scene=settled.scene.model_copy(update={"plan": plan}))


def _edited(
    settled: SettledScene, before: Run, changes: Edit, cell: Cell, surface: PartSurface,
    known: tuple[Viewpoints, Floats],
) -> EditedViews:  # fmt: skip
    """Apply the edit; views of a sweeping sensor are named by the middle poses of their sweeps."""
    viewpoints, T_scanner_view = known
    q = np.append(cell.world.home[:ARM_AXES], np.radians(changes.table_angle_deg))
    T_object_base = np.linalg.inv(cell.world.T_base_part(q))

    def T_object_view(values: Pose) -> Floats:
        T: Floats = T_object_base @ pose(values[:3], values[3:]) @ T_scanner_view
        return T

    def standoff(T: Floats) -> float:
        hit = surface.caster.first_hit(T[None, :3, 3], T[None, :3, 2]).distance[0]
        return float(hit) if np.isfinite(hit) else float(np.linalg.norm(T[:3, 3] - settled.part.centre))

    return apply_edit(changes, before.candidate.tolist(), viewpoints, T_object_view, standoff)


def _measured_before(
    session: PlanSession, settled: SettledScene, before: Run, cell: Cell, surface: PartSurface, edited: EditedViews
) -> MeasuredSet:
    """Return the measured candidates of the run, followed by the poses of the edit."""
    with session.stage("held-out samples") as progress:
        candidates, reached = before.candidates, before.reach
        prediction = Prediction.of(
            held_out_samples(surface.reference, surface.planning, session.seed, session.effort.held_out_samples),
            limited_scanner(settled.scene, settled.scanner),
            cell.casters(surface),
            candidates.T_object_scanner[reached.reachable],
            progress,
        )
        measured = MeasuredSet(candidates, reached, before.measurability, prediction)
    if not len(edited.appended):
        _require_reachable(edited, reached)
    else:
        with session.stage("new poses") as progress:
            more = reach_viewpoints(settled, cell, edited.appended, progress)
            _require_reachable(edited, join_reach([reached, more.reached]))
            measured = append_viewpoints(session, settled, surface, measured, more)
    files.write_measured(session.folder, measured)
    return measured


def _require_reachable(edited: EditedViews, reached: Reach) -> None:
    for view in edited.views:
        if not reached.reachable[view]:
            is_view = edited.names[view].startswith("view")
            verb = "" if reached.verdict[view] == reach.Verdict.COLLISION else "it is "
            raise UnreachableError(
                f"{edited.names[view]} cannot be used: {verb}{unreachable_reason(reached, view)}; "
                + ("move it to another pose, or drop it" if is_view else "give another one, or omit it")
            )


def _still_reachable(
    session: PlanSession, before: Run, edited: EditedViews, reached: Reach, *, may_leave_out: bool
) -> EditedViews:
    """Return the views that the arm reaches at the new placement of the part.

    Raises:
        UnreachableError: naming each view that it does not reach, if none may be left out, or none is left.
    """
    reasons = {
        view: f"{edited.names[view]} ({unreachable_reason(reached, view)})"
        for view in edited.views
        if not reached.reachable[view]
    }
    if reasons and (not may_leave_out or len(reasons) == len(edited.views)):
        remedy = "move the part"
        if before.is_repairable:
            remedy = "use --repair to omit them and add the fewest others, or move the part"
        raise UnreachableError(
            f"at the placement of the part now the arm cannot reach {', '.join(reasons.values())}; {remedy}"
        )
    for sentence in reasons.values():
        session.note(f"{sentence} is omitted")
    return edited.without(list(reasons))


def _problem(
    session: PlanSession, settled: SettledScene, before: Run, changes: Edit, cell: Cell, measured: MeasuredSet,
    edited: EditedViews, *, is_moved: bool,
) -> SelectionProblem:  # fmt: skip
    """Request these views; with repair, the fewest additional ones. Unchanged views keep their order."""
    options = settled.scene.plan
    if changes.repair:
        pinned = tuple(dict.fromkeys((*edited.views, *options.pinned)))
        banned = tuple(sorted({*options.banned, *edited.dropped} - {*pinned}))
        options = options.model_copy(update={"pinned": pinned, "banned": banned})
    else:
        options = options.with_views(edited.views, len(measured.reached))
    problem = pipeline.make_problem(session, _with_plan(settled, options), cell, measured)
    is_same = edited.views == tuple(before.candidate.tolist()) and edited.order in (None, edited.views)
    order = edited.views if is_same and not is_moved else edited.order
    return replace(problem, request=replace(problem.request, order=order))


def _without(session: PlanSession, error: PinnedViewError, edited: EditedViews, *, may_leave_out: bool) -> EditedViews:
    """Return the views without one that cannot be part of a motion.

    Raises:
        UnreachableError: if it may not be left out, with the reason.
    """
    name = edited.names.get(error.candidate, f"pinned candidate {error.candidate}")
    if not may_leave_out or error.candidate not in edited.views:
        raise UnreachableError(
            f"{name} cannot be part of a motion: {error.reason}; move it to another pose, or drop it"
        ) from error
    session.note(f"{name} is omitted: it cannot be part of a motion ({error.reason})")
    return edited.without([error.candidate])


def _with_bound(
    before: Run, edited: EditedViews, problem: SelectionProblem, plan: ConnectedPlan, *, is_moved: bool
) -> tuple[bool, ConnectedPlan]:
    """Return whether the run's bound on the number of views still holds, and the plan with it, or with none (1).

    The bound holds if there is one (above 1) and as much was requested of the same candidates: none is new, no pinned
    one is left out, and the area that the run had to cover is covered.
    """
    cover, M, file = plan.cover, plan.matrix, before.plan
    coverable = float(M.samples.areas[M.matrix() @ problem.reached.reachable.astype(np.int32) > 0].sum())
    target = file.coverage.target_on_samples or 1.0
    holds = len(problem.candidates) == len(before.candidates) and cover.covered_area >= (target - _ROUNDING) * coverable
    holds &= not set(edited.dropped) & set(before.scene.plan.pinned)
    holds &= file.lower_bound > 1 or len(cover.views) == 1
    holds &= file.max_coverage is None and problem.request.regions is None and not is_moved
    bound = min(file.lower_bound, len(cover.views)) if holds else 1
    status = CoverStatus.PROVEN if bound == len(cover.views) else CoverStatus.BOUNDED
    cover = replace(cover, lower_bound=bound, status=status, solver="edited", coverable_area=coverable)
    return holds, replace(plan, cover=cover, selection=replace(plan.selection, targets=np.array([target])))


def require_repairable(run: Run) -> None:
    """Refuse to repair a plan without a requested coverage of its own.

    Raises:
        UsageError: with what to do instead.
    """
    if scene_of_run(run).plan.max_views is not None:
        raise UsageError(
            f"{run.folder} was planned for maximum coverage with a number of views, so there is no requested "
            "coverage to restore; omit repair, or plan with a coverage"
        )
    if run.report.further_setup is not None:
        raise UsageError(
            f"{run.folder} was planned for the surface that other set-ups leave uncovered, and a repair would request "
            "the rest as well; omit repair, or plan the set-ups with cell setups"
        )
    if run.is_setup_of_group:
        raise UsageError(
            f"{run.folder} is one of several set-ups with a common coverage, and a repair would request all of it "
            "from this one; omit repair, or plan the set-ups again with the candidates banned"
        )


def apply_edit(
    changes: Edit, views: Sequence[int], known: Viewpoints, T_object_view: Callable[[Pose], Floats],
    standoff: Callable[[Floats], float],
) -> EditedViews:  # fmt: skip
    """Apply an edit to the views of a plan.

    Args:
        changes: of the edit.
        views: candidates of the plan in visiting order.
        known: all candidates, one pose each.
        T_object_view: returns the (4, 4) pose of a viewpoint for a pose that a user gave.
        standoff: returns the distance along the viewing axis of a (4, 4) pose to the part [m].

    Raises:
        UsageError: if the edit names a view or candidate that does not exist, takes a view twice, or leaves none.
    """
    check_edit(changes, len(views), len(known))
    numbering, candidate_of = _Numbering(known), dict[int, int]()
    changed: dict[int, Floats] = {move.view: T_object_view(move.pose) for move in changes.move}
    for turn in changes.turn:
        changed[turn.view] = known.T_object_scanner[views[turn.view - 1], 0] @ pose((0, 0, 0), (turn.angle, 0, 0))
    turned = {turn.view for turn in changes.turn}
    for number, candidate in enumerate(views, start=1):
        if number in changes.drop:
            continue
        T = changed.get(number)
        if T is None:
            candidate_of[number] = candidate
        elif number in turned:
            face, distance = int(known.face[candidate]), float(known.standoff[candidate])
            candidate_of[number] = numbering.number_of(T, face, distance)
        else:
            candidate_of[number] = numbering.number_of(T, -1, standoff(T))
    names = {candidate: f"view {number}" for number, candidate in candidate_of.items()}
    poses = [numbering.number_of(T, -1, standoff(T)) for T in map(T_object_view, changes.add_pose)]
    candidate_of |= enumerate([*changes.add_candidate, *poses], start=len(views) + 1)
    added = {candidate: f"candidate {candidate}" for candidate in changes.add_candidate}
    names = added | {candidate: f"added pose {k}" for k, candidate in enumerate(poses, start=1)} | names
    number_of: dict[int, int] = {}
    for number, candidate in candidate_of.items():
        if candidate in number_of:
            raise UsageError(f"view {number} would have the same pose as view {number_of[candidate]}; omit one of them")
        number_of[candidate] = number
    return EditedViews(
        views=tuple(candidate_of.values()),
        names=names,
        order=_order(changes, candidate_of, len(views)),
        dropped=tuple(candidate for candidate in views if candidate not in number_of),
        appended=numbering.appended,
    )


def check_edit(changes: Edit, n_views: int, n_candidates: int) -> None:
    """Refuse an edit that names a view or candidate that does not exist.

    Raises:
        UsageError: with the existing numbers.
    """
    view_numbers = {
        "drop": changes.drop,
        "move": [each.view for each in changes.move],
        "turn": [each.view for each in changes.turn],
    }
    for key, numbers in view_numbers.items():
        if wrong := [number for number in numbers if number > n_views]:
            raise UsageError(f"{key} names view {wrong[0]}; the plan has the views 1 to {n_views}")
    if wrong := [candidate for candidate in changes.add_candidate if candidate >= n_candidates]:
        raise UsageError(f"there is no candidate {wrong[0]} to add; there are candidates 0 to {n_candidates - 1}")
    views = [number for number in range(1, n_views + 1) if number not in changes.drop]
    views += range(n_views + 1, n_views + 1 + len(changes.add_candidate) + len(changes.add_pose))
    if not views:
        raise UsageError("the edit leaves no view; keep at least one")
    if changes.order and sorted(changes.order) != views:
        missing, extra = sorted({*views} - {*changes.order}), sorted({*changes.order} - {*views})
        problem = f"leaves out {comma_list(missing)}" if missing else f"names {comma_list(extra)}"
        raise UsageError(f"the order {problem}; it must name each of the views {comma_list(views)} once")


def _order(changes: Edit, candidate_of: Mapping[int, int], n_views: int) -> tuple[int, ...] | None:
    """Return the candidates in the requested order."""
    if changes.keep_order:
        return tuple(candidate for number, candidate in candidate_of.items() if number <= n_views)
    return tuple(candidate_of[number] for number in changes.order) or None

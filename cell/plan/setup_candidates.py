"""Set-up candidates: poses of the part, each with the candidate viewpoints that the arm reaches, measured.

All set-ups share the surface, its samples and the generated viewpoints. A finished plan can be a fixed set-up, whose
candidates are the views of the plan.
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from cell.errors import SceneError, UsageError
from cell.part.planning_mesh import planning_mesh
from cell.plan.candidates import (
    Cell,
    MeasuredSet,
    PlanSession,
    append_viewpoints,
    generate_viewpoints,
    make_surface,
    measure,
    reach_viewpoints,
    view_evaluator,
    with_grown,
    without_rows,
)
from cell.plan.selection import measure_rows
from cell.plan.stable_poses import MARGIN, Underside, needs_fixture, stable_poses
from cell.runs.cell import read_cell
from cell.runs.run import Run
from cell.scene.model import Placement, Post, Scene
from cell.scene.model import Setup as SetupTable
from cell.scene.settle import SettledScene
from cell.session import Stream
from cell.world.balance import support_margin
from cell.world.checks import find_problems
from cell.world.measurability import PartSurface, surface_samples
from cell.world.model import ON_AXIS, World, compile_settled
from cell.world.occluders import Occluder, fixed_occluders
from cell.world.prediction import Prediction, held_out_samples
from cell.world.support_contact import in_contact
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples, draw_samples
from planner.kinematics.frames import kuka_abc_from_pose
from planner.kinematics.reach import pick_reach
from planner.measurability.matrix import Measurability, measurability_of
from planner.measurability.visibility import find_measured
from planner.values import Bools, Floats, Ints
from planner.viewpoints import growth
from planner.viewpoints.growth import ViewEvaluator
from planner.viewpoints.lines_of_sight import RayTargets
from planner.viewpoints.viewpoints import Viewpoints

_N_PROPOSED = 24  # set-up candidates if neither the scene nor the user gives any
_TURNS_DEG = (0.0, 90.0, 180.0, 270.0)  # about the vertical, at which each stable pose is proposed
_MAX_COSINE = float(np.cos(np.radians(10.0)))  # stable poses tilted by less are one: a rounded part has hundreds
_SAME = 1e-5  # m, and entries of a rotation: set-up candidates that differ by less are one


@dataclass(frozen=True, slots=True)
class SetupCandidate:
    """A pose of the part that may be used.

    Attributes:
        name: in words.
        placement: of the part's centre.
        table: of the scene; None for a proposed pose.
        run: finished plan of a fixed set-up; None for one that is planned.
        post: of a proposed pose that needs another post than that of the scene; None: that of the scene.
        rests: whether the part has to rest on its supports without being fastened.
    """

    name: str
    placement: Placement
    table: SetupTable | None = None
    run: Run | None = None
    post: Post | None = None
    rests: bool = False

    def scene(self, shared: Scene) -> Scene:
        """Return the scene of this set-up alone."""
        changes: dict[str, object] = {
            "placement": self.placement,
            "setup": (),
            "plan": shared.plan.without_selection().with_order_of(shared.plan),
        }
        if self.post is not None:
            changes["post"] = self.post
        if self.table is not None:
            changes["fixtures"] = (*shared.fixtures, *self.table.fixtures)
            changes |= {} if self.table.post is None else {"post": self.table.post}
        return shared.model_copy(update=changes)


def given_candidates(scene: Scene) -> list[SetupCandidate]:
    """Return the set-ups of the scene in its order."""
    return [
        SetupCandidate(each.name, Placement(position_mm=each.position_mm, abc_deg=each.abc_deg), each)
        for each in scene.setup
    ]


def with_fixed_table(scene: Scene, world: World) -> Scene:
    """Return the scene with its rotary table at its position in a compiled cell, whatever the pose of the part."""
    return scene if world.table is None else with_table_at(scene, world.table.T_base_table)


def with_table_at(scene: Scene, T_base_table: Floats) -> Scene:
    """Return the scene with its rotary table at a pose."""
    position_mm = (1000 * T_base_table[:3, 3]).round(6).tolist()
    return scene.model_copy(update={"table": scene.table.model_copy(update={"position_mm": tuple(position_mm)})})


def proposed_candidates(world: World, part: TriangleMesh, limit: int) -> list[SetupCandidate]:
    """Propose set-ups in which the part's lowest point keeps its height, and its centre its position.

    The pose of the scene comes first, then stable poses, the most probable first, each at all turns; at one turn if a
    rotary table turns the part about its centre. A stable pose has the thinnest post on which the part rests, no
    thinner than that of the scene.

    Args:
        world: the cell with the part as the scene places it.
        part: reference mesh [m], object frame.
        limit: largest number of candidates.

    Raises:
        SceneError: if a rotary table is tilted, on which no pose of the part is stable.
    """
    if limit and world.table is not None and not world.table.upright:
        raise SceneError(
            "set-ups can only be proposed on an upright rotary table, and this one is tilted; give [[setup]] tables "
            "with --proposals 0, or omit table.abc_deg"
        )
    placed = (world.T_base_object @ world.T_object_centre)[:3, :3]
    turns_deg = _TURNS_DEG[:1] if _table_turns_part(world) else _TURNS_DEG
    turns = Rotation.from_rotvec(np.outer(turns_deg, (0.0, 0.0, 1.0)), degrees=True).as_matrix()
    proposals: list[SetupCandidate] = []
    for name, R, post in _poses(world, part, placed):
        for turn, about_vertical in zip(turns_deg, turns, strict=True):
            text, is_placed = f"{name}, turned by {turn:g} deg" if turn else name, R is placed
            proposals.append(
                SetupCandidate(text, _placement(world, about_vertical @ R), post=post, rests=not is_placed)
            )
        if len(proposals) >= limit:
            break
    return proposals[:limit]


def _poses(world: World, part: TriangleMesh, placed: Floats) -> Iterator[tuple[str, Floats, Post | None]]:
    """Yield name, rotation (3, 3) and post of each pose; None is the post of the scene.

    The pose of the scene comes first, then stable poses on a post, then those that need a fixture.
    """
    post, axis = world.scene.post, world.T_object_centre[:3, 3]
    is_at_rest = not post.enabled or Underside(part, placed, axis).margin(post) >= MARGIN
    yield f"as it is placed{'' if is_at_rest else needs_fixture(post)}", placed, None
    known, fastened = [placed[2]], []
    for R, probability in stable_poses(part):
        if any(R[2] @ other >= _MAX_COSINE for other in known):
            continue
        known.append(R[2])
        name = f"in a stable pose of probability {probability:.2f}"
        if not post.enabled:
            yield name, R, None
        elif (new_post := Underside(part, R, axis).supporting_post(post)) is None:
            fastened.append((name + needs_fixture(), R, None))
        else:
            yield f"{name} on a post of {new_post.diameter_mm:g} mm", R, None if new_post == post else new_post
    yield from fastened


def _table_turns_part(world: World) -> bool:
    """Return whether a rotary table turns the part once round about its own centre."""
    if (table := world.table) is None:
        return False
    off_axis = (world.T_base_object @ world.T_object_centre)[:2, 3] - table.T_base_table[:2, 3]
    return bool(np.linalg.norm(off_axis) <= ON_AXIS and table.upper - table.lower >= 2 * np.pi - 1e-9)


def _placement(world: World, R: Floats) -> Placement:
    """Return the placement at a rotation, with the lowest point at its height in the scene, in rounded numbers."""
    T = np.array(world.T_base_object @ world.T_object_centre)
    corners = world.part_hull.vertices - world.T_object_centre[:3, 3]
    T[2, 3] = world.T_base_post(world.T_base_object)[2, 3] - (corners @ R[2]).min()
    T[:3, :3] = R
    position, abc = kuka_abc_from_pose(T)
    return Placement(
        position_mm=tuple(((position * 1000).round(3) + 0.0).tolist()),
        abc_deg=tuple((np.degrees(abc).round(3) + 0.0).tolist()),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Setup:
    """A set-up with its measured candidates.

    Attributes:
        measured: its candidates; rows in contact with a support are empty.
        supports: post, floor, pedestal and fixtures, object frame.
        contact: (S,) whether a support touches each held-out sample.
    """

    measured: MeasuredSet
    supports: Sequence[Occluder]
    contact: Bools

    @property
    def coverable(self) -> Bools:
        """(S,) held-out samples that a reachable candidate measures."""
        return np.asarray(self.measured.prediction.coverable.covered) & ~self.contact

    def visible(self, T_object_poses: Floats) -> Bools:
        """Return (S,) whether (n, K, 4, 4) views [m] measure each held-out sample."""
        return np.asarray(self.measured.prediction.visible(T_object_poses).covered) & ~self.contact

    def measures(self, T_object_poses: Floats, samples: SurfaceSamples) -> Bools:
        """Return (S,) whether (n, K, 4, 4) views [m] measure each of some samples."""
        known = self.measured.prediction
        seen = find_measured(T_object_poses, samples, known.scanner, known.casters)
        return seen & ~in_contact(samples, self.supports)

    def rows_of(self, samples: SurfaceSamples) -> Measurability:
        """Return the matrix of further samples."""
        M = measure_rows(self.measured, self.measured.reached.reachable, samples)
        return without_rows(M, in_contact(samples, self.supports))


@dataclass(frozen=True, slots=True, eq=False)
class FixedSetup(Setup):
    """A set-up with a finished plan; its candidates are the views of the plan, as they are driven.

    Attributes:
        run: the finished plan.
    """

    run: Run


@dataclass(frozen=True, slots=True, eq=False)
class PlannedSetup(Setup):
    """A set-up that can be planned.

    Attributes:
        settled: scene with the part at its placement.
        cell: compiled.
    """

    settled: SettledScene
    cell: Cell

    def with_viewpoints(
        self, session: PlanSession, surface: PartSurface, M: Measurability, viewpoints: Viewpoints
    ) -> "PlannedSetup":
        """Append viewpoints to the candidates; M is the current matrix of the candidates."""
        more, uncached = reach_viewpoints(self.settled, self.cell, viewpoints), replace(session, use_cache=False)
        measured = append_viewpoints(
            uncached, self.settled, surface, replace(self.measured, M=M), more,
            ignored=in_contact(M.samples, self.supports),
        )  # fmt: skip
        return replace(self, measured=measured)

    def are_reachable(self, T_object_scanner: Floats) -> Bools:
        """Return (n,) whether the arm takes up each pose (n, 4, 4) [m] without collision."""
        known = self.measured.prediction
        return view_evaluator(self.cell, known.scanner, known.casters).are_reachable(T_object_scanner[:, None])

    def evaluator(self, samples: SurfaceSamples) -> ViewEvaluator:
        """Return the evaluator of free poses; samples in contact with a support are not measured."""
        known = self.measured.prediction
        arm = view_evaluator(self.cell, known.scanner, known.casters)
        return _ContactEvaluator(
            arm.scanner, arm.casters, arm.are_reachable, arm.T_view_scanner, contact=in_contact(samples, self.supports)
        )


@dataclass(frozen=True, slots=True, eq=False)
class _ContactEvaluator(ViewEvaluator):
    """Evaluator of free poses for a part with (S,) targets in contact with a support."""

    contact: Bools

    def measured(
        self, views: Floats, targets: RayTargets, rows: Ints, threshold: tuple[Floats, float] | None = None
    ) -> Bools:
        """Return (m, n) whether each viewpoint (n, 4, 4) [m] measures each row; see `ViewEvaluator.measured`."""
        return ViewEvaluator.measured(self, views, targets, rows, threshold) & ~self.contact[rows, None]


def make_setup(
    session: PlanSession, settled: SettledScene, surface: PartSurface, world: World, candidate: SetupCandidate,
    viewpoints: Viewpoints, scouts: SurfaceSamples,
) -> Setup | str:  # fmt: skip
    """Reach, grow and measure the candidates of a set-up; return the reason if it is not possible.

    Args:
        session: nothing is written to its folder.
        settled: shared scene.
        surface: part and rows that all set-ups share.
        world: the cell, compiled with the part anywhere.
        candidate: pose of the part.
        viewpoints: that all set-ups share.
        scouts: samples for which more viewpoints are grown.
    """
    if candidate.run is not None:
        return _fixed_setup(session, surface, candidate.run)
    scene = candidate.scene(settled.scene)
    settled = replace(settled, scene=scene)
    has_own_shapes = candidate.table is not None and (candidate.table.fixtures or candidate.table.post)
    if scene.table.enabled or candidate.post is not None or has_own_shapes:
        try:
            world = compile_settled(settled, surface.reference)
        except SceneError as error:
            return str(error)
    else:
        T_base_object = scene.placement.T @ np.linalg.inv(world.T_object_centre)
        placed = world.scene.model_copy(update={"placement": candidate.placement})
        world = replace(world, scene=placed, T_base_object=T_base_object)
    if problems := find_problems(world):
        return problems[0]
    if candidate.rests and not scene.post.enabled and support_margin(world) < MARGIN:
        return (
            "the part does not rest on fixtures, table or floor there: the centre of mass must be at least "
            f"{1000 * MARGIN:g} mm inside its contacts; give a [[setup]] with a fixture or post below it"
        )
    cell = Cell.of(world)
    with session.stage(candidate.name) as progress:
        casters, supports = cell.casters(surface), fixed_occluders(world)
        candidate_set = reach_viewpoints(settled, cell, viewpoints)
        candidate_set = with_grown(settled, cell, candidate_set, scouts, casters, progress)
        if not candidate_set.reached.reachable.any():
            return "the arm reaches no candidate"
        measured = measure(
            session, settled, surface, candidate_set, casters, progress, ignored=in_contact(surface.samples, supports),
            may_be_empty=True,
        )  # fmt: skip
        contact = in_contact(measured.prediction.samples, supports)
        return PlannedSetup(measured, supports, contact, settled, cell)


def _fixed_setup(session: PlanSession, surface: PartSurface, run: Run) -> FixedSetup:
    """Measure the views of a finished plan over the shared samples."""
    cell, views = read_cell(run), run.plan.views
    ids = np.array([view.id for view in views])
    poses = np.stack([view.T_object_poses for view in views])
    candidates = replace(run.candidates.pick(ids), T_object_scanner=poses)
    samples = held_out_samples(surface.reference, surface.planning, session.seed, session.effort.held_out_samples)
    prediction = Prediction.of(samples, cell.scanner, cell.casters, poses)
    reached = pick_reach(run.reach, ids)
    seen = find_measured(poses, surface.samples, cell.scanner, cell.casters, each=True)
    M = measurability_of(seen & ~in_contact(surface.samples, cell.occluders)[:, None], surface.samples)
    measured = MeasuredSet(candidates, reached, M, prediction)
    return FixedSetup(measured, cell.occluders, in_contact(samples, cell.occluders), run)


def try_candidates(
    session: PlanSession, settled: SettledScene, limit: int | None, first: Run | None
) -> tuple[PartSurface, list[SetupCandidate], list[Setup | str]]:
    """Return the shared surface, the set-up candidates, and each as a set-up or the reason why it is not possible.

    Args:
        session: of the plan.
        settled: shared scene.
        limit: largest number of proposed candidates; None: proposed only if the scene has no set-ups.
        first: finished plan that is the first set-up.

    Raises:
        UsageError: if the plan is of another part.
    """
    reference = settled.part.reference
    if first is not None and not _is_same_mesh(first.mesh("reference.ply"), reference):
        raise UsageError(
            f"{first.folder} is a plan of the part {first.scene.part.name} with another mesh than {settled.part.name}; "
            "give a plan of the same part"
        )
    if limit is None:
        limit = 0 if settled.scene.setup else _N_PROPOSED
    with session.stage("decimate and sample"):
        planning = planning_mesh(reference, settled.settings.faces, use_cache=session.use_cache)
        viewpoints = generate_viewpoints(settled.scene, settled.settings, settled.part, planning)
        rows = surface_samples(settled.scene, reference, planning, session.rng(Stream.MATRIX_SAMPLES))
        surface = make_surface(reference, planning, rows)
        scouts = draw_samples(reference, planning, growth.N_SCOUTS, session.rng(Stream.SCOUTS))
        scene_candidates = given_candidates(settled.scene)
        # If none is proposed, the placement of the scene is no set-up candidate.
        scenes = [settled.scene]
        if not limit:
            scenes = [settled.scene.model_copy(update={"placement": each.placement}) for each in scene_candidates]
        settled, world = first_possible_cell([replace(settled, scene=scene) for scene in scenes], reference)
        settled = replace(settled, scene=with_fixed_table(settled.scene, world))
        fixed = [] if first is None else [_fixed_candidate(first)]
        candidates = _distinct([*fixed, *scene_candidates, *proposed_candidates(world, reference, limit)])
        has_one_pose = len({candidate.name.split(",")[0] for candidate in candidates}) == 1 < limit
        if settled.scene.setup == () and has_one_pose:
            turned = ", turned," if len(candidates) > 1 else ""
            session.note(f"the part has no other stable pose: the only candidate is the part as it is placed{turned}")
    outcomes = [make_setup(session, settled, surface, world, each, viewpoints, scouts) for each in candidates]
    return surface, candidates, outcomes


def _is_same_mesh(one: TriangleMesh, other: TriangleMesh) -> bool:
    """Return whether two meshes have the same faces and, up to the rounding of a file, the same vertices."""
    return np.array_equal(one.faces, other.faces) and np.allclose(one.vertices, other.vertices, rtol=0, atol=_SAME)


def _fixed_candidate(run: Run) -> SetupCandidate:
    placement = Placement.at(run.scene.T_base_object @ run.scene.T_object_centre)
    return SetupCandidate(f"as in the plan {run.folder}", placement, run=run)


def first_possible_cell(settled: Sequence[SettledScene], reference: TriangleMesh) -> tuple[SettledScene, World]:
    """Return the first scene that can be compiled, with its cell.

    Raises:
        SceneError: of the last scene, if none can be compiled.
    """
    for each in settled[:-1]:
        with suppress(SceneError):  # the set-up will be left out, with the reason
            return each, compile_settled(each, reference)
    return settled[-1], compile_settled(settled[-1], reference)


def _distinct(candidates: list[SetupCandidate]) -> list[SetupCandidate]:
    """Remove proposed candidates with the pose of an earlier one among the same fixtures."""
    distinct: list[SetupCandidate] = []
    for candidate in candidates:
        is_known = (
            np.abs(candidate.placement.T - other.placement.T).max() < _SAME
            and not (other.table and other.table.fixtures)
            for other in distinct
        )
        if candidate.table is not None or not any(is_known):
            distinct.append(candidate)
    return distinct

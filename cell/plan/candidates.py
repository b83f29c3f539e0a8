"""Candidate viewpoints: generated, reached, grown, appended and measured.

The generator `grown` begins with the optimal scanning zone. Once reach is known, `with_grown` appends viewpoints for
samples that no reachable candidate measures (`planner.viewpoints.growth`). They depend on the placement and the cell,
and the arm reaches all of them. Only the scouts are random, drawn by the seed of the plan. Equal inputs therefore give
equal candidates, and the cache of the matrix, which knows a column by its pose, has them the next time.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from cell import scanners
from cell.errors import SceneError, UnreachableError
from cell.part.mesh_checks import Kind
from cell.part.workpiece import Workpiece
from cell.runs.folder import RunFolder
from cell.scene.model import PlanSettings, RegionTargets, Scene, with_rest
from cell.scene.regions import with_limits
from cell.scene.settle import Settings, SettledScene
from cell.session import Session
from cell.world.collision import MujocoCollisionChecker
from cell.world.embree import EmbreeRayCaster
from cell.world.measurability import PartSurface, limit_sigma, part_matrix
from cell.world.model import World
from cell.world.occluders import fixed_occluders, make_caster
from cell.world.prediction import Prediction, held_out_samples
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples
from planner.kinematics import reach
from planner.kinematics.reach import Reach, Verdict, join_reach
from planner.measurability import coverage, visibility
from planner.measurability.matrix import Measurability, join_measurability, spread_measurability
from planner.ports import Kinematics, Progress, RayCaster, Scanner, no_progress
from planner.values import Bools, Floats
from planner.viewpoints import growth
from planner.viewpoints.growth import ViewEvaluator
from planner.viewpoints.lines_of_sight import RayTargets
from planner.viewpoints.viewpoints import (
    Viewpoints,
    optimal_scanning_zone,
    view_sphere,
    viewpoints_from_poses,
)

GROWN = "grown"

PlanSession = Session[RunFolder]
"""Session with the open run folder of a plan."""


@dataclass(frozen=True, slots=True, eq=False)
class Cell:
    """Compiled cell with its collision checker.

    Attributes:
        world: compiled cell.
        checker: of collisions in it.
        kinematics: of the arm, with a rotary table if there is one.
    """

    world: World
    checker: MujocoCollisionChecker
    kinematics: Kinematics

    @classmethod
    def of(cls, world: World) -> "Cell":
        """Make the checker and the kinematics of a compiled cell."""
        return cls(world, MujocoCollisionChecker(world), world.kinematics)

    def casters(self, surface: PartSurface) -> tuple[RayCaster, RayCaster]:
        """Return the ray casters of the part and of the occluders, object frame."""
        return surface.caster, make_caster(fixed_occluders(self.world))


@dataclass(frozen=True, slots=True, eq=False)
class CandidateSet:
    """Candidates before they are measured.

    Attributes:
        viewpoints: one pose each; a sweep is named by the viewpoint that it is made about.
        reached: verdicts and configurations.
    """

    viewpoints: Viewpoints
    reached: Reach

    def joined(self, more: "CandidateSet") -> "CandidateSet":
        """Return these candidates followed by others; numbers stay."""
        viewpoints = Viewpoints.join([self.viewpoints, more.viewpoints])
        return CandidateSet(viewpoints, join_reach([self.reached, more.reached]))


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredSet:
    """Candidates with the samples that they measure.

    Attributes:
        candidates: columns of M; a candidate of a sweeping scanner has several poses.
        reached: verdicts and configurations.
        M: measurability matrix with occluders and limits of the scanner applied.
        prediction: evaluation samples, scanner law with its limits, and ray casters of part and occluders.
    """

    candidates: Viewpoints
    reached: Reach
    M: Measurability
    prediction: Prediction


MeasuredT = TypeVar("MeasuredT", bound=MeasuredSet)


def make_surface(reference: TriangleMesh, planning: TriangleMesh, samples: SurfaceSamples) -> PartSurface:
    """Combine meshes and samples of the part with its ray caster."""
    return PartSurface(reference, planning, samples, EmbreeRayCaster(reference.vertices, reference.faces))


def generate_viewpoints(scene: Scene, settings: Settings, part: Workpiece, planning: TriangleMesh) -> Viewpoints:
    """Return the viewpoints of the scene's generator."""
    step_x, step_y = np.deg2rad(scene.plan.view_sphere_step_deg)
    if scene.plan.candidates == "view-sphere":
        return view_sphere(part.centre, settings.sphere_radius, step_x, step_y, settings.rolls)
    return optimal_scanning_zone(planning, settings.standoffs, settings.rolls)


def limited_scanner(scene: Scene, scanner: Scanner) -> Scanner:
    """Return the scanner law with the limits of the scene; `limit_sigma` refuses a scanner without known sigma."""
    has_sigma = callable(getattr(scanner, "sigma", None))
    return with_limits(scanner, scene.plan.max_sigma_mm if has_sigma else None, with_rest(scene.region))


def view_evaluator(cell: Cell, scanner: Scanner, casters: Sequence[RayCaster]) -> ViewEvaluator:
    """Return the evaluator of free poses: measured samples and reachability.

    Args:
        cell: compiled with the part at its placement.
        scanner: law with its limits.
        casters: of part and occluders, object frame.
    """
    world = cell.world

    def are_reachable(T_object_scanner: Floats) -> Bools:
        return reach.are_reachable(
            T_object_scanner, world.T_base_object, world.T_flange_scanner, cell.kinematics, cell.checker
        )

    return ViewEvaluator(scanner, casters, are_reachable, getattr(scanner, "T_view_scanner", np.eye(4)[None]))


def reach_viewpoints(
    settled: SettledScene, cell: Cell, viewpoints: Viewpoints, progress: Progress = no_progress
) -> CandidateSet:
    """Solve the inverse kinematics of viewpoints, with a verdict each."""
    poses, world = scanners.sweep_columns(settled.scanner, viewpoints), cell.world
    reached = reach.solve_reach(
        poses, world.T_base_object, world.T_flange_scanner, cell.kinematics, cell.checker, progress=progress
    )
    return CandidateSet(viewpoints, reached)


def grow_viewpoints(
    viewpoints: Viewpoints,
    usable: Bools,
    scouts: SurfaceSamples,
    evaluator: ViewEvaluator,
    progress: Progress = no_progress,
    schedule: Sequence[growth.SearchStage] = growth.SCHEDULE,
) -> Viewpoints:
    """Search viewpoints for scouts that no usable viewpoint measures.

    Args:
        viewpoints: one pose each.
        usable: (V,) reachable ones.
        scouts: samples of equal area, neither rows of the matrix nor held-out samples.
        evaluator: of free poses.
        progress: called with (stages done, stages).
        schedule: of the search.

    Returns:
        The new viewpoints.
    """
    targets = RayTargets.of(scouts.points, scouts.normals, scouts.region)
    poses = viewpoints.T_object_scanner[usable] @ evaluator.T_view_scanner
    seen = coverage.visible_coverage(poses, scouts, evaluator.scanner, evaluator.casters).covered
    grown_poses = growth.grow(targets, seen, evaluator, schedule=schedule, progress=progress)
    return viewpoints_from_poses(
        grown_poses.T_object_scanner, scouts.points[grown_poses.row], scouts.planning_face[grown_poses.row]
    )


def with_grown(
    settled: SettledScene,
    cell: Cell,
    candidates: CandidateSet,
    scouts: SurfaceSamples,
    casters: Sequence[RayCaster],
    progress: Progress = no_progress,
    schedule: Sequence[growth.SearchStage] = growth.SCHEDULE,
) -> CandidateSet:
    """Append grown viewpoints if the scene's generator grows them; numbers of the given candidates stay."""
    if settled.scene.plan.candidates != GROWN or not len(scouts):
        return candidates
    evaluator = view_evaluator(cell, limited_scanner(settled.scene, settled.scanner), casters)
    grown = grow_viewpoints(candidates.viewpoints, candidates.reached.reachable, scouts, evaluator, progress, schedule)
    return candidates.joined(reach_viewpoints(settled, cell, grown))


def measure(
    session: PlanSession,
    settled: SettledScene,
    surface: PartSurface,
    candidates: CandidateSet,
    casters: Sequence[RayCaster],
    progress: Progress,
    *,
    samples: SurfaceSamples | None = None,
    ignored: Bools | None = None,
    may_be_empty: bool = False,
) -> MeasuredSet:
    """Fill the columns of reachable candidates, and measure the evaluation samples.

    Args:
        session: seed and cache.
        settled: scanner and limits.
        surface: part and rows of the matrix.
        candidates: reached in this cell.
        casters: of part and occluders.
        progress: called with (poses done, poses).
        samples: for evaluation; None: held-out samples of the plan.
        ignored: (S,) rows that nothing can measure, such as rows in contact with a support.
        may_be_empty: whether an empty matrix is allowed.
    """
    usable, total = np.flatnonzero(candidates.reached.reachable), len(candidates.viewpoints)
    M, scanner = fill_columns(
        session, settled, surface, casters, candidates.viewpoints.pick(usable), progress,
        may_be_empty=may_be_empty,
    )  # fmt: skip
    if ignored is not None:
        M = without_rows(M, ignored)
    M = spread_measurability(M, usable, total)
    if not may_be_empty:
        require_measurable(settled.scene.region, M)
    if samples is None:
        samples = held_out_samples(surface.reference, surface.planning, session.seed, session.effort.held_out_samples)
    swept = scanners.sweep_columns(settled.scanner, candidates.viewpoints)
    poses = swept.T_object_scanner[candidates.reached.reachable]
    prediction = Prediction.of(samples, scanner, casters, poses, progress)
    return MeasuredSet(swept, candidates.reached, M, prediction)


def fill_columns(
    session: PlanSession, settled: SettledScene, surface: PartSurface, casters: Sequence[RayCaster],
    viewpoints: Viewpoints, progress: Progress = no_progress, *, may_be_empty: bool = False,
) -> tuple[Measurability, Scanner]:  # fmt: skip
    """Fill M of viewpoints with occluders and limit on sigma applied; also return the scanner law with its limits."""
    scene, views = settled.scene, scanners.sweep_columns(settled.scanner, viewpoints)
    M = part_matrix(
        scene, settled.settings, surface, views, reporter=session.reporter, use_cache=session.use_cache,
        progress=progress,
    )  # fmt: skip
    law = limited_scanner(scene, settled.scanner)
    M = visibility.apply_occluders(
        M, views, law if scene.region else settled.scanner, casters[1], ray_caster=casters[0], progress=progress
    )
    if (limit := scene.plan.max_sigma_mm) is not None:
        M = limit_sigma(M, views, settled.scanner, limit, casters, may_be_empty=may_be_empty)
    return M, law


def append_viewpoints(
    session: PlanSession, settled: SettledScene, surface: PartSurface, measured: MeasuredT, more: CandidateSet,
    *, ignored: Bools | None = None,
) -> MeasuredT:  # fmt: skip
    """Append reached viewpoints to measured candidates; every candidate keeps its number (`id` of plan.json).

    Args:
        session: of the plan.
        settled: scanner and limits.
        surface: the part; the rows are those of the matrix.
        measured: candidates that are there.
        more: further candidates.
        ignored: (S,) rows that nothing can measure.
    """
    known, rows = measured.prediction, replace(surface, samples=measured.M.samples)
    columns, _ = fill_columns(session, settled, rows, known.casters, more.viewpoints, may_be_empty=True)
    M = join_measurability([measured.M, columns])
    swept = scanners.sweep_columns(settled.scanner, more.viewpoints)
    return replace(
        measured,
        candidates=Viewpoints.join([measured.candidates, swept]),
        reached=join_reach([measured.reached, more.reached]),
        M=M if ignored is None else without_rows(M, ignored),
        prediction=known.with_more(swept.T_object_scanner),
    )


def without_rows(M: Measurability, rows: Bools) -> Measurability:
    """Remove all entries of (S,) selected rows."""
    return M.with_entries(np.repeat(~rows, np.diff(M.indptr)))


def require_reachable(plan: PlanSettings, part: Workpiece, reached: Reach) -> None:
    """Refuse candidates of which the arm reaches none, and named candidates that are missing or not reached."""
    for key in ("pinned", "banned"):
        for view in getattr(plan, key):
            if view >= len(reached):
                raise SceneError(f"plan.{key} names candidate {view}; there are candidates 0 to {len(reached) - 1}")
    for view in plan.pinned:
        if not reached.reachable[view]:
            raise SceneError(
                f"plan.pinned names candidate {view}, which is {unreachable_reason(reached, view)}; pin another one, "
                "or move the part"
            )
    if reached.reachable.any():
        return
    counts = ", ".join(f"{count} {verdict.sentence}" for verdict, count in reached.counts().items() if count)
    worst = next(iter(reached.blockers()), "")
    is_one_sided = any(finding.kind in (Kind.OPEN, Kind.FLAT) for finding in part.findings)
    raise UnreachableError(
        f"none of the {len(reached)} candidate viewpoints is reachable: {counts}"
        + (f" (most often {worst})" if worst else "")
        + "; move the part (--place), change the standoff or allow more --roll values"
        + (", or invert its faces if they point inwards" if is_one_sided else "")
    )


def unreachable_reason(reached: Reach, view: int) -> str:
    """Return the verdict of a candidate with the blocking object."""
    blocker = reached.blocker[view]
    return Verdict(int(reached.verdict[view])).sentence + (f" ({blocker})" if blocker else "")


def require_measurable(regions: Sequence[RegionTargets], M: Measurability) -> None:
    """Refuse regions if no reachable candidate measures anything within their limits."""
    if not regions or len(M.indices):
        return
    limits = [
        f"'{each.name}' requires {what} {limit:g} mm"
        for each in regions
        for what, limit in (("a spacing of at most", each.max_spacing_mm), ("a sigma of at most", each.max_sigma_mm))
        if limit is not None
    ]
    raise UnreachableError(
        "no reachable candidate measures any sample within the limits of the regions"
        + (f" ({', '.join(limits)})" if limits else "")
        + "; relax the limits, use a finer resolution or a device with a nearer range, or move the part"
    )

"""An offered set-up with all that selection asks of it: candidates, reach, matrix and what is coverable."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cell import scanners
from cell.errors import SceneError
from cell.plan import denser_samples, steps
from cell.plan.appended_candidates import appended
from cell.plan.candidates import arm_of
from cell.plan.steps import Cell, Job, Measured, PlanSession
from cell.scene.model import Scene
from cell.setups.contact import touching
from cell.setups.growing import with_grown
from cell.setups.offered import Offer
from cell.world.checks import find_problems
from cell.world.collision import MujocoCollisionChecker
from cell.world.measurability import PartSurface
from cell.world.model import World, compile_world
from cell.world.occluders import Occluder, fixed_occluders
from cell.world.prediction import Prediction
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples
from planner.kinematics.reach import join_reach
from planner.measurability.matrix import Measurability, spread_measurability
from planner.measurability.visibility import find_measured
from planner.values import Bools, Floats, Ints
from planner.viewpoints.growth import ViewEvaluator
from planner.viewpoints.lines_of_sight import RayTargets
from planner.viewpoints.viewpoints import Viewpoints, pick_viewpoints


@dataclass(frozen=True, slots=True, eq=False)
class Setup:
    """A set-up that is possible.

    Attributes:
        job: what is planned, the part placed as offered.
        cell: compiled.
        measured: its candidates; rows that touch a support are empty.
        prediction: the held-out samples.
        supports: post, floor, pedestal and fixtures, object frame.
        touched: (S,) held-out samples that a support touches.
    """

    job: Job
    cell: Cell
    measured: Measured
    prediction: Prediction
    supports: Sequence[Occluder]
    touched: Bools

    @property
    def coverable(self) -> Bools:
        """(S,) held-out samples that a reachable candidate measures."""
        return np.asarray(self.prediction.coverable.covered) & ~self.touched

    def visible(self, T_object_poses: Floats) -> Bools:
        """(S,) held-out samples that (n, K, 4, 4) views measure."""
        return np.asarray(self.prediction.visible(T_object_poses).covered) & ~self.touched

    def measures(self, T_object_poses: Floats, samples: SurfaceSamples) -> Bools:
        """(S,) any samples that (n, K, 4, 4) views measure."""
        seen = find_measured(T_object_poses, samples, self.prediction.scanner, self.prediction.casters)
        return seen & ~touching(samples, self.supports)

    def with_views(
        self, session: PlanSession, surface: PartSurface, M: Measurability, views: Viewpoints
    ) -> "tuple[Setup, Measurability]":
        """With further candidates behind the others, and the matrix of all of them over the rows of M.

        Args:
            session: of the open run.
            surface: the part.
            M: of the candidates that there are, over the rows by now.
            views: the further ones, one pose each, that the arm takes up.
        """
        known, rows = self.measured, replace(surface, samples=M.samples)
        reached = join_reach([known.reached, steps.reach_of(self.job, self.cell, views)])
        candidates, joined, _ = appended(
            replace(session, use_cache=False), self.job, rows, known.casters, (known.candidates, M), views
        )
        M = _without(joined, touching(M.samples, self.supports))
        prediction = self.prediction.with_more(candidates.T_object_scanner[len(known.candidates) :])
        measured = replace(known, candidates=candidates, reached=reached, M=M)
        return replace(self, measured=measured, prediction=prediction), M

    def arm(self, features: SurfaceSamples) -> ViewEvaluator:
        """Who measures here and where it gets to; of the features those that touch a support are not measured."""
        cell, known = self.cell, self.measured
        arm = arm_of(cell.world, cell.kinematics, cell.checker, known.scanner, known.casters)
        return _PartArm(
            arm.scanner, arm.casters, arm.are_reachable, arm.T_view_scanner, touched=touching(features, self.supports)
        )

    def rows_of(self, features: SurfaceSamples) -> Measurability:
        """What reachable candidates measure of further features."""
        reachable = self.measured.reached.reachable
        sigma = self.measured.M.sigma is not None
        M = denser_samples.rows_of(self.measured.candidates, reachable, self.prediction, features, sigma=sigma)
        return _without(M, touching(features, self.supports))


@dataclass(frozen=True, slots=True, eq=False)
class _PartArm(ViewEvaluator):
    """An arm before a part of which some lies on something.

    Attributes:
        touched: (S,) targets that a support touches.
    """

    touched: Bools

    def measured(
        self, views: Floats, targets: RayTargets, rows: Ints, worth: tuple[Floats, float] | None = None
    ) -> Bools:
        """(m, n) which of the rows each viewpoint (n, 4, 4) [m] measures, as `Arm.measured`."""
        return ViewEvaluator.measured(self, views, targets, rows, worth) & ~self.touched[rows, None]


def measured_setup(
    session: PlanSession,
    job: Job,
    surface: PartSurface,
    world: World,
    offer: Offer,
    shared: Viewpoints,
    scouts: SurfaceSamples,
) -> Setup | str:
    """Reach, grow and measure one set-up; the reason where it cannot be.

    Args:
        session: of the open run.
        job: what is planned.
        surface: the part and the rows that all set-ups share.
        world: the cell, compiled with the part anywhere.
        offer: where the part is to lie.
        shared: candidates that all set-ups share.
        scouts: points that more candidates are grown for.
    """
    scene = offer.scene(job.scene)
    if scene.table.enabled or (offer.given is not None and (offer.given.fixtures or offer.given.post)):
        try:
            world = compiled_world(job, scene, surface.reference)
        except SceneError as error:
            return str(error)
    else:
        T_base_object = scene.placement.T @ np.linalg.inv(world.T_object_centre)
        world = replace(
            world, scene=world.scene.model_copy(update={"placement": offer.placement}), T_base_object=T_base_object
        )
    if problems := find_problems(world):
        return problems[0]
    job = replace(job, scene=scene)
    cell = Cell(world, MujocoCollisionChecker(world), world.kinematics)
    with session.stage(offer.name) as progress:
        candidates, reached = with_grown(job, surface, cell, shared, scouts, progress)
        usable = np.flatnonzero(reached.reachable)
        if not len(usable):
            return "the arm reaches no candidate"
        casters, supports = steps.casters_of(surface, cell), fixed_occluders(world)
        M, scanner = steps.columns(
            session, job, surface, casters, pick_viewpoints(candidates, usable), progress, may_be_empty=True
        )
        M = spread_measurability(_without(M, touching(surface.samples, supports)), usable, len(candidates))
        known = Measured(scanners.sweep_columns(job.scanner, candidates), reached, M, scanner, casters)
        prediction = steps.predicted(session, surface, known, progress)
        return Setup(job, cell, known, prediction, supports, touching(prediction.samples, supports))


def compiled_world(job: Job, scene: Scene, part: TriangleMesh) -> World:
    """The cell of a scene, compiled with the part in it."""
    baseline_mm = scanners.baseline_mm(job.settings.scanner, job.scanner)
    return compile_world(scene, part.vertices, part_faces=part.faces, baseline_mm=baseline_mm)


def _without(M: Measurability, rows: Bools) -> Measurability:
    """M with no entry in some of its rows."""
    lengths = np.diff(M.indptr)
    kept = np.repeat(~rows, lengths)
    indptr = np.concatenate([[0], np.cumsum(np.where(rows, 0, lengths))])
    return replace(M, indptr=indptr, indices=M.indices[kept], sigma=None if M.sigma is None else M.sigma[kept])

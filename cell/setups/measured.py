"""An offered set-up with all that selection asks of it: candidates, reach, matrix and what is coverable."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cell import scanners
from cell.checks.possible import impossible
from cell.plan import denser, steps
from cell.plan.steps import Cell, Job, Measured, Run
from cell.rays.matrix import PartSurface
from cell.rays.occluders import Occluder, occluder_triangles
from cell.rays.prediction import Prediction
from cell.robot.arm import kinematics_of
from cell.setups.contact import touching
from cell.setups.growing import with_grown
from cell.setups.offered import Offer
from cell.world.collision import MujocoCollisionChecker
from cell.world.model import World
from planner.measurability.columns import spread_measurability
from planner.measurability.matrix import Measurability, measured
from planner.surface.sample import SurfaceSamples
from planner.values import Bools, Floats
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
        seen = measured(T_object_poses, samples, self.prediction.scanner, self.prediction.casters)
        return seen & ~touching(samples, self.supports)

    def rows_of(self, features: SurfaceSamples) -> Measurability:
        """What reachable candidates measure of further features."""
        reachable = self.measured.reached.reachable
        sigma = self.measured.M.sigma is not None
        M = denser.rows_of(self.measured.candidates, reachable, self.prediction, features, sigma=sigma)
        return _without(M, touching(features, self.supports))


def measured_setup(
    run: Run,
    job: Job,
    surface: PartSurface,
    world: World,
    offer: Offer,
    shared: Viewpoints,
    scouts: SurfaceSamples,
) -> Setup | str:
    """Reach, grow and measure one set-up; the reason where it cannot be.

    Args:
        run: the open run; nothing is written.
        job: what is planned.
        surface: the part and the rows that all set-ups share.
        world: the cell, compiled with the part anywhere.
        offer: where the part is to lie.
        shared: candidates that all set-ups share.
        scouts: points that more candidates are grown for.
    """
    scene = job.scene.model_copy(update={"placement": offer.placement})
    T_base_object = scene.placement.T @ np.linalg.inv(world.T_object_centre)
    settled = world.scene.model_copy(update={"placement": offer.placement})
    world = replace(world, scene=settled, T_base_object=T_base_object)
    if problems := impossible(world):
        return problems[0]
    job = replace(job, scene=scene)
    cell = Cell(world, MujocoCollisionChecker(world), kinematics_of(world.model))
    with run.step(offer.name) as progress:
        candidates, reached = with_grown(job, surface, cell, shared, scouts, progress)
        usable = np.flatnonzero(reached.reachable)
        if not len(usable):
            return "the arm reaches no candidate"
        casters, supports = steps.casters_of(surface, cell), occluder_triangles(world)
        M, scanner = steps.columns(
            run, job, surface, casters, pick_viewpoints(candidates, usable), progress, may_be_empty=True
        )
        M = spread_measurability(_without(M, touching(surface.features, supports)), usable, len(candidates))
        known = Measured(scanners.swept(job.scanner, candidates), reached, M, scanner, casters)
        prediction = steps.predicted(run, surface, known, progress)
        return Setup(job, cell, known, prediction, supports, touching(prediction.samples, supports))


def _without(M: Measurability, rows: Bools) -> Measurability:
    """M with no entry in some of its rows."""
    lengths = np.diff(M.indptr)
    kept = np.repeat(~rows, lengths)
    indptr = np.concatenate([[0], np.cumsum(np.where(rows, 0, lengths))])
    return replace(M, indptr=indptr, indices=M.indices[kept], sigma=None if M.sigma is None else M.sigma[kept])

"""A scanner that may take any pose in known free space, in front of an unknown part.

Without an arm there is no post and no floor: the rows compare the choice of views alone. With an arm, poses are those
that it reaches (`arm`). Every policy begins with the same view, has the same voxels (`planner.explore.space`) and the
same points, and is evaluated on the same 100,000 samples of the true part. Explored frame, metres: its origin is the
middle of the cylinder.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.random import Generator
from scipy import ndimage

from benchmarks.exploring.arm import CellArm
from cell import scanners
from cell.explore.belief import Cylinder
from cell.explore.frustum import SensorFrustum
from cell.explore.options import ExploreOptions
from cell.explore.prepare import prepare_exploration
from cell.part import workpiece
from cell.scan.options import ScanOptions
from cell.scene.file import scene_from_options
from cell.scene.settle import Settings, settle
from cell.session import Session
from cell.world import virtual_scan
from cell.world.embree import EmbreeRayCaster
from cell.world.prediction import held_out_samples
from planner.explore.space import FREE, VoxelSpace
from planner.geometry.decimation import decimate
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples, draw_samples
from planner.measurability.coverage import marginal_coverage
from planner.measurability.visibility import find_measured
from planner.ports import RayCaster, Scanner
from planner.values import Bools, Floats
from planner.viewpoints import growth
from planner.viewpoints.lines_of_sight import RayTargets
from planner.viewpoints.viewpoints import aim_viewpoints, optimal_scanning_zone

CLEARANCE = 0.01
"""Distance [m] of laser source and sensor from all that was not seen free."""

_SIDES = 200  # directions that are tried for the first view


@dataclass(frozen=True, slots=True, eq=False)
class Knowledge:
    """Knowledge of a policy.

    Attributes:
        space: the voxels.
        poses: (4, 4) of each executed view [m].
        points: (N, 3) of each [m].
    """

    space: VoxelSpace
    poses: tuple[Floats, ...] = ()
    points: tuple[Floats, ...] = ()


NextView = Callable[[Knowledge], Floats | None]
"""The (4, 4) pose of the next view; None: the policy has no further one."""

Policy = Callable[["Lab", Generator], NextView]
"""A policy for one exploration; randomness is its second argument."""


@dataclass(frozen=True, slots=True, eq=False)
class Lab:
    """A hidden part and a scanner in front of it.

    Attributes:
        cylinder: known cylinder that contains the part.
        scanner: the sensor model.
        frustum: of the sensor.
        settings: standoffs, rolls and faces of a plan.
        unknown: the voxels before the first view.
        part: the true part; policies do not use it.
        samples: samples of the true part for the evaluation.
        caster: ray caster of the true part.
        arm: arm that holds the scanner; None: no arm.
    """

    cylinder: Cylinder
    scanner: Scanner
    frustum: SensorFrustum
    settings: Settings
    unknown: VoxelSpace
    part: TriangleMesh
    samples: SurfaceSamples
    caster: EmbreeRayCaster
    arm: CellArm | None = None

    @classmethod
    def of(cls, part: str, units: str | None = None, *, arm: bool = False) -> "Lab":
        """A built-in part by name, or a mesh file, without an arm or with the default cell's."""
        options: dict[str, Any] = {"place": (1200, 500, 0), "seed": 0} | ({} if units is None else {"units": units})
        scene = scene_from_options(None, options, part)
        work = prepare_exploration(Session(None), scene, ExploreOptions(), ScanOptions())
        known = workpiece.load(scene.part.source, scene.part.units)
        settings = settle(work.scene, known).settings
        assert work.ground_truth is not None
        mesh, scanner = work.ground_truth.mesh, scanners.make(work.scene.scanner.type, settings.scanner)
        samples = held_out_samples(mesh, decimate(mesh, min(settings.faces, len(mesh.faces))), 0)
        return cls(
            work.cylinder, scanner, work.frustum, settings, work.unknown, mesh, samples,
            EmbreeRayCaster(mesh.vertices, mesh.faces), CellArm.of(work, settings, scanner) if arm else None,
        )  # fmt: skip

    @property
    def middle_range(self) -> float:
        """Return the middle of the range of the scanner [m]."""
        return (self.frustum.near + self.frustum.far) / 2

    def first_view(self, rng: Generator) -> Floats:
        """Return the (4, 4) first view of all policies.

        It is level, from a random side, at the middle of the range or farther.
        """
        distance, free = max(self.middle_range, self.cylinder.radius + self.frustum.near), self.free(self.unknown)
        for _ in range(_SIDES):
            turn = rng.uniform(0, 2 * np.pi)
            out = np.array([[np.cos(turn), np.sin(turn), 0.0]])
            T = aim_viewpoints(np.zeros((1, 3)), out, np.array([-1]), [distance], [0.0]).T_object_scanner[:, 0]
            if free(T)[0]:
                return np.asarray(T[0])
        raise RuntimeError("no level view of the cylinder's middle can be taken here")

    def free(self, space: VoxelSpace) -> Callable[[Floats], Bools]:
        """Return at which of (n, 4, 4) poses the scanner is free.

        Source and sensor keep `CLEARANCE` from all space that was not seen free, to within two voxels. If there is an
        arm, it reaches the pose.
        """
        halves = (space.state != FREE).reshape([n for whole in space.state.shape for n in (whole // 2, 2)])
        away = ndimage.distance_transform_edt(~halves.any(axis=(1, 3, 5))) * 2 * space.edge
        away = away.repeat(2, 0).repeat(2, 1).repeat(2, 2)
        ends = (self.frustum.source, self.frustum.sensor)

        def is_free(T: Floats) -> Bools:
            near = np.min([space.values_at(T[:, :3, :3] @ at + T[:, :3, 3], away) for at in ends], axis=0)
            found = np.asarray(near >= CLEARANCE)
            if self.arm is not None:
                found[found] = self.arm.are_reachable(T[found])
            return found

        return is_free

    def observe(self, known: Knowledge, T: Floats) -> Knowledge:
        """Return the knowledge after a view from the pose (4, 4)."""
        points = virtual_scan.scan(self.scanner, T, self.caster, self.part).points
        eye, source, sensor = (
            self.frustum,
            *(T[:3, :3] @ at + T[:3, 3] for at in (self.frustum.source, self.frustum.sensor)),
        )
        space = known.space
        if len(points):
            space = space.with_points(points, [source, sensor]).with_surface_between(eye.between(points, T, space.gap))
        space = space.with_votes(points, source, sensor, eye.blank(points, T), eye.near, eye.far)
        return Knowledge(space, (*known.poses, T), (*known.points, points))

    def by_views(self, poses: tuple[Floats, ...]) -> Floats:
        """Return (n,) visible coverage after each of the views, share of the true surface."""
        seen = find_measured(np.stack(poses)[:, None], self.samples, self.scanner, (self.caster,), each=True)
        return np.cumsum(marginal_coverage(seen))

    def ceiling(self) -> float:
        """Return the share of the true surface that poses with clearance from the true part measure.

        Poses are grown as for a plan of the true part. The share is the result of a search and not a proven bound.
        """
        planning = decimate(self.part, min(self.settings.faces, len(self.part.faces)))
        space = replace(self.unknown, state=np.full_like(self.unknown.state, FREE))
        free = self.free(space.with_points(self.samples.points, []))
        scouts = draw_samples(self.part, planning, growth.N_SCOUTS, np.random.default_rng(0))
        casters = (self.caster,)
        poses, _ = self.candidates(planning, scouts, casters, free)
        seen = find_measured(poses[:, None], self.samples, self.scanner, casters)
        return float(self.samples.areas[seen].sum() / self.samples.areas.sum())

    def holder(self, casters: tuple[RayCaster, ...], free: Callable[[Floats], Bools]) -> growth.ViewEvaluator:
        """Return the evaluator of views at all free poses.

        Occlusion is that of the casters.
        """
        return growth.ViewEvaluator(self.scanner, casters, lambda T: free(T[:, 0]), np.eye(4)[None])

    def candidates(
        self, planning: TriangleMesh, scouts: SurfaceSamples, casters: tuple[RayCaster, ...],
        free: Callable[[Floats], Bools], schedule: Sequence[growth.SearchStage] = growth.SCHEDULE,
    ) -> tuple[Floats, Floats]:  # fmt: skip
        """Return the candidates of a plan of a surface: over its faces, and grown for the remaining samples.

        Returns:
            (V, 4, 4) poses and the (V,) distance of each to its target [m].
        """
        before = optimal_scanning_zone(planning, self.settings.standoffs, self.settings.rolls)
        zone = before.T_object_scanner[:, 0]
        there = free(zone)
        zone = zone[there]
        seen = find_measured(zone[:, None], scouts, self.scanner, casters) if len(zone) else np.zeros(len(scouts), bool)
        targets, arm = RayTargets.of(scouts.points, scouts.normals), self.holder(casters, free)
        grown = growth.grow(targets, seen, arm, schedule=schedule)
        distance = np.linalg.norm(scouts.points[grown.row] - grown.T_object_scanner[:, :3, 3], axis=1)
        poses = np.concatenate([zone, grown.T_object_scanner])
        return poses, np.concatenate([before.standoff[there], distance])


def explored(lab: Lab, policy: Policy, seed: int, views: int) -> tuple[Knowledge, Floats]:
    """Return the knowledge after a number of views of a policy, and (n,) its true coverage after each view."""
    known = lab.observe(Knowledge(lab.unknown), lab.first_view(np.random.default_rng([seed, 0])))
    next_view = policy(lab, np.random.default_rng([seed, 1]))
    while len(known.poses) < views and (T := next_view(known)) is not None:
        known = lab.observe(known, T)
    return known, lab.by_views(known.poses)

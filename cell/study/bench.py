"""One part under one scanner, ready for trials: candidates, matrices, plans, and how good they are on unseen samples.

What `cell plan` does for one job with a report, without motion and files; every study of views stands on it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from cell import scanners
from cell.part import workpiece
from cell.part.workpiece import Workpiece
from cell.plan.candidates import generate_viewpoints
from cell.scene.model import Scene, require_no_region_targets
from cell.scene.regions import with_regions
from cell.scene.settle import Settings, resolve, settle_scene
from cell.session import Stream, random_stream
from cell.world import virtual_scan
from cell.world.checks import require_feasible
from cell.world.collision import MujocoCollisionChecker
from cell.world.embree import EmbreeRayCaster
from cell.world.measurability import PartSurface, part_matrix, surface_samples
from cell.world.model import World, compile_world
from cell.world.prediction import held_out_samples
from planner import cover
from planner.cover import Cover, CoverProblem
from planner.geometry.decimation import decimate
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples
from planner.kinematics import reach
from planner.kinematics.reach import Reach
from planner.measurability import coverage
from planner.measurability.matrix import Measurability, pick_measurability
from planner.ports import Kinematics, Scanner
from planner.values import Floats
from planner.viewpoints.viewpoints import Viewpoints, pick_viewpoints

Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """A selection of views and how good it is.

    Attributes:
        cover: the selection and what is proven of it.
        T_object_scanner: (n, 1, 4, 4) its poses [m].
        visible: share of the surface that it measures, on samples that the optimiser did not see.
        density: times as many samples per face as the scene has, that the optimiser saw.
    """

    cover: Cover
    T_object_scanner: Floats
    visible: float
    density: int = 1

    def values(self) -> dict[str, float | str]:
        """For the result of a trial."""
        return {
            "views": len(self.cover.views),
            "lower_bound": self.cover.lower_bound,
            "status": self.cover.status.name.lower(),
            "visible": self.visible,
            "density": self.density,
        }


class Bench:
    """A scene with its part loaded; meshes, samples, matrices and the compiled cell are made when first asked for.

    Args:
        scene: a checked scene.
        samples: held-out samples to judge with; None: those of the default effort.
    """

    def __init__(self, scene: Scene, *, samples: int | None = None) -> None:
        require_no_region_targets(scene.region)
        self.part: Workpiece = with_regions(workpiece.load(scene.part.source, scene.part.units), scene)
        self.scene = scene = settle_scene(scene, self.part)
        settings = resolve(scene, self.part)
        self.scanner: Scanner = scanners.make(scene.scanner.type, settings.scanner)
        self.settings: Settings = replace(
            settings, scanner=scanners.with_own_parameters(settings.scanner, self.scanner)
        )
        self._n_samples = samples
        self._some: dict[int, tuple[Viewpoints, Measurability]] = {}
        self._matrices: dict[tuple[str, int, int], tuple[Viewpoints, SurfaceSamples, Measurability]] = {}

    @cached_property
    def planning(self) -> TriangleMesh:
        """The decimated copy."""
        return decimate(self.part.reference, self.settings.faces)

    @cached_property
    def caster(self) -> EmbreeRayCaster:
        """Casts on the part."""
        return EmbreeRayCaster(self.part.reference.vertices, self.part.reference.faces)

    @cached_property
    def samples(self) -> SurfaceSamples:
        """Held-out samples: no optimiser sees them."""
        return held_out_samples(self.part.reference, self.planning, self.scene.plan.seed, self._n_samples)

    @cached_property
    def zone(self) -> Viewpoints:
        """Candidates by the scene's generator and rolls."""
        return scanners.sweep_columns(
            self.scanner, generate_viewpoints(self.scene, self.settings, self.part, self.planning)
        )

    @cached_property
    def sphere(self) -> Viewpoints:
        """Candidates of the view sphere, 15 degrees apart."""
        plan = self.scene.plan.model_copy(update={"candidates": "view-sphere"})
        scene = self.scene.model_copy(update={"plan": plan})
        return scanners.sweep_columns(self.scanner, generate_viewpoints(scene, self.settings, self.part, self.planning))

    @cached_property
    def world(self) -> World:
        """The compiled cell; `World.elsewhere` is that of another placement."""
        baseline = scanners.baseline_mm(self.settings.scanner, self.scanner)
        part = self.part.reference
        world = compile_world(self.scene, part.vertices, part_faces=part.faces, baseline_mm=baseline)
        require_feasible(world)
        return world

    @cached_property
    def kinematics(self) -> Kinematics:
        """Of the arm, and of a table under the part where it stands."""
        return self.world.kinematics

    def reach(self, candidates: Viewpoints, T_base_centre: Floats) -> Reach:
        """Which candidates the robot reaches with the part's centre at a place.

        Args:
            candidates: viewpoints.
            T_base_centre: (4, 4) where the part's centre stands and how it is turned [m].
        """
        return reach_in(self.world.with_placement(T_base_centre), candidates)

    def checker(self, T_base_object: Floats) -> MujocoCollisionChecker:
        """Collisions with the part at a placement (4, 4) [m]."""
        return MujocoCollisionChecker(self.world, T_base_object)

    def matrix(self, fill: str, candidates: Viewpoints, density: int = 1) -> Measurability:
        """The part-only matrix by `aimed` or `rays`, from the cache where it is there.

        Args:
            fill: `aimed` or `rays`.
            candidates: viewpoints.
            density: times as many samples per face as the scene has.
        """
        known = self._matrices.get((fill, id(candidates), density))
        if known is None:
            dense = {"fill": fill, "samples_per_face": density * self.scene.plan.samples_per_face}
            scene = self.scene.model_copy(update={"plan": self.scene.plan.model_copy(update=dense)})
            rng = random_stream(self.scene.plan.seed, Stream.MATRIX_SAMPLES)
            features = surface_samples(scene, self.part.reference, self.planning, rng)
            surface = PartSurface(self.part.reference, self.planning, features, self.caster)
            M = part_matrix(scene, self.settings, surface, candidates)
            known = candidates, features, M  # the candidates are kept, so that their id stays theirs
            self._matrices[fill, id(candidates), density] = known
        return known[2]

    def some(self, count: int | None) -> tuple[Viewpoints, Measurability]:
        """The scene's candidates, or a number of them for a quick look, with their `aimed` matrix.

        The same ones at every placement; a greater number holds the smaller one's.
        """
        if count is None or count >= len(self.zone):
            return self.zone, self.matrix("aimed", self.zone)
        if count not in self._some:
            rng = random_stream(self.scene.plan.seed, Stream.CANDIDATE_SUBSET)
            which = np.sort(rng.permutation(len(self.zone))[:count])
            M = pick_measurability(self.matrix("aimed", self.zone), which)
            self._some[count] = pick_viewpoints(self.zone, which), M
        return self._some[count]

    def select(
        self,
        fill: str,
        candidates: Viewpoints,
        allowed: Mask | None,
        *,
        solver: str,
        share: float = 1.0,
        density: int = 1,
    ) -> Judged:
        """The fewest views for a share of what can be covered.

        Args:
            fill: `aimed` or `rays`.
            candidates: viewpoints.
            allowed: (V,) which may be used; None: all.
            solver: a name of `planner.cover.SOLVERS`.
            share: of the coverable area of the matrix's rows.
            density: times as many samples per face as the scene has.
        """
        M = self.matrix(fill, candidates, density)
        rng = np.random.default_rng(self.scene.plan.seed)
        found = cover.solve(CoverProblem(M.matrix(), M.samples.areas, allowed, coverage=share), rng=rng, solver=solver)
        return replace(self.judged(found, candidates), density=density)

    def judged(self, found: Cover, candidates: Viewpoints) -> Judged:
        """A selection with its visible coverage on the held-out samples."""
        poses = candidates.T_object_scanner[found.views]
        return Judged(found, poses, self.visible(poses))

    def visible(self, T_object_scanner: Floats) -> float:
        """Visible coverage of views (n, K, 4, 4) [m] on the held-out samples: share of the surface."""
        return coverage.visible_coverage(T_object_scanner, self.samples, self.scanner, (self.caster,)).fraction

    def sampled(self, T_object_scanner: Floats) -> float:
        """Sampled coverage of views (n, 1, 4, 4) [m], scanned at the scene's scan resolution: share of the surface.

        One view after the other, and only for samples that none before came near: a plan of 100 views has millions of
        points, and most of them tell nothing new.
        """
        reference = self.part.reference
        radius = coverage.sampling_radius(reference)
        open_samples = np.arange(len(self.samples))
        for T in T_object_scanner[:, 0]:
            points = virtual_scan.scan(self.scanner, T, self.caster, reference).points
            if len(points) and len(open_samples):
                tree = cKDTree(points, balanced_tree=False, compact_nodes=False)
                bound = np.nextafter(radius, np.inf)  # the tree's own bound excludes the radius itself
                near, _ = tree.query(self.samples.points[open_samples], distance_upper_bound=bound)
                open_samples = open_samples[near > radius]
        areas = self.samples.areas
        return 1.0 - float(areas[open_samples].sum() / areas.sum())


def reach_in(world: World, candidates: Viewpoints) -> Reach:
    """Verdicts and joint solutions of viewpoints in a cell."""
    checker = MujocoCollisionChecker(world)
    return reach.solve_reach(candidates, world.T_base_object, world.T_flange_scanner, world.kinematics, checker)


def placed_at(position_mm: Sequence[float]) -> Floats:
    """(4, 4) a place of the part's centre [m] from millimetres, not turned."""
    T = np.eye(4)
    T[:3, 3] = np.asarray(position_mm) / 1000
    return T

"""A part under a scanner, prepared for trials: candidates, matrices, selections, and their coverage.

The steps of `cell plan` for many selections, without motion and files; and scenes as settings of trials.
"""

import hashlib
import json
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np

from cell import scanners
from cell.errors import FileError
from cell.files import file_errors
from cell.part import workpiece
from cell.part.planning_mesh import planning_mesh
from cell.part.workpiece import Workpiece
from cell.plan.candidates import generate_viewpoints
from cell.plan.files import named_files
from cell.scene.model import Scene, require_no_region_targets
from cell.scene.regions import with_regions
from cell.scene.settle import settle
from cell.session import Stream, random_stream
from cell.study.trials import JsonTable
from cell.world import virtual_scan
from cell.world.checks import require_feasible
from cell.world.collision import MujocoCollisionChecker
from cell.world.embree import EmbreeRayCaster
from cell.world.measurability import PartSurface, part_matrix, surface_samples
from cell.world.model import World, compile_settled
from cell.world.prediction import held_out_samples
from planner import cover
from planner.cover import Cover, CoverProblem
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples
from planner.kinematics import reach
from planner.kinematics.reach import Reach
from planner.measurability import coverage
from planner.measurability.matrix import Measurability, pick_measurability
from planner.ports import Scanner
from planner.values import Bools, Floats
from planner.viewpoints.viewpoints import Viewpoints


@dataclass(frozen=True, slots=True, eq=False)
class EvaluatedCover:
    """A selection of views with its coverage.

    Attributes:
        cover: the selection with its bound.
        T_object_scanner: (n, 1, 4, 4) poses of the views [m].
        visible: visible coverage on the held-out samples, share of the surface.
    """

    cover: Cover
    T_object_scanner: Floats
    visible: float

    def values(self) -> dict[str, float | str]:
        """Return the values of a trial."""
        return {
            "views": len(self.cover.views),
            "lower_bound": self.cover.lower_bound,
            "status": self.cover.status.name.lower(),
            "visible": self.visible,
        }


class Bench:
    """A scene with its part; meshes, samples, matrices and the compiled cell are made when they are first needed.

    Args:
        scene: a checked scene.
        samples: number of held-out samples; None: that of the default effort.
    """

    def __init__(self, scene: Scene, *, samples: int | None = None) -> None:
        require_no_region_targets(scene.region)
        self.part: Workpiece = with_regions(workpiece.load(scene.part.source, scene.part.units), scene)
        self.settled = settled = settle(scene, self.part)
        self.scene, self.settings = settled.scene, settled.settings
        self.scanner: Scanner = settled.scanner
        self.n_samples = samples
        self._subsets: dict[int, tuple[Viewpoints, Measurability]] = {}
        self._matrices: dict[tuple[str, int], tuple[Viewpoints, Measurability]] = {}

    @cached_property
    def planning(self) -> TriangleMesh:
        """The planning mesh."""
        return planning_mesh(self.part.reference, self.settings.faces)

    @cached_property
    def caster(self) -> EmbreeRayCaster:
        """The ray caster of the part."""
        return EmbreeRayCaster(self.part.reference.vertices, self.part.reference.faces)

    @cached_property
    def samples(self) -> SurfaceSamples:
        """The held-out samples."""
        return held_out_samples(self.part.reference, self.planning, self.scene.plan.seed, self.n_samples)

    @cached_property
    def candidates(self) -> Viewpoints:
        """The candidates by the generator and the rolls of the scene."""
        candidates = generate_viewpoints(self.scene, self.settings, self.part, self.planning)
        return scanners.sweep_columns(self.scanner, candidates)

    @cached_property
    def world(self) -> World:
        """The compiled cell."""
        world = compile_settled(self.settled)
        require_feasible(world)
        return world

    def matrix(self, fill: str, candidates: Viewpoints) -> Measurability:
        """Return the matrix without occluders, filled by `aimed` or `rays`; from the cache if possible."""
        known = self._matrices.get((fill, id(candidates)))
        if known is None:
            scene = self.scene.model_copy(update={"plan": self.scene.plan.model_copy(update={"fill": fill})})
            rng = random_stream(self.scene.plan.seed, Stream.MATRIX_SAMPLES)
            samples = surface_samples(scene, self.part.reference, self.planning, rng)
            surface = PartSurface(self.part.reference, self.planning, samples, self.caster)
            known = candidates, part_matrix(scene, self.settings, surface, candidates)
            self._matrices[fill, id(candidates)] = known  # with the candidates, so that their id stays theirs
        return known[1]

    def candidate_subset(self, count: int | None) -> tuple[Viewpoints, Measurability]:
        """Return a number of candidates with their `aimed` matrix; None: all.

        The subset is the same at every placement, and a larger one contains it.
        """
        if count is None or count >= len(self.candidates):
            return self.candidates, self.matrix("aimed", self.candidates)
        if count not in self._subsets:
            rng = random_stream(self.scene.plan.seed, Stream.CANDIDATE_SUBSET)
            which = np.sort(rng.permutation(len(self.candidates))[:count])
            M = pick_measurability(self.matrix("aimed", self.candidates), which)
            self._subsets[count] = self.candidates.pick(which), M
        return self._subsets[count]

    def select(
        self, fill: str, candidates: Viewpoints, allowed: Bools | None, *, solver: str, share: float = 1.0
    ) -> EvaluatedCover:
        """Select the fewest views for a share of the coverable area.

        Args:
            fill: `aimed` or `rays`.
            candidates: viewpoints.
            allowed: (V,) usable candidates; None: all.
            solver: a name of `planner.cover.SOLVERS`.
            share: of the coverable area of the samples.
        """
        M = self.matrix(fill, candidates)
        rng = np.random.default_rng(self.scene.plan.seed)
        problem = CoverProblem(M.matrix(), M.samples.areas, allowed, coverage=share)
        return self.evaluate(cover.solve(problem, rng=rng, solver=solver), candidates)

    def evaluate(self, selection: Cover, candidates: Viewpoints) -> EvaluatedCover:
        """Return a selection with its visible coverage."""
        poses = candidates.T_object_scanner[selection.views]
        return EvaluatedCover(selection, poses, self.visible_coverage(poses))

    def visible_coverage(self, T_object_scanner: Floats) -> float:
        """Return the visible coverage of views (n, K, 4, 4) [m] on the held-out samples, share of the surface."""
        return coverage.visible_coverage(T_object_scanner, self.samples, self.scanner, (self.caster,)).fraction

    def sampled_coverage(self, T_object_scanner: Floats) -> float:
        """Return the sampled coverage of views (n, 1, 4, 4) [m] at the scan resolution, share of the surface.

        The scans are evaluated one by one, each for the samples that no earlier scan reached: the points of 100 views
        are millions, most of them near points of earlier views.
        """
        reference = self.part.reference
        radius = coverage.sampling_radius(reference)
        uncovered = np.arange(len(self.samples))
        for T in T_object_scanner[:, 0]:
            points = virtual_scan.scan(self.scanner, T, self.caster, reference).points
            left = self.samples.pick(uncovered)
            uncovered = uncovered[~coverage.sampled_coverage(points, left, radius).covered]
        areas = self.samples.areas
        return 1.0 - float(areas[uncovered].sum() / areas.sum())


def solve_reach(world: World, candidates: Viewpoints) -> Reach:
    """Return verdicts and configurations of viewpoints in a cell."""
    checker = MujocoCollisionChecker(world)
    return reach.solve_reach(candidates, world.T_base_object, world.T_flange_scanner, world.kinematics, checker)


def scene_settings(scene: Scene) -> dict[str, object]:
    """Return a scene as settings of a trial.

    These are its differences from the defaults, the sha256 of the named files, and the origin of a third-party scanner.
    """
    content = scene.model_dump(mode="json", exclude_defaults=True)
    # The defaults of a fixture depend on its shape; without them the dump would lack the shape itself.
    content["fixtures"] = [fixture.model_dump(mode="json") for fixture in scene.fixtures]
    painted = [region.painted for region in scene.region if region.painted is not None]
    paths = [*(file.path for file in named_files(scene, None)), *painted]
    scanner = scanners.origin(scene.scanner.type)
    of_plug_in = {"scanner": scanner} if scanner else {}
    return {"scene": content, "files": {path: _sha256(path) for path in paths}, **of_plug_in}


def scene_from_settings(settings: JsonTable) -> Scene:
    """Return the scene of a trial's settings.

    Raises:
        FileError: if a named file has changed, or a third-party scanner has another version here.
    """
    for path, sha256 in settings["files"].items():
        if _sha256(path) != sha256:
            raise FileError(f"{path} has changed since the study was started; start the study again")
    scene = Scene.model_validate(settings["scene"])
    if (here := scanners.origin(scene.scanner.type)) != (requested := settings.get("scanner", {})):
        raise FileError(f"the scanner is {requested} and here {here}; install the same version")
    return scene


def shared_bench(settings: JsonTable) -> Bench:
    """Return the bench of a trial's scene; the trials of a process share it, so that they load a part once."""
    return _bench(json.dumps({key: settings[key] for key in ("scene", "files")}, sort_keys=True))


@lru_cache(maxsize=2)
def _bench(settings: str) -> Bench:
    return Bench(scene_from_settings(json.loads(settings)))


def _sha256(path: str) -> str:
    with file_errors(f"{path} cannot be read"):
        return hashlib.sha256(Path(path).read_bytes()).hexdigest()

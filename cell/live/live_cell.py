"""Reach, coverable surface and collisions of a cell while its part moves.

Candidates, samples and the matrix of the part alone do not depend on the placement and are made once. A placement then
costs the inverse kinematics and the collision checks of `planner.kinematics.reach`, and the lines of sight that
something can hide. Post and fixtures of the part turn and move with it, so that their shadow is computed once for each
direction of the vertical. Of the surroundings only lines of sight whose bounding box meets an obstacle's are cast. The
grown candidates of a plan are not part of it: `cell plan` adds them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from cell import scanners
from cell.part import workpiece
from cell.part.planning_mesh import planning_mesh
from cell.plan.candidates import generate_viewpoints, limited_scanner, make_surface
from cell.scene.model import Scene
from cell.scene.regions import with_regions
from cell.scene.settle import SettledScene, settle
from cell.session import Stream, random_stream
from cell.view.surface import Canvas, canvas_of
from cell.world.checks import find_problems
from cell.world.collision import MujocoCollisionChecker
from cell.world.measurability import PartSurface, part_matrix, surface_samples
from cell.world.model import World, compile_settled
from cell.world.occluders import fixed_occluders, make_caster
from planner.kinematics import reach
from planner.kinematics.reach import Verdict
from planner.measurability.matrix import Measurability, pick_measurability
from planner.measurability.visibility import apply_occluders
from planner.values import Bools, Floats, Ints, Value
from planner.viewpoints.viewpoints import Viewpoints


@dataclass(frozen=True, slots=True, eq=False)
class LiveReach(Value):
    """Reach at a placement.

    Attributes:
        verdict: `Verdict` of each candidate.
        coverable: whether a reachable candidate measures the sample.
        share: coverable share of the surface.
        blockers: number of candidates that each pair of objects prevents, largest first.
        contacts: pairs nearer than the clearance with the arm at home, and objects inside others.
        problems: sentences of `cell check`; only of an exact evaluation without contacts, since their search for a
            way out of a contact takes seconds.
    """

    verdict: Annotated[NDArray[np.uint8], "V"]
    coverable: Annotated[Bools, "S"]
    share: float
    blockers: dict[str, int]
    contacts: tuple[str, ...]
    problems: tuple[str, ...] = ()

    @property
    def is_feasible(self) -> bool:
        """Whether the cell can be planned."""
        return not self.contacts and not self.problems

    @property
    def n_reachable(self) -> int:
        """Number of reachable candidates."""
        return int(np.count_nonzero(self.verdict == Verdict.REACHABLE))


@dataclass(frozen=True, eq=False)
class PartData:
    """Everything that does not depend on the surroundings of the part.

    Attributes:
        scene: of which it was made.
        settled: the same, settled.
        surface: meshes and samples.
        candidates: columns of `M`.
        M: measurability by the part alone.
    """

    scene: Scene
    settled: SettledScene
    surface: PartSurface
    candidates: Viewpoints
    M: Measurability

    @classmethod
    def of(cls, scene: Scene) -> PartData:
        """Load the part, generate candidates and fill the matrix, or read it from the cache."""
        settled = settle(scene, with_regions(workpiece.load(scene.part.source, scene.part.units), scene))
        reference, settings = settled.part.reference, settled.settings
        planning = planning_mesh(reference, settings.faces)
        rng = random_stream(scene.plan.seed, Stream.MATRIX_SAMPLES)
        surface = make_surface(reference, planning, surface_samples(settled.scene, reference, planning, rng))
        viewpoints = generate_viewpoints(settled.scene, settings, settled.part, planning)
        candidates = scanners.sweep_columns(settled.scanner, viewpoints)
        return cls(scene, settled, surface, candidates, part_matrix(settled.scene, settings, surface, candidates))

    def suits(self, scene: Scene) -> bool:
        """Return whether a scene differs from this one only in its surroundings and its requests."""
        free = {"placement", "fixtures", "robot", "table", "post", "plan", "setup", "clearance_mm"}
        own, other = (each.model_dump(exclude=free) for each in (self.scene, scene))
        requests = {"pinned", "banned", "coverage", "max_views", "collision"}
        plans = [each.plan.model_dump(exclude=requests) for each in (self.scene, scene)]
        return own == other and plans[0] == plans[1]

    @cached_property
    def canvas(self) -> Canvas:
        """The part for drawing; its samples are the rows of the matrix."""
        return canvas_of(self.surface.reference, self.M.samples)


class LiveCell:
    """A compiled cell with the data of its part.

    Args:
        scene: validated.
        before: cell whose data are used if part and scanner are the same.
    """

    def __init__(self, scene: Scene, before: LiveCell | None = None) -> None:
        known: PartData | None = None if before is None else before.data
        self.scene = scene
        self.data: PartData = known if known is not None and known.suits(scene) else PartData.of(scene)
        self.settled = settle(scene, self.data.settled.part)
        self.scanner = limited_scanner(self.settled.scene, self.settled.scanner)
        self.world = compile_settled(self.settled)
        self._shadow: tuple[bytes, Measurability, csr_array] | None = None

    def at(self, T_base_centre: Floats) -> World:
        """Return the cell with the part's centre at a pose (4, 4) [m]."""
        return self.world.with_placement(T_base_centre)

    def evaluate(self, T_base_centre: Floats, *, exact: bool = True) -> LiveReach:
        """Evaluate a placement.

        Args:
            T_base_centre: (4, 4) pose of the part's centre [m].
            exact: whether every occluder is where it is, as in `cell plan`; else the flat sides of the prism that
                stands for a post turn with the part.

        Raises:
            SceneError: if a rotary table cannot carry the part there.
        """
        world, data = self.at(T_base_centre), self.data
        checker = MujocoCollisionChecker(world)
        result = reach.solve_reach(
            data.candidates, world.T_base_object, world.T_flange_scanner, world.kinematics, checker
        )
        usable = result.reachable
        coverable = self._hidden_exactly(world, usable) if exact else self._hidden(world, usable)
        areas = data.M.samples.areas
        contacts = dict.fromkeys((*checker.contacts(world.home), *_placed_contacts(world)))
        return LiveReach(
            result.verdict, coverable, float(areas[coverable].sum() / areas.sum()), result.blockers(), tuple(contacts),
            tuple(find_problems(world)) if exact and not contacts else (),
        )  # fmt: skip

    def contacts(self, T_base_centre: Floats, q: Floats) -> list[tuple[str, float]]:
        """Return pairs nearer than the clearance with their distances [m], at (axes,) joint angles [rad]."""
        return MujocoCollisionChecker(self.at(T_base_centre)).pairs_within_clearance(q)

    def _hidden_exactly(self, world: World, usable: Bools) -> Bools:
        """Return (S,) whether a usable candidate measures the sample past all occluders."""
        M = self._without_hidden(self.data.M, np.flatnonzero(usable), world, moving=None)
        return np.asarray(np.diff(M.indptr) > 0)

    def _hidden(self, world: World, usable: Bools) -> Bools:
        """Return the same with the known shadow of post and fixtures of the part."""
        up = np.round(world.T_base_object[2, :3], 6) + 0.0
        if self._shadow is None or self._shadow[0] != up.tobytes():
            M = self._without_hidden(self.data.M, np.arange(len(usable)), world, moving=False)
            self._shadow = up.tobytes(), M, M.matrix().astype(np.int32)
        _, M, matrix = self._shadow
        near = usable & self._near_obstacles(world)
        covered: Bools = matrix @ (usable & ~near).astype(np.int32) > 0
        if near.any():
            rest = self._without_hidden(M, np.flatnonzero(near), world, moving=True)
            covered |= np.diff(rest.indptr) > 0
        return covered

    def _without_hidden(self, M: Measurability, which: Ints, world: World, *, moving: bool | None) -> Measurability:
        """Return columns of a matrix without the entries that occluders hide.

        Args:
            M: of all candidates.
            which: numbers of the columns.
            world: the cell.
            moving: whether the occluders are those that move relative to the part; None: all.
        """
        names = self._moving_names(world)
        pieces = [each for each in fixed_occluders(world) if moving is None or (each.name in names) == moving]
        M, views = pick_measurability(M, which), self.data.candidates.pick(which)
        if not pieces:
            return M
        return apply_occluders(M, views, self.scanner, make_caster(pieces), ray_caster=self.data.surface.caster)

    def _moving_names(self, world: World) -> set[str]:
        return {"floor", "pedestal", *(each.name for each in world.scene.fixtures if each.attached_to == "base")}

    def _near_obstacles(self, world: World) -> Bools:
        """Return (V,) whether the bounding box of the part and a candidate's lines of sight meets an obstacle's."""
        T = world.T_base_object
        part = world.part_hull.vertices @ T[:3, :3].T + T[:3, 3]
        sources = (T @ self.data.candidates.T_object_scanner)[..., :3, 3]
        low = np.minimum(sources.min(axis=1) - world.baseline, part.min(axis=0))
        high = np.maximum(sources.max(axis=1) + world.baseline, part.max(axis=0))
        near: Bools = np.zeros(len(low), dtype=np.bool_)
        names = self._moving_names(world)
        for piece in fixed_occluders(world):
            if piece.name in names:
                vertices = piece.vertices @ T[:3, :3].T + T[:3, 3]
                near |= ((low <= vertices.max(axis=0)) & (high >= vertices.min(axis=0))).all(axis=1)
        return near


def _placed_contacts(world: World) -> list[str]:
    """Return names of pairs of the part, its post or its fixtures with something stationary that they enter."""
    model, data = world.model, world.data()
    placed = [geom for geom in range(model.ngeom) if model.body(model.geom_bodyid[geom]).name in ("object", "post")]
    others = [geom for geom in range(model.ngeom) if model.geom_bodyid[geom] == 0]
    names = []
    for one in placed:
        for other in others:
            is_support = world.entities[one] == "post" and (world.entities[other] == "floor" or world.table is not None)
            if not is_support and world.distance(data, one, other, world.clearance) < 0:
                names.append(world.pair_name(one, other))
    return names

"""What a turned knob comes to, and the knobs of planning: decimation, samples, rays, solver and ordering.

Each function takes the bench, the knob's value and how often to repeat, and gives an error against a truth, with the
seconds that the work took. The truths are computed once a process. No robot but for the ordering.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

from cell.errors import UnreachableError
from cell.plan.candidates import first
from cell.robot.frames import pose_from_kuka_abc
from cell.scanners.laser_area import LaserArea
from cell.study.bench import Bench
from cell.study.claims import claim
from cell.study.timed import timed
from planner import cover
from planner.cover import DEFAULT_WORK
from planner.measurability.matrix import Measurability, fill, measured
from planner.order.generalised_tsp import STEPS
from planner.order.moves import Moves
from planner.order.orderings import sequence
from planner.ports import Floats
from planner.reach.reach import Reach
from planner.surface.closest import closest_face
from planner.surface.decimate import decimate
from planner.surface.mesh import TriangleMesh, face_centres, face_normals
from planner.surface.sample import SurfaceSamples, face_features, sample
from planner.timing.motion import scaled
from planner.viewpoints.viewpoints import Viewpoints

FINEST = 4
"""Candidates of so many times the default planning faces stand for all that there could be."""

_FEATURES, _SELECTION = 0, 2  # streams of randomness, as `cell plan` has them

_NARROW_DEG, _NARROW_FACES = 18.0, 1500
"""The selection of a default plan is proven in no time; a narrow field of view makes a problem to search in."""


@dataclass(frozen=True, slots=True)
class Turned:
    """What came of one value.

    Attributes:
        error: against the truth, in the knob's unit.
        seconds: "work" on the wall clock, "processor" over all cores.
        more: what else is worth a column.
    """

    error: float
    seconds: Mapping[str, float]
    more: Mapping[str, Any] = field(default_factory=dict)


Turn = Callable[[Bench, Any, int], Turned]
"""Bench, value of the knob, repeats."""


def decimation(bench: Bench, share: float, repeats: int) -> Turned:
    """Planning faces as a share of the default: surface that the plan loses for want of candidates and samples."""

    def work() -> tuple[Viewpoints, cover.Cover]:
        planning = _planning(bench, share)
        candidates = first(bench.scene, bench.settings, bench.part, planning)
        rng = np.random.default_rng([bench.scene.plan.seed, _FEATURES])
        count = bench.scene.plan.samples_per_face * len(planning.faces)
        features = sample(bench.part.reference, planning, count, rng)
        M = fill(candidates, features, bench.scanner, bench.caster)
        rng = np.random.default_rng([bench.scene.plan.seed, _SELECTION])
        return candidates, cover.solve(M.matrix(), features.areas, rng=rng)

    (candidates, plan), seconds = timed(work, repeats)
    visible = bench.visible(candidates.T_object_scanner[plan.views])
    error = 100 * (_most(bench) - visible)
    return Turned(error, seconds, {"views": len(plan.views), "candidates": len(candidates)})


def samples(bench: Bench, per_face: int, repeats: int) -> Turned:
    """Aimed samples per face: how far the matrix's claim for its plan is from the truth."""
    planning, candidates = bench.planning, bench.zone
    rng = np.random.default_rng([bench.scene.plan.seed, _FEATURES])
    features = sample(bench.part.reference, planning, per_face * len(planning.faces), rng)
    M, seconds = timed(lambda: fill(candidates, features, bench.scanner, bench.caster), repeats)
    return _claimed(bench, M, seconds)


def rays(bench: Bench, step_deg: float, repeats: int) -> Turned:
    """The paper's fill at an angle between rays: the same error."""
    faces, row_of_face = _face_rows(bench)
    scanner = LaserArea(**{**bench.settings.scanner, "resolution_deg": (step_deg, step_deg)})
    M, seconds = timed(
        lambda: fill(
            bench.zone, faces, scanner, bench.caster, method="rays", part=bench.part.reference, row_of_face=row_of_face
        ),
        repeats,
    )
    return _claimed(bench, M, seconds)


def solver(bench: Bench, share: float, repeats: int) -> Turned:
    """Work of the selection as a share of its default budget: views above the proven lower bound."""
    M, candidates = _narrow(bench)
    matrix, areas = M.matrix(), M.features.areas

    def work() -> cover.Cover:
        rng = np.random.default_rng([bench.scene.plan.seed, _SELECTION])
        return cover.solve(matrix, areas, rng=rng, budget=round(share * DEFAULT_WORK))

    plan, seconds = timed(work, repeats)
    bound = max(plan.lower_bound, _narrow_bound(bench))
    return Turned(
        100 * (len(plan.views) / bound - 1), seconds, {"views": len(plan.views), "candidates": len(candidates)}
    )


def ordering(bench: Bench, tours: int, repeats: int) -> Turned:
    """Tours that the ordering may look at: time of the moves above the proven lower bound."""
    configurations, poses, bound = _views_in_reach(bench)
    world, robot = bench.world, bench.scene.robot
    limits = scaled(world.limits, robot.speed_scaling, robot.acceleration_scaling)

    def work() -> Any:
        rng = np.random.default_rng(bench.scene.plan.seed)
        return sequence(Moves.straight(configurations, world.home, limits), poses, rng, budget=tours, bound_work=0)

    found, seconds = timed(work, repeats)
    return Turned(100 * (found.duration / bound - 1), seconds, {"views": len(configurations)})


def _planning(bench: Bench, share: float) -> TriangleMesh:
    return decimate(bench.part.reference, max(4, round(share * bench.settings.faces)))


def reached(bench: Bench) -> Reach:
    """Reach of the default candidates at the scene's placement, computed once.

    Raises:
        UnreachableError: if none is reached.
    """
    found = _reached(bench)
    if not found.reachable.any():
        raise UnreachableError("the robot reaches no candidate at the scene's placement; choose another scene")
    return found


@lru_cache(maxsize=2)
def _reached(bench: Bench) -> Reach:
    place = bench.scene.placement
    centre = pose_from_kuka_abc(np.array(place.position_mm) / 1000, np.deg2rad(place.abc_deg))
    return bench.reach(bench.zone, centre)


@lru_cache(maxsize=2)
def _most(bench: Bench) -> float:
    """Share of the surface that the finest candidates measure together, on the held-out samples."""
    candidates = first(bench.scene, bench.settings, bench.part, _planning(bench, FINEST))
    found = measured(candidates.T_object_scanner, bench.samples, bench.scanner, (bench.caster,))
    return float(bench.samples.areas[found].sum() / bench.samples.areas.sum())


def _claimed(bench: Bench, M: Measurability, seconds: Mapping[str, float]) -> Turned:
    found = claim(M, bench.zone, bench.samples, bench.scanner, bench.caster)
    return Turned(abs(found.error_points), seconds, {"views": found.views, "visible %": 100 * found.visible})


@lru_cache(maxsize=2)
def _face_rows(bench: Bench) -> tuple[SurfaceSamples, Any]:
    reference, planning = bench.part.reference, bench.planning
    rows = closest_face(
        face_centres(reference), face_normals(reference),
        planning.vertices[planning.faces], face_normals(planning),
    )  # fmt: skip
    return face_features(reference, planning), rows


@lru_cache(maxsize=2)
def _narrow(bench: Bench) -> tuple[Measurability, Viewpoints]:
    scene = bench.scene
    plan = {"faces": _NARROW_FACES, "percent_kept": None, "rolls_deg": (0.0,), "samples_per_face": 1, "fill": "aimed"}
    narrow = Bench(
        scene.model_copy(
            update={
                "scanner": scene.scanner.model_copy(update={"fov_deg": (_NARROW_DEG, _NARROW_DEG)}),
                "plan": scene.plan.model_copy(update=plan),
            }
        )
    )
    return narrow.matrix("aimed", narrow.zone), narrow.zone


@lru_cache(maxsize=2)
def _narrow_bound(bench: Bench) -> int:
    """The best lower bound that the default budget proves: of no value's own making."""
    M, _ = _narrow(bench)
    rng = np.random.default_rng([bench.scene.plan.seed, _SELECTION])
    return cover.solve(M.matrix(), M.features.areas, rng=rng).lower_bound


@lru_cache(maxsize=2)
def _views_in_reach(bench: Bench) -> tuple[list[Floats], Floats, float]:
    """Joint solutions and poses in base of the default plan's views, and the proven bound on their order's time [s]."""
    found = bench.select("aimed", bench.zone, reached(bench).reachable, solver="auto").cover.views
    configurations = [reached(bench).q_of(int(view)) for view in found]
    world, robot = bench.world, bench.scene.robot
    poses = world.T_base_object @ bench.zone.T_object_scanner[found, 0]
    limits = scaled(world.limits, robot.speed_scaling, robot.acceleration_scaling)
    rng = np.random.default_rng(bench.scene.plan.seed)
    bounded = sequence(Moves.straight(configurations, world.home, limits), poses, rng, budget=STEPS)
    return configurations, poses, bounded.lower_bound

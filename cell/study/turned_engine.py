"""The knobs of collision, reconstruction and the dynamic arm: seconds and error of one value, as in `turned`."""

from functools import lru_cache
from typing import Any

import numpy as np

from cell.plant.servo import Settings
from cell.reconstruction.cloud import PointCloud, ScanCloud, merge, point_spacing
from cell.reconstruction.deviation import deviation
from cell.reconstruction.nearest import NearestSurface
from cell.reconstruction.reconstruct import Reconstruction, reconstruct
from cell.scene.scene import Scene
from cell.study.bench import Bench, Mask
from cell.study.clouds import eight_scans, noisy
from cell.study.dense_moves import DenseMove, passes
from cell.study.near_part import configurations
from cell.study.plant_move import one_move
from cell.study.timed import timed
from cell.study.turned import Turned, reached
from cell.world.collision import MujocoCollisionChecker
from cell.world.world import World
from cell.world.world import compile as compile_world
from planner.errors import PlannerError
from planner.measurability import coverage
from planner.path.certified_edge import certify
from planner.ports import Floats

CERTIFIED = "certified"
"""The value of `edges` that is no step."""

FINE_STEP = 5e-5
"""Of the simulation that stands for the truth [s]."""

_CONFIGURATIONS = (250, 250)  # beside the part: of candidates, of random poses
_MOVES = 200
_NOISE = 30e-6  # of the scans, along the ray [m]
_GRID_SCAN_DEG = 0.25  # of the scans that the grid is turned on


def collision(bench: Bench, fidelity: str, repeats: int) -> Turned:
    """What the part is in collisions: free configurations beside it that are refused [%]."""
    q, truth = _beside(bench)
    checker = MujocoCollisionChecker(_world(bench, fidelity))
    checker.free(q[:1])  # compiles or loads what is compiled once
    free, seconds = timed(lambda: checker.free(q), repeats)
    refused, missed = int((truth & ~free).sum()), int((free & ~truth).sum())
    return Turned(
        100 * refused / max(1, int(truth.sum())), seconds, {"contacts missed": missed, "configurations": len(q)}
    )


def edges(bench: Bench, step_deg: float | str, repeats: int) -> Turned:
    """How a straight move is checked: the most of the clearance that a move uses up and passes as free [mm]."""
    moves = _moves(bench)
    checker = moves[0].checker

    def work() -> list[bool]:
        if isinstance(step_deg, str):
            return [certify(move.q_from, move.q_to, checker)[0] for move in moves]
        return [passes(move.q_from, move.q_to, checker, np.radians(step_deg)) for move in moves]

    free, seconds = timed(work, repeats)
    used = [move.intrusion if passed else 0.0 for passed, move in zip(free, moves, strict=True)]
    refused = sum(not passed and not move.intrusion for passed, move in zip(free, moves, strict=True))
    near = sum(move.intrusion > 0 for move in moves)
    return Turned(1000 * max(used), seconds, {"moves": len(moves), "too near": near, "refused": refused})


def grid(bench: Bench, factor: float, repeats: int) -> Turned:
    """Edge of a grid cell over the point spacing: rms deviation of the surface from the part [um]."""
    cloud, spacing = _cloud(bench)
    result, seconds = timed(lambda: reconstruct(cloud, grid=factor * spacing), repeats)
    return _surface(bench, result, seconds)


def scan(bench: Bench, step_deg: float, repeats: int) -> Turned:
    """Angle between the rays of a scan, the surface made of it: rms deviation of that from the part [um]."""
    points: list[ScanCloud] = []

    def work() -> Reconstruction:
        points[:] = noisy(eight_scans(bench.part, step_deg), _NOISE)
        return reconstruct(merge(points))

    result, seconds = timed(work, repeats)
    found = np.concatenate([each.points for each in points])
    sampled = coverage.sampled(found, bench.samples, coverage.sampling_radius(bench.part.reference)).fraction
    turned = _surface(bench, result, seconds)
    return Turned(turned.error, seconds, {**turned.more, "points": len(found), "sampled %": 100 * sampled})


def plant(bench: Bench, step_ms: float, repeats: int) -> Turned:
    """Time step of the dynamic arm: farthest from where a step of 0.05 ms takes the flange at the same time [mm]."""
    del bench  # the arm carries the built-in tool whatever the part is
    move, seconds = timed(lambda: one_move(Settings(time_step=step_ms / 1000)), repeats)
    if move.outcome != "settled":
        raise PlannerError(f"at a step of {step_ms:g} ms the simulation does not hold: the move ended {move.outcome}")
    times, position = move.positions()
    fine_times, fine = _fine_move()
    truth = np.stack([np.interp(times, fine_times, fine[:, axis]) for axis in range(3)], axis=1)
    off = 1000 * float(np.linalg.norm(position - truth, axis=1).max())
    return Turned(off, seconds, {"tracking mm": 1000 * move.tracking_error()})


def _world(bench: Bench, fidelity: str) -> World:
    scene: Scene = bench.scene.model_copy(
        update={
            "plan": bench.scene.plan.model_copy(update={"collision": fidelity}),
            "post": bench.scene.post.model_copy(update={"enabled": False}),
        }
    )
    part, baseline = bench.part.reference, bench.settings.scanner.get("baseline_mm", 0.0)
    return compile_world(scene, part.vertices, part_faces=part.faces, baseline_mm=baseline, refuse=False)


@lru_cache(maxsize=2)
def _beside(bench: Bench) -> tuple[Floats, Mask]:
    """Configurations beside the part, and which keep the clearance from its true triangles."""
    world, poses = _world(bench, "exact"), bench.zone.T_object_scanner[:, 0]
    rng = np.random.default_rng(bench.scene.plan.seed)
    q = configurations(world, bench.part, poses, bench.settings.standoffs[0], _CONFIGURATIONS, rng)
    if not len(q):
        raise PlannerError("the arm reaches no configuration beside the part; choose another placement")
    return q, np.asarray(MujocoCollisionChecker(world).free(q))


@lru_cache(maxsize=2)
def _moves(bench: Bench) -> list[DenseMove]:
    """Straight moves between joint solutions of reachable candidates."""
    q = reached(bench).q
    checker = MujocoCollisionChecker(bench.world)
    rng = np.random.default_rng(bench.scene.plan.seed)
    return [DenseMove(q[i], q[j], checker) for i, j in rng.integers(0, len(q), (_MOVES, 2))]


@lru_cache(maxsize=2)
def _cloud(bench: Bench) -> tuple[PointCloud, float]:
    scans = noisy(eight_scans(bench.part, _GRID_SCAN_DEG), _NOISE)
    spacing = point_spacing(
        np.concatenate([each.points for each in scans]), np.repeat(range(len(scans)), [len(each) for each in scans])
    )
    return merge(scans), spacing


@lru_cache(maxsize=2)
def _nearest(bench: Bench) -> NearestSurface:
    return NearestSurface(bench.part.reference)


def _surface(bench: Bench, result: Reconstruction, seconds: Any) -> Turned:
    if result.mesh is None:
        raise PlannerError(f"{result.status.value}; scan more finely")
    off = deviation(result.mesh, _nearest(bench), np.random.default_rng(0))
    return Turned(1e6 * off.rms, seconds, {"grid mm": 1000 * result.grid, "faces": len(result.mesh.faces)})


@lru_cache(maxsize=1)
def _fine_move() -> tuple[Floats, Floats]:
    return one_move(Settings(time_step=FINE_STEP)).positions()

"""Collision checks: configurations per second, and disagreements with python-fcl on the same shapes.

Rows compare ways to run MuJoCo on one cell, and the methods of the checker. Rates are per second of processor time,
which other load disturbs least, and per second of wall time. Disagreements with fcl's box, cylinder and hull routines
(overlap or not) are counted on configurations of which many are within 10 mm of contact.
"""

import time
from collections.abc import Callable
from typing import Any

import fcl
import mujoco
import mujoco.batch
import numpy as np
from numpy.typing import NDArray

from benchmarks.triangle_cell import polytope
from cell.part import workpiece
from cell.scene.model import Scene
from cell.world.collision import MujocoCollisionChecker
from cell.world.model import World, compile_world

_COUNT = 20_000
_COMPARED = 1_500
_REPEATS = 5


def run() -> list[dict[str, Any]]:
    """Return one row for each kind of check."""
    part = workpiece.load(Scene().part.source)
    started = time.perf_counter()
    world = compile_world(Scene(), part.reference.vertices, baseline_mm=75.0)
    compile_ms = 1000 * (time.perf_counter() - started)
    checker = MujocoCollisionChecker(world)
    q = np.random.default_rng(0).uniform(world.limits.lower, world.limits.upper, (_COUNT, 6))
    free = checker.free(q)
    compared, truth, n_near = _against_fcl(world, checker, q)

    def row(name: str, run_it: Callable[[], Any], count: int, wrong: int | str = "", note: str = "") -> dict[str, Any]:
        return {
            "what": name,
            **{rate: round(count / seconds, -3) for rate, seconds in _best(run_it).items()},
            "disagreements with fcl": wrong,
            "of": len(compared) if wrong != "" else "",
            "note": note,
        }

    overlap_free = _overlap_free(world, part.reference.vertices, compared)
    rows = [
        row("checker.free", lambda: checker.free(q), _COUNT, int((overlap_free != truth).sum()),
            f"{n_near} compared near contact; {np.mean(free):.1%} free at 10 mm; cell compiled in {compile_ms:.0f} ms"),
        row("loop, kinematics + collision", lambda: _loop(world, q), _COUNT, "", "no exact distances"),
        row("loop, kinematics alone", lambda: _loop(world, q, collision=False), _COUNT, "", "the floor"),
    ]  # fmt: skip
    for threads in (1, 2):
        batch = mujoco.batch.Batch(world.inflated, 2_000, threads)
        rows.append(row(f"Batch, {threads} threads", lambda b=batch: _batch(b, q), _COUNT, "", "counts only"))
    few = q[:2_000]
    rows += [
        row("checker.distance", lambda: checker.distance(few), len(few), "", "nearest pair within 300 mm"),
        row(
            "checker.travel, batch",
            lambda: checker.travel(q[:-1], q[1:]),
            _COUNT,
            "",
            "bound on the travel of a segment",
        ),
    ]
    return rows


def _best(run_it: Callable[[], Any]) -> dict[str, float]:
    """Return the shortest processor and wall time of a few runs [s]; other load only adds time."""
    best = {"configurations/CPU s": np.inf, "configurations/s": np.inf}
    for _ in range(_REPEATS):
        started = time.process_time(), time.perf_counter()
        run_it()
        times = time.process_time() - started[0], time.perf_counter() - started[1]
        best = {name: min(was, now) for (name, was), now in zip(best.items(), times, strict=True)}
    return best


def _loop(world: World, q: NDArray[np.float64], collision: bool = True) -> None:
    data = mujoco.MjData(world.inflated)
    for configuration in q:
        data.qpos[:] = configuration
        mujoco.mj_kinematics(world.inflated, data)
        if collision:
            mujoco.mj_collision(world.inflated, data)


def _batch(batch: mujoco.batch.Batch, q: NDArray[np.float64]) -> int:
    qpos, contacts, found = batch.bind("qpos"), batch.bind("ncon"), 0
    for start in range(0, len(q), batch.nsim):
        qpos[:] = q[start : start + batch.nsim]
        batch.forward(stage=int(mujoco.mjtStage.mjSTAGE_POS))
        found += int((contacts > 0).sum())
    return found


def _overlap_free(world: World, vertices: NDArray[np.float64], q: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return the checker's result without clearance, which fcl decides exactly."""
    touching = Scene.model_validate({"clearance_mm": 0.0})
    return MujocoCollisionChecker(compile_world(touching, vertices, baseline_mm=75.0), world.T_base_object).free(q)


def _against_fcl(
    world: World, checker: MujocoCollisionChecker, q: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_], int]:
    """Return configurations, fcl's result for each (True: no overlap), and the number near contact."""
    distance, _ = checker.distance(q)
    near = np.flatnonzero(np.abs(distance) < 0.01)[: _COMPARED // 2]
    compared = np.concatenate([q[: _COMPARED - len(near)], q[near]])
    shapes = [_fcl_shape(world, geom) for geom in range(world.model.ngeom)]
    data = world.data()
    truth = np.empty(len(compared), dtype=np.bool_)
    for i, configuration in enumerate(compared):
        data.qpos[:] = configuration
        mujoco.mj_kinematics(world.model, data)
        for geom, shape in enumerate(shapes):
            R, position = data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom]
            if world.entities[geom] == "part":
                R, position = world.T_base_object[:3, :3], world.T_base_object[:3, 3]
            shape.setTransform(fcl.Transform(R, position))
        truth[i] = not any(fcl.collide(shapes[a], shapes[b]) for a, b in world.pairs)
    return compared, truth, len(near)


def _fcl_shape(world: World, geom: int) -> fcl.CollisionObject:
    size = world.model.geom_size[geom]
    match world.model.geom_type[geom]:
        case mujoco.mjtGeom.mjGEOM_BOX:
            return fcl.CollisionObject(fcl.Box(*(2 * size)))
        case mujoco.mjtGeom.mjGEOM_CYLINDER:
            return fcl.CollisionObject(fcl.Cylinder(size[0], 2 * size[1]))
        case mujoco.mjtGeom.mjGEOM_PLANE:
            return fcl.CollisionObject(fcl.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0))
        case _:
            is_part = world.entities[geom] == "part"
            solid = world.part_hull if is_part else polytope(world.model, geom)
            faces = np.column_stack([np.full(len(solid.faces), 3), solid.faces])
            hull = fcl.Convex(np.array(solid.vertices), len(faces), faces.astype(np.int32).ravel())
            return fcl.CollisionObject(hull)

"""Mesh fixtures collide by their triangles, compared with python-fcl on the same triangles.

The fixture is a U-shaped bracket. Boxes are boxes of fcl, and cylinders are enclosed between an outer and an inner
prism. Configurations on which these two disagree, or within 10 um of the clearance, are left out.
"""

from pathlib import Path

import fcl
import mujoco
import numpy as np
import pytest
import trimesh

from benchmarks.triangle_cell import TriangleCell, polytope
from cell.robot.arm import kinematics_of
from cell.scene.model import Scene
from cell.world.checks import find_problems
from cell.world.clearance import motion_clearance
from cell.world.collision import MujocoCollisionChecker
from cell.world.model import World, compile_world
from planner.geometry.mesh import TriangleMesh
from planner.kinematics import reach
from planner.kinematics.frames import pose_from_kuka_abc
from planner.path.path import connect
from planner.values import Floats
from planner.viewpoints.viewpoints import Viewpoints

MIDDLE = np.array([1.2, 0.1, 0.1])
ABC_DEG = (25.0, 10.0, -5.0)
R = pose_from_kuka_abc(np.zeros(3), np.radians(ABC_DEG))[:3, :3]
ABOVE = 0.35  # m, the bracket over the part
UNDECIDED = 1e-5  # m
SIDES = 96
PART = trimesh.creation.box((0.1, 0.1, 0.1))


def _bracket() -> trimesh.Trimesh:
    """Return a floor and two walls of 20 mm, 620 mm apart, open above and on two sides [mm]; welded at the joints."""
    floor = trimesh.creation.box((660, 400, 20)).apply_translation((0, 0, -190))
    walls = [trimesh.creation.box((20, 400, 360)).apply_translation((x, 0, 0)) for x in (-320, 320)]
    return trimesh.util.concatenate([floor, *walls]).subdivide().subdivide()


def _world(path: Path, attached_to: str | None, collision: str) -> World:
    """Return the part below the bracket, at one place whatever it is attached to; None: no bracket."""
    bracket = {"name": "bracket U", "shape": "mesh", "path": str(path), "units": "mm", "attached_to": attached_to,
               "position_mm": [0.0, 0.0, 1000 * ABOVE] if attached_to == "object" else (1000 * MIDDLE).tolist(),
               "abc_deg": [0.0] * 3 if attached_to == "object" else ABC_DEG}  # fmt: skip
    scene = Scene.model_validate(
        {
            "placement": {"position_mm": (1000 * (MIDDLE - ABOVE * R[:, 2])).tolist(), "abc_deg": ABC_DEG},
            "post": {"enabled": False},
            "plan": {"collision": collision},
            "fixtures": [] if attached_to is None else [bracket],
        }
    )
    return compile_world(scene, PART.vertices, part_faces=np.array(PART.faces), baseline_mm=75.0)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the bracket's file."""
    file = tmp_path_factory.mktemp("fixture") / "bracket.stl"
    _bracket().export(file)
    return file


@pytest.fixture(scope="module", params=["base", "object"])
def worlds(request: pytest.FixtureRequest, path: Path) -> dict[str, World]:
    """Return the cells with the bracket attached to base or to the part, as hull and as triangles."""
    return {name: _world(path, request.param, name) for name in ("hull", "exact")}


def _solutions(world: World, T_base_scanner: Floats) -> Floats:
    q = kinematics_of(world.model).inverse(T_base_scanner @ np.linalg.inv(world.T_flange_scanner))
    q = q.reshape(-1, 6)
    q = q[np.isfinite(q).all(axis=1)]
    return np.asarray(q[((q >= world.limits.lower) & (q <= world.limits.upper)).all(axis=1)])


def _scanner_poses(count: int, rng: np.random.Generator) -> Floats:
    """Return poses (count, 4, 4) of the scanner in and around the bracket, looking roughly down."""
    T = np.tile(np.eye(4), (count, 1, 1))
    for pose in T:
        z = np.array([0.0, 0.0, -1.0]) + rng.normal(0, 0.5, 3)
        z /= np.linalg.norm(z)
        x = np.cross(rng.normal(size=3), z)
        x /= np.linalg.norm(x)
        pose[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
        pose[:3, 3] = MIDDLE + rng.uniform((-0.35, -0.35, -0.15), (0.35, 0.35, 0.4))
    return T


def _bvh(vertices: Floats, faces: np.ndarray) -> fcl.BVHModel:
    model = fcl.BVHModel()
    model.beginModel(len(vertices), len(faces))
    model.addSubModel(np.array(vertices), np.array(faces))
    model.endModel()
    return model


def _gaps(world: World, q: Floats) -> Floats:
    """Return bounds (N, 2) on the distance of the nearest moving shape from the bracket [m]."""
    mesh = _bracket()
    placed = np.array(mesh.vertices) / 1000 @ R.T + MIDDLE
    bracket = fcl.CollisionObject(_bvh(placed, mesh.faces))
    model, data = world.model, world.data()
    fixture = model.geom("bracket U").id
    shapes = {}
    for geom in {int(g) for pair in world.pairs.tolist() if fixture in pair for g in pair} - {fixture}:
        size = model.geom_size[geom]
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX:
            shapes[geom] = [fcl.CollisionObject(fcl.Box(*(2 * size)))] * 2
        elif model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
            solid = polytope(model, geom)
            shapes[geom] = [fcl.CollisionObject(_bvh(solid.vertices, solid.faces))] * 2
        else:
            prisms = [
                trimesh.creation.cylinder(r, 2 * size[1], sections=SIDES)
                for r in (size[0] / np.cos(np.pi / SIDES), size[0])
            ]
            shapes[geom] = [fcl.CollisionObject(_bvh(prism.vertices, prism.faces)) for prism in prisms]
    found = np.full((len(q), 2), 1.0)
    reach = float(np.linalg.norm(placed - MIDDLE, axis=1).max())
    for k, configuration in enumerate(q):
        data.qpos[:] = configuration
        mujoco.mj_kinematics(model, data)
        for geom, pair in shapes.items():
            position, turn = data.geom_xpos[geom].copy(), data.geom_xmat[geom].reshape(3, 3).copy()
            if np.linalg.norm(position - MIDDLE) - model.geom_rbound[geom] - reach > 2 * world.clearance:
                continue
            for side, shape in enumerate(pair):
                shape.setTransform(fcl.Transform(turn, position))
                gap = 0.0 if fcl.collide(shape, bracket) else fcl.distance(shape, bracket)
                found[k, side] = min(found[k, side], gap)
    return found


@pytest.mark.parametrize("count", [500, pytest.param(1500, marks=pytest.mark.slow)])
def test_no_contact_is_missed_and_nothing_is_refused_falsely(count: int, worlds: dict[str, World], path: Path) -> None:
    """Configurations in and around the bracket, clear of everything else; its hull rejects many."""
    world = worlds["exact"]
    q = _solutions(world, _scanner_poses(count * 2 // 3, np.random.default_rng(0)))
    q = q[MujocoCollisionChecker(_world(path, None, "exact")).free(q)][:count]
    assert len(q) == count
    low, high = _gaps(world, q).T
    free, blocked = low >= world.clearance + UNDECIDED, high < world.clearance - UNDECIDED
    assert (free | blocked).mean() > 0.98
    assert min(free.sum(), blocked.sum()) > 4 / 15 * count
    is_free = MujocoCollisionChecker(world).free(q)
    assert (is_free & blocked).sum() == 0
    assert (~is_free & free).sum() == 0
    of_hull = MujocoCollisionChecker(worlds["hull"]).free(q)
    assert (of_hull & blocked).sum() == 0
    assert (~of_hull & free).sum() > 2 / 15 * count


def test_a_view_in_the_bracket_is_reached_on_a_free_path(worlds: dict[str, World]) -> None:
    """Reach, path and clearance of a view that the hull rejects; python-fcl on all triangles along the path."""
    T = np.eye(4)
    T[:3, :3] = R @ np.diag([1.0, -1.0, -1.0])
    T[:3, 3] = MIDDLE + T[:3, :3] @ np.array([0.0, 0.0, -0.09])
    found = {}
    for name, world in worlds.items():
        one = Viewpoints(np.linalg.inv(world.T_base_object) @ T[None, None], np.zeros(1), np.full(1, 0.3), np.zeros(1))
        found[name] = reach.solve_reach(
            one, world.T_base_object, world.T_flange_scanner, kinematics_of(world.model),
            MujocoCollisionChecker(world),
        )  # fmt: skip
    assert not found["hull"].reachable.any()
    assert found["hull"].blocker[0].endswith("with bracket U")
    assert found["exact"].reachable.all()
    world = worlds["exact"]
    assert find_problems(world) == []
    checker = MujocoCollisionChecker(world)
    way = connect(world.home, found["exact"].q[0], checker, world.limits, np.random.default_rng(0))
    assert way.via is not None
    measured = motion_clearance(checker, way.via, np.zeros(len(way.via), dtype=int), 1)
    assert measured.lower_bound[0] > 0
    judge = TriangleCell(world, TriangleMesh(np.array(PART.vertices), np.array(PART.faces, dtype=np.int32)))
    dense = np.concatenate([np.linspace(a, b, 400) for a, b in zip(way.via[:-1], way.via[1:], strict=True)])
    assert judge.contacts(dense) == {}
    assert judge.nearest(dense) >= min(measured.distance[0], 0.05) - 1e-3

"""Collision verdicts and distances against python-fcl with a separate kinematic chain.

The distances of cylinders in fcl are up to a millimetre too large, so each cylinder is enclosed between a circumscribed
and an inscribed prism. Boxes and hulls are exact to 1e-6 m in fcl.
"""

import fcl
import mujoco
import numpy as np
import pytest
import trimesh

from benchmarks.triangle_cell import polytope
from cell.scene.model import Scene, pose
from cell.world.collision import MujocoCollisionChecker
from cell.world.model import World, compile_world

PART = np.array(trimesh.creation.icosphere(2, 0.12).vertices) * [1.0, 0.5, 1.3] + [0.4, 0.0, -0.2]
REQUEST = fcl.DistanceRequest(gjk_solver_type=fcl.GJKSolverType.GST_INDEP)
SIDES = 64


@pytest.fixture(scope="module")
def world() -> World:
    """Return the built-in cell with fixtures, a hull as part and the part turned."""
    fixtures = [
        {"name": "pillar", "shape": "cylinder", "size_mm": [120, 900], "position_mm": [700, -600, 0],
         "abc_deg": [0, 20, 0]},
        {"name": "clamp", "shape": "box", "size_mm": [60, 90, 30], "attached_to": "object", "position_mm": [400, 0, 0]},
    ]  # fmt: skip
    scene = Scene.model_validate(
        {"fixtures": fixtures, "placement": {"position_mm": [950, 400, 250], "abc_deg": [20, 40, 60]}}
    )
    return compile_world(scene, PART, baseline_mm=75.0)


def _convex(vertices: np.ndarray) -> fcl.Convex:
    hull = trimesh.Trimesh(*_hull(vertices))
    faces = np.column_stack([np.full(len(hull.faces), 3), hull.faces]).astype(np.int32).ravel()
    return fcl.Convex(np.array(hull.vertices), len(hull.faces), faces)


def _hull(vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    hull = trimesh.convex.convex_hull(vertices)
    return np.array(hull.vertices), np.array(hull.faces)


def _prism(radius: float, half: float) -> fcl.Convex:
    angles = np.arange(SIDES) * 2 * np.pi / SIDES
    ring = radius * np.column_stack([np.cos(angles), np.sin(angles)])
    return _convex(np.concatenate([np.column_stack([ring, np.full(SIDES, z)]) for z in (-half, half)]))


class FclCell:
    """The cell's shapes in fcl, posed by the exponentials of the joints, not by MuJoCo's kinematics."""

    def __init__(self, world: World) -> None:
        model, data = world.model, mujoco.MjData(world.model)
        mujoco.mj_kinematics(model, data)  # only for where everything is at A1..A6 = 0
        joints = [model.joint(f"A{i}").id for i in range(1, 7)]
        self.axes, self.anchors = data.xaxis[joints].copy(), data.xanchor[joints].copy()
        self.world, self.link, self.rest, self.outer, self.inner, self.radius = world, [], [], [], [], []
        for geom, name in enumerate(world.entities):
            size, kind = model.geom_size[geom], model.geom_type[geom]
            T = np.eye(4)
            T[:3, :3], T[:3, 3] = data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom]
            if name == "part":
                T, shapes = world.T_base_object.copy(), [_convex(PART)] * 2
            elif name == "clamp":
                T, shapes = world.T_base_object @ pose((400, 0, 0), (0, 0, 0)), [fcl.Box(0.06, 0.09, 0.03)] * 2
            elif name == "post":
                placed = PART @ world.T_base_object[:3, :3].T + world.T_base_object[:3, 3]
                T = np.eye(4)
                x, y, _ = np.array(world.scene.placement.position_mm) / 1000
                T[:3, 3] = x, y, placed[:, 2].min() - size[1]
                shapes = [_prism(size[0] / np.cos(np.pi / SIDES), size[1]), _prism(size[0], size[1])]
            elif kind == mujoco.mjtGeom.mjGEOM_BOX:
                shapes = [fcl.Box(*(2 * size))] * 2
            elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
                shapes = [_prism(size[0] / np.cos(np.pi / SIDES), size[1]), _prism(size[0], size[1])]
            elif kind == mujoco.mjtGeom.mjGEOM_MESH:
                shapes = [_convex(polytope(model, geom).vertices)] * 2
            else:
                T[2, 3] -= 1.0
                shapes = [fcl.Box(40.0, 40.0, 2.0)] * 2
            self.link.append(int(name[5:]) if name.startswith("link_") else 6 if name in ("housing", "bracket") else 0)
            self.rest.append(T)
            self.outer.append(fcl.CollisionObject(shapes[0]))
            self.inner.append(fcl.CollisionObject(shapes[1]))
            self.radius.append(60.0 if name == "floor" else float(np.linalg.norm(size)) if kind != 7 else 0.7)

    def place(self, q: np.ndarray) -> list[np.ndarray]:
        """Move every shape to a configuration."""
        carried = [np.eye(4)]
        for axis, anchor, angle in zip(self.axes, self.anchors, q, strict=True):
            T = np.eye(4)
            T[:3, :3] = trimesh.transformations.rotation_matrix(angle, axis)[:3, :3]
            T[:3, 3] = anchor - T[:3, :3] @ anchor
            carried.append(carried[-1] @ T)
        places = [carried[link] @ rest for link, rest in zip(self.link, self.rest, strict=True)]
        for T, outer, inner in zip(places, self.outer, self.inner, strict=True):
            for shape in (outer, inner):
                shape.setTransform(fcl.Transform(T[:3, :3], T[:3, 3]))
        return places

    def bracket(self, q: np.ndarray, reach: float) -> tuple[float, float]:
        """Return bounds on the smallest distance of the checked pairs; negative: overlap; at most `reach`."""
        places = self.place(q)
        low = high = reach
        for a, b in self.world.pairs:
            if np.linalg.norm(places[a][:3, 3] - places[b][:3, 3]) - self.radius[a] - self.radius[b] > reach:
                continue
            for shapes, inner in ((self.outer, False), (self.inner, True)):
                gap = -1.0 if fcl.collide(shapes[a], shapes[b]) else fcl.distance(shapes[a], shapes[b], REQUEST)
                if inner:
                    high = min(high, gap)
                else:
                    low = min(low, gap)
        return low, high


@pytest.fixture(scope="module")
def fcl_cell(world: World) -> FclCell:
    """Return the same cell in fcl."""
    return FclCell(world)


def test_distances_lie_between_those_of_inner_and_outer_prisms(world: World, fcl_cell: FclCell) -> None:
    """The prisms in fcl bracket every distance of random and of nearly touching configurations."""
    checker = MujocoCollisionChecker(world)
    q = np.random.default_rng(0).uniform(world.limits.lower, world.limits.upper, (6000, 6))
    distance, _ = checker.distance(q)
    beside = np.flatnonzero((distance > -0.01) & (distance < 0.02))[:90]
    rows = np.concatenate([np.arange(60), beside])
    apart = 0
    for i in rows:
        low, high = fcl_cell.bracket(q[i], 0.05)
        if distance[i] >= 0 and high >= 0:
            assert low - 1e-5 <= min(distance[i], 0.05) <= high + 1e-5
            apart += distance[i] < 0.05
        else:
            assert low <= 0
            assert distance[i] <= 1e-6
    assert apart > 40


def test_verdicts_agree_wherever_the_prisms_agree(world: World, fcl_cell: FclCell) -> None:
    """Verdicts at the clearance agree with fcl, with two thirds of the configurations within 15 mm of it."""
    checker = MujocoCollisionChecker(world)
    q = np.random.default_rng(1).uniform(world.limits.lower, world.limits.upper, (6000, 6))
    distance, _ = checker.distance(q)
    beside = np.flatnonzero(np.abs(distance - checker.clearance) < 0.015)
    rows = np.concatenate([np.arange(120), beside[:240]])
    free = checker.free(q[rows])
    decided = 0
    for verdict, configuration in zip(free, q[rows], strict=True):
        low, high = fcl_cell.bracket(configuration, 0.03)
        if (low >= checker.clearance + 1e-5) or (high < checker.clearance - 1e-5):
            decided += 1
            assert verdict == (low >= checker.clearance)
    assert decided > 0.95 * len(rows)
    assert 0.2 < free.mean() < 0.8

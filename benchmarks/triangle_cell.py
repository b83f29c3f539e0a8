"""Independent check of motions: triangles of part, tool and arm in python-fcl, moved by the joints' exponentials.

Boxes are twelve triangles, cylinders circumscribed prisms of 96 sides, polytopes, the part and mesh fixtures their own
faces: no clearance, no travel bound, and none of MuJoCo's kinematics or collision routines. Only the poses of the
shapes at A1..A6 = 0 and the checked pairs are those of the compiled cell. Base frame, metres.
"""

from collections.abc import Iterator

import fcl
import mujoco
import numpy as np
import trimesh
from numpy.typing import NDArray

from cell.world.model import World
from planner.geometry.mesh import TriangleMesh
from planner.values import Floats, Ints

_SIDES = 96


class TriangleCell:
    """The cell's shapes as triangles.

    Args:
        world: the compiled cell.
        part: the part's faces, object frame [m].
    """

    def __init__(self, world: World, part: TriangleMesh) -> None:
        model, data = world.model, world.data()
        data.qpos[:] = 0.0
        mujoco.mj_kinematics(model, data)  # only for the poses at A1..A6 = 0
        joints = [model.joint(f"A{i}").id for i in range(1, 7)]
        self._axes, self._anchors = data.xaxis[joints].copy(), data.xanchor[joints].copy()
        self._link, self._rest, self._shape, self._radius, self._half = [], [], [], [], []
        for geom, name in enumerate(world.entities):
            T = np.eye(4)
            T[:3, :3], T[:3, 3] = data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom]
            if name == "part":
                mesh, T = trimesh.Trimesh(part.vertices, part.faces, process=False), world.T_base_object.copy()
            elif name in world.fixture_meshes:
                triangles, with_part = world.fixture_meshes[name], model.geom_bodyid[geom] != 0
                mesh = trimesh.Trimesh(triangles.vertices, triangles.faces, process=False)
                T = world.T_base_object.copy() if with_part else np.eye(4)
            elif model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
                mesh = polytope(model, geom)
            else:
                mesh, T = _mesh(int(model.geom_type[geom]), model.geom_size[geom], T)
            middle = mesh.bounds.mean(axis=0)
            T[:3, 3] += T[:3, :3] @ middle
            vertices = np.array(mesh.vertices) - middle
            shape = fcl.BVHModel()
            shape.beginModel(len(vertices), len(mesh.faces))
            shape.addSubModel(vertices, np.array(mesh.faces))
            shape.endModel()
            self._shape.append(fcl.CollisionObject(shape))
            self._half.append(np.abs(vertices).max(axis=0))
            self._radius.append(float(np.linalg.norm(vertices, axis=1).max()))
            self._rest.append(T)
            turns = world.table is not None and model.body(model.geom_bodyid[geom]).name in ("object", "post")
            tool = 6 if name in ("housing", "bracket") else 0
            self._link.append(int(name[5:]) if name.startswith("link_") else 7 if turns else tool)
        if world.table is not None:  # a seventh axis of all bodies on the table
            self._axes = np.concatenate([self._axes, world.table.T_base_table[None, :3, 2]])
            self._anchors = np.concatenate([self._anchors, world.table.T_base_table[None, :3, 3]])
        self._names = world.entities
        self._pairs = sorted(map(tuple, world.pairs.tolist()))

    def _poses(self, q: Floats) -> Floats:
        """Return the poses (N, shapes, 4, 4) at joint angles (N, axes)."""
        carried = [np.tile(np.eye(4), (len(q), 1, 1))]
        for axis, anchor, angle in zip(self._axes, self._anchors, q.T, strict=True):
            x, y, z = axis
            cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
            s, c = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
            T = np.tile(np.eye(4), (len(q), 1, 1))
            T[:, :3, :3] = np.eye(3) + s * cross + (1 - c) * (cross @ cross)
            T[:, :3, 3] = anchor - T[:, :3, :3] @ anchor
            carried.append(carried[-1 if len(carried) < 7 else 0] @ T)  # the table stands on the floor
        return np.stack([carried[link] @ rest for link, rest in zip(self._link, self._rest, strict=True)], axis=1)

    def contacts(self, q: Floats) -> dict[str, int]:
        """Count the configurations (N, axes) at which triangles intersect, by pair."""
        found: dict[str, int] = {}
        for poses, a, b, near in self._near(q, 0.0):
            for i in near:
                if fcl.collide(self._at_pose(a, poses[i, a]), self._at_pose(b, poses[i, b])):
                    name = self._named(a, b)
                    found[name] = found.get(name, 0) + 1
        return found

    def nearest(self, q: Floats, reach: float = 0.05) -> float:
        """Return the smallest distance of triangles over configurations (N, axes) [m], at most `reach`."""
        return min(self.distances(q, reach).values(), default=reach)

    def distances(self, q: Floats, reach: float) -> dict[str, float]:
        """Return the smallest distance of each pair nearer than `reach` over configurations (N, axes) [m]."""
        found: dict[str, float] = {}
        for poses, a, b, near in self._near(q, reach):
            best = reach
            for i in near:
                gap = np.linalg.norm(poses[i, a, :3, 3] - poses[i, b, :3, 3]) - self._radius[a] - self._radius[b]
                if gap < best:
                    best = min(best, fcl.distance(self._at_pose(a, poses[i, a]), self._at_pose(b, poses[i, b])))
            if best < reach:
                found[self._named(a, b)] = min(best, found.get(self._named(a, b), reach))
        return found

    def _near(self, q: Floats, reach: float) -> Iterator[tuple[Floats, int, int, Ints]]:
        """Yield pairs with the configurations at which neither bounding spheres nor boxes separate them."""
        for start in range(0, len(q), 2000):
            poses = self._poses(q[start : start + 2000])
            for a, b in self._pairs:
                gap = np.linalg.norm(poses[:, a, :3, 3] - poses[:, b, :3, 3], axis=1)
                near = np.flatnonzero(gap <= self._radius[a] + self._radius[b] + reach)
                if len(near):
                    near = near[self._boxes_meet(poses[near, a], poses[near, b], a, b, reach)]
                if len(near):
                    yield poses, a, b, near

    def _boxes_meet(self, T_a: Floats, T_b: Floats, a: int, b: int, reach: float) -> NDArray[np.bool_]:
        """Return (n,) False where a face of one bounding box separates the other by more than reach."""
        into_a = T_a[:, :3, :3].transpose(0, 2, 1)
        turn = into_a @ T_b[:, :3, :3]
        shift = into_a @ (T_b[:, :3, 3] - T_a[:, :3, 3])[..., None]
        spread = np.abs(turn)
        gap_a = np.abs(shift[..., 0]) - self._half[a] - spread @ self._half[b]
        gap_b = (
            np.abs((turn.transpose(0, 2, 1) @ shift)[..., 0])
            - self._half[b]
            - spread.transpose(0, 2, 1) @ self._half[a]
        )
        return np.asarray(np.maximum(gap_a, gap_b).max(axis=1) <= reach + 1e-9)

    def _named(self, a: int, b: int) -> str:
        return f"{self._names[b]} with {self._names[a]}"

    def _at_pose(self, geom: int, T: Floats) -> fcl.CollisionObject:
        self._shape[geom].setTransform(fcl.Transform(T[:3, :3], T[:3, 3]))
        return self._shape[geom]


def polytope(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh:
    """Return the convex hull of a mesh geom in its own frame."""
    mesh = model.mesh(int(model.geom_dataid[geom]))
    start, count = int(mesh.vertadr[0]), int(mesh.vertnum[0])
    return trimesh.convex.convex_hull(model.mesh_vert[start : start + count].astype(np.float64))


def _mesh(kind: int, size: Floats, T: Floats) -> tuple[trimesh.Trimesh, Floats]:
    """Return the triangles of a primitive in its own frame, and its pose."""
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return trimesh.creation.box(2 * size), T
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        angles = np.arange(_SIDES) * 2 * np.pi / _SIDES
        ring = size[0] / np.cos(np.pi / _SIDES) * np.column_stack([np.cos(angles), np.sin(angles)])
        ends = [np.column_stack([ring, np.full(_SIDES, z)]) for z in (-size[1], size[1])]
        return trimesh.convex.convex_hull(np.concatenate(ends)), T
    if kind == mujoco.mjtGeom.mjGEOM_PLANE:
        lowered = T.copy()
        lowered[:3, 3] -= T[:3, 2] * 0.5
        return trimesh.creation.box([20.0, 20.0, 1.0]), lowered
    raise ValueError(f"a shape of MuJoCo's type {kind} has no triangles here")

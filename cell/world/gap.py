"""How far two shapes of a model are apart: by hulls, and by true triangles where a hull is more than its mesh.

A mesh none of whose faces lies deeper than `CONVEX` under its hull is taken as that hull, which contains it: MuJoCo's
GJK gives its distance. For another the hull only finds what to look at, and its triangles decide
(`cell.world.triangles`).
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np

from planner.geometry.mesh import TriangleMesh
from planner.values import Floats

if TYPE_CHECKING:
    import mujoco

    from cell.world.triangles import TriangleTree

_KIND = {6: 0, 5: 1}  # `cell.world.triangle_distance.BOX` and `CYLINDER` by MuJoCo's type of a shape

CONVEX = 1e-3
"""How deep a face may lie under a mesh's hull so that the hull stands for it [m]."""

_APART = 1e-9  # m; what triangles are asked for where a pair in contact is known already


class _Trees(Mapping[int, "TriangleTree"]):
    """Trees by geom, each built when it is first asked for: half a second where nothing comes near its hull."""

    def __init__(self, meshes: dict[int, TriangleMesh]) -> None:
        self._meshes = meshes
        self._built: dict[int, TriangleTree] = {}

    def __getitem__(self, geom: int) -> TriangleTree:
        if geom not in self._built:
            from cell.world.triangles import TriangleTree  # its kernels load numba

            self._built[geom] = TriangleTree(self._meshes[geom])
        return self._built[geom]

    def __contains__(self, geom: object) -> bool:
        return geom in self._meshes

    def __iter__(self) -> Iterator[int]:
        return iter(self._meshes)

    def __len__(self) -> int:
        return len(self._meshes)


class Shapes:
    """The shapes of a model, which answer how far two of them are apart; never changed, so that checkers share it.

    Attributes:
        trees: true triangles by the geom whose hull is in the model.
        hollow: geoms of them whose hull is more than they are.
    """

    def __init__(self, model: mujoco.MjModel, meshes: Mapping[str, TriangleMesh], hollow: Collection[str]) -> None:
        """Nothing is built before it is asked for.

        Args:
            model: that they are of.
            meshes: true triangles by the name of the geom whose hull is in the model, in the frame of its body [m].
            hollow: names of those whose hull is more than they are.
        """
        self._model = model
        self.trees = _Trees({model.geom(name).id: mesh for name, mesh in meshes.items()})
        self.hollow = frozenset(model.geom(name).id for name in hollow)
        self._kind = tuple(_KIND.get(int(kind)) for kind in model.geom_type)
        self._body = tuple(model.geom_bodyid.tolist())

    def distance(
        self,
        data: mujoco.MjData,
        a: int,
        b: int,
        reach: float,
        *,
        any_nearer: bool = False,
        points: Floats | None = None,
    ) -> float:
        """Distance of two geoms in a state of the model.

        Args:
            data: the state, kinematics up to date.
            a: a geom.
            b: another.
            reach: nothing beyond is looked for [m].
            any_nearer: below `reach`, any distance will do: enough for yes or no, and faster with triangles.
            points: (2, 3) is overwritten with the nearest points of a and b, base frame [m], where they are nearer than
                `reach`.

        Returns:
            The distance [m], `reach` where it is more, 0 or less in contact.
        """
        import mujoco

        mesh, shape = (a, b) if a in self.hollow else (b, a)
        by_triangles = mesh in self.hollow and (self._kind[shape] is not None or shape in self.trees)
        if by_triangles and any_nearer and reach > 0:  # yes or no asks for no depth
            return self._by_triangles(data, mesh, shape, reach, any_nearer=True)
        ends = None if points is None else np.empty(6)
        measured = float(mujoco.mj_geomDistance(self._model, data, a, b, reach, ends))
        if ends is not None and points is not None:
            points[:] = ends.reshape(2, 3)
        if not by_triangles or measured >= reach:
            return measured
        exact = self._by_triangles(data, mesh, shape, max(reach, _APART), any_nearer=any_nearer, points=points)
        if points is not None and mesh == a:
            points[:] = points[::-1].copy()
        # A surface has no depth: that of the hull stands for it.
        return min(exact, reach) if exact > 0 else min(exact, measured)

    def _by_triangles(
        self,
        data: mujoco.MjData,
        mesh: int,
        shape: int,
        reach: float,
        *,
        any_nearer: bool = False,
        points: Floats | None = None,
    ) -> float:
        """Distance of a shape and a mesh by its triangles; `points` are of the shape, then of the mesh."""
        tree, body, kind = self.trees[mesh], self._body[mesh], self._kind[shape]
        if kind is not None:
            return tree.distance(
                kind, self._model.geom_size[shape], data.geom_xpos[shape], data.geom_xmat[shape], data.xpos[body],
                data.xmat[body], reach, any_nearer=any_nearer, points=points,
            )  # fmt: skip
        other = self._body[shape]
        frames = (data.xpos[body], data.xmat[body]), (data.xpos[other], data.xmat[other])
        if shape not in self.hollow:
            return tree.from_hull(self.trees[shape], frames, reach, any_nearer=any_nearer, points=points)
        distance = tree.from_tree(self.trees[shape], frames, reach, any_nearer=any_nearer, points=points)
        if points is not None:
            points[:] = points[::-1].copy()
        return distance


def mesh_of(model: mujoco.MjModel, geom: int) -> TriangleMesh:
    """The triangles of a mesh geom in the frame of its body [m]."""
    import mujoco

    mesh = int(model.geom_dataid[geom])
    first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    start, number = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    R = np.empty(9)
    mujoco.mju_quat2Mat(R, model.geom_quat[geom])
    vertices = model.mesh_vert[first : first + count] @ R.reshape(3, 3).T + model.geom_pos[geom]
    return TriangleMesh(vertices, model.mesh_face[start : start + number].astype(np.int32))


def meshes_of(model: mujoco.MjModel) -> dict[str, TriangleMesh]:
    """The triangles of every mesh geom by its name, each in the frame of its body [m]."""
    import mujoco

    geoms = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_MESH)
    return {model.geom(geom).name: mesh_of(model, int(geom)) for geom in geoms}


def is_convex(mesh: TriangleMesh) -> bool:
    """Whether no face's middle or corner lies deeper than `CONVEX` under the mesh's convex hull."""
    from scipy.spatial import ConvexHull, QhullError  # kept out of the start-up

    try:
        planes = np.unique(ConvexHull(mesh.vertices).equations, axis=0)
    except QhullError:
        return False
    corners = mesh.vertices[mesh.faces]
    looked_at = np.concatenate([corners.mean(axis=1), *(corners[:, [i, i - 1]].mean(axis=1) for i in range(3))])
    depth = -(looked_at @ planes[:, :3].T + planes[:, 3]).max(axis=1)
    return bool(depth.max() <= CONVEX)

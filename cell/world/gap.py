"""How far two shapes of a model are apart: by hulls, and by true triangles where a hull is more than its mesh.

A mesh none of whose faces lies deeper than `CONVEX` under its hull is taken as that hull, which contains it: MuJoCo's
GJK gives its distance. For another the hull only finds what to look at, and its triangles decide
(`cell.world.triangles`).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING

import numpy as np

from planner.surface.mesh import TriangleMesh
from planner.values import Floats

if TYPE_CHECKING:
    import mujoco

    from cell.world.triangles import TriangleTree

CONVEX = 1e-3
"""How deep a face may lie under a mesh's hull so that the hull stands for it [m]."""

_APART = 1e-9  # m; what triangles are asked for where a pair in contact is known already
_BOX, _CYLINDER = 6, 5  # MuJoCo's


def gap(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    trees: Mapping[int, TriangleTree],
    hollow: Collection[int],
    a: int,
    b: int,
    reach: float,
    *,
    any_nearer: bool = False,
    points: Floats | None = None,
) -> float:
    """Distance of two geoms in a state of the model.

    Args:
        model: that they are of.
        data: its state, kinematics up to date.
        trees: true triangles by the geom whose hull is in the model.
        hollow: geoms of them whose hull is more than they are.
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

    mesh, shape = (a, b) if a in hollow else (b, a)
    by_triangles = mesh in hollow and (model.geom_type[shape] in (_BOX, _CYLINDER) or shape in trees)
    if by_triangles and any_nearer and reach > 0:  # yes or no asks for no depth
        return _by_triangles(model, data, trees, hollow, mesh, shape, reach, True, None)
    ends = None if points is None else np.empty(6)
    measured = float(mujoco.mj_geomDistance(model, data, a, b, reach, ends))
    if ends is not None and points is not None:
        points[:] = ends.reshape(2, 3)
    if not by_triangles or measured >= reach:
        return measured
    exact = _by_triangles(model, data, trees, hollow, mesh, shape, max(reach, _APART), any_nearer, points)
    if points is not None and mesh == a:
        points[:] = points[::-1].copy()
    # A surface has no depth: that of the hull stands for it.
    return min(exact, reach) if exact > 0 else min(exact, measured)


def _by_triangles(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    trees: Mapping[int, TriangleTree],
    hollow: Collection[int],
    mesh: int,
    shape: int,
    reach: float,
    any_nearer: bool,
    points: Floats | None,
) -> float:
    """Distance of a shape and a mesh by its triangles; `points` are of the shape, then of the mesh."""
    tree = trees[mesh]
    if shape not in trees:
        return tree.from_geom(model, data, shape, mesh, reach, any_nearer=any_nearer, points=points)
    bodies = int(model.geom_bodyid[mesh]), int(model.geom_bodyid[shape])
    asked = tree.from_tree if shape in hollow else tree.from_hull
    distance = asked(trees[shape], data, bodies, reach, any_nearer=any_nearer, points=points)
    if points is not None and shape in hollow:
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

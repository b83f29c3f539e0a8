"""Shapes of the cell: building them for MuJoCo, which pairs of them are checked, and their distances.

Checked pairs, and the reason for each unchecked one:

| pair | checked for collision |
| --- | --- |
| link_1..link_6, bracket, housing with part, post, fixtures | yes |
| link_2..link_6, bracket, housing with pedestal, floor | yes; link_1 of an upright base at the origin is above both |
| base with anything stationary | no: neither moves; `cell.world.checks` checks it once |
| links among themselves | by the robot's model: neighbours share a bearing (`cell.world.robot_spec`) |
| bracket, housing with base, link_1..link_3 | yes |
| bracket, housing with link_4, housing with link_5 | unless proven apart at all wrist angles (`self_collision.py`) |
| bracket with link_5 of the KR 16 | no: bolted to link_6, it only turns about its own end against link_5 |
| bracket with link_5 of another arm | no if they touch at all wrist angles; else as the housing |
| bracket, housing, link_6 among themselves | no: one rigid body |
| part and its fixtures on a rotary table with base, pedestal, floor, fixtures of the base | yes |
| post beside the axis of a rotary table with base, pedestal, fixtures of the base | yes; on the axis it never moves |

Every pair has the same margin, the scene's clearance. MuJoCo 4 *adds* the margins of two shapes, so each has half.

The distance of two shapes is that of their hulls (GJK of MuJoCo) where the hull represents the mesh: no face is deeper
than `planner.geometry.hull.CONVEX` below it. For any other mesh the hull only finds the pairs to measure, and the
triangles decide (`planner.geometry.distance`).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from cell.errors import SceneError, errors_as
from cell.part import mesh_files
from cell.robot import model as robot
from cell.robot.model import mesh_of
from cell.scene.model import BoxFixture, CylinderFixture, MeshFixture, Scene
from planner.errors import PlannerError
from planner.geometry.hull import solid_hull
from planner.geometry.mesh import TriangleMesh
from planner.geometry.rigid import rigid_transform, translation
from planner.kinematics.rotary_table import RotaryTable
from planner.values import Floats

if TYPE_CHECKING:
    import mujoco

    from planner.geometry.distance import TriangleTree


TABLE = "rotary table"

POST_LENGTH = 6.0
"""Length of the post's shape [m]: it ends below the floor at every placement, so that its size never changes."""

# Collision classes: a pair is checked if the contype of one matches the conaffinity of the other.
# Class 1, links among themselves, is set in models/kr16.xml.
_CELL, _GROUND, _TOOL, _TURNS, _SWINGS = 2, 4, 8, 16, 32
_CLASSES_OF_LINK = {"base": _TOOL, "link_1": _CELL | _TOOL, "link_6": _CELL | _GROUND}
"""Classes that a link is checked with; other links: all three."""


def set_robot_pairs(spec: mujoco.MjSpec, *, on_pedestal: bool = True) -> None:
    """Enable the pairs of the links with the cell.

    Args:
        spec: the robot alone.
        on_pedestal: False checks link_1 with the floor too, as does a first axis that is not upright.

    Raises:
        SceneError: if a shape of a link is no box, cylinder or mesh.
    """
    import mujoco

    # Only the pairs of the table above are disabled, not those of parent and child, which MuJoCo filters by default.
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_FILTERPARENT)
    spec.modelname = "scan_cell"
    kinds = (mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_MESH)
    on_pedestal = on_pedestal and abs(spec.joint("A1").axis[2]) > 1 - 1e-6
    for body in spec.bodies:
        classes = _CLASSES_OF_LINK.get(body.name, _CELL | _GROUND | _TOOL)
        if body.name == "link_1" and not on_pedestal:
            classes |= _GROUND
        for geom in body.geoms:
            if geom.type not in kinds:
                raise SceneError(f"the robot model's shape '{geom.name}' is no box, cylinder or mesh; replace it")
            geom.conaffinity |= classes


def add_tool(spec: mujoco.MjSpec, model: mujoco.MjModel, scene: Scene, T_flange_housing: Floats) -> None:
    """Add bracket and housing, each as a body with the flange's frame in the model of the robot alone."""
    flange, last = model.site(robot.FLANGE), spec.body("link_6")
    half = np.array(scene.housing.sides_mm) / 2000.0
    body = last.add_body(name="housing", pos=flange.pos, quat=flange.quat)
    housing = add_box(body, "housing", half, T_flange_housing, [0.1, 0.1, 0.12, 1])
    housing.contype, housing.conaffinity = _TOOL, _CELL | _GROUND
    # The bracket connects the middle of the flange with the nearest point of the housing.
    in_housing = np.linalg.inv(T_flange_housing)[:3, 3]
    end = T_flange_housing[:3, :3] @ np.clip(in_housing, -half, half) + T_flange_housing[:3, 3]
    length = float(np.linalg.norm(end))
    if scene.housing.bracket_mm > 0 and length > 1e-6:
        T = rigid_transform(_rotation_to(end / length), end / 2)
        radius = scene.housing.bracket_mm / 2000.0
        body = last.add_body(name="bracket", pos=flange.pos, quat=flange.quat)
        bracket = add_cylinder(body, "bracket", radius, length, T)
        bracket.contype, bracket.conaffinity = _TOOL, _CELL | _GROUND


def add_ground(spec: mujoco.MjSpec, scene: Scene) -> None:
    """Add the floor, and the pedestal below the robot."""
    import mujoco

    floor = spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[5.0, 5.0, 0.1])
    floor.pos, floor.rgba = [0.0, 0.0, -scene.robot.pedestal_height_mm / 1000.0], [0.8, 0.8, 0.8, 1]
    floor.contype, floor.conaffinity = _GROUND, 0
    if scene.robot.pedestal_mm is not None:
        size, middle = np.array(scene.robot.pedestal_mm) / 1000.0
        add_box(spec.worldbody, "pedestal", size / 2, translation(middle), [0.4, 0.42, 0.45, 1]).contype = _GROUND


def add_table(spec: mujoco.MjSpec, scene: Scene, table: RotaryTable) -> None:
    """Add the rotary table as a stationary cylinder below its face: its rotation changes nothing."""
    T = table.T_base_table @ translation([0, 0, -scene.table.height_mm / 2000.0])
    add_cylinder(spec.worldbody, TABLE, scene.table.diameter_mm / 2000.0, scene.table.height_mm / 1000.0, T)


def enable_table_pairs(spec: mujoco.MjSpec, *, post_swings: bool, upright: bool) -> None:
    """Check part and its fixtures with the robot's base, pedestal, floor and the base's fixtures.

    Post and table are not checked with them: they carry them.

    Args:
        spec: the cell.
        post_swings: whether the post stands beside the table's axis and is checked with the same shapes.
        upright: whether the table's axis is upright; then the post keeps its height above the floor.
    """
    for body in spec.bodies:
        for geom in body.geoms:
            if body.name == "object":
                geom.contype |= _TURNS
            elif body.name == "post" and post_swings:
                geom.contype |= _SWINGS
            elif body.name == "base" or (body.name == "world" and geom.name != TABLE):
                swings = post_swings and not (upright and geom.name == "floor")
                geom.conaffinity |= _TURNS | (_SWINGS if swings else 0)


def add_fixtures(spec: mujoco.MjSpec, scene: Scene, placed_body: mujoco.MjsBody) -> dict[str, TriangleMesh]:
    """Add every fixture to the part's body or the world; return the triangles of the mesh fixtures by name."""
    meshes = {}
    for fixture in scene.fixtures:
        body = placed_body if fixture.attached_to == "object" else spec.worldbody
        match fixture:
            case BoxFixture():
                add_box(body, fixture.name, np.array(fixture.size_mm) / 2000.0, fixture.T, [0.35, 0.5, 0.65, 1])
            case CylinderFixture():
                diameter, height = np.array(fixture.size_mm) / 1000.0
                add_cylinder(body, fixture.name, diameter / 2, height, fixture.T)
            case MeshFixture():
                meshes[fixture.name] = mesh = fixture_mesh(fixture)
                add_mesh(spec, body, fixture.name, collision_hull(mesh.vertices, f"fixture '{fixture.name}'"))
    return meshes


def collision_hull(vertices: Floats, name: str) -> TriangleMesh:
    """Return the solid convex hull of a mesh; see `planner.geometry.hull.solid_hull`.

    Raises:
        SceneError: if there is none.
    """
    with errors_as(SceneError, PlannerError):
        return solid_hull(vertices, name)


def fixture_mesh(fixture: MeshFixture) -> TriangleMesh:
    """Read the triangles of a fixture, in the frame that it is attached to [m]."""
    path = Path(fixture.path)
    vertices, faces = mesh_files.parse_metres(path, mesh_files.read_bytes(path), fixture.units)
    T = fixture.T
    return TriangleMesh(vertices @ T[:3, :3].T + T[:3, 3], faces.astype(np.int32))


def add_box(body: mujoco.MjsBody, name: str, half: Floats, T: Floats, rgba: list[float]) -> mujoco.MjsGeom:
    """Add a box of half sides (3,) at the pose T (4, 4) of its middle [m]."""
    import mujoco

    box = body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_BOX, size=half, pos=T[:3, 3], rgba=rgba)
    box.quat, box.contype, box.conaffinity = quaternion(T[:3, :3]), _CELL, 0
    return box


def add_cylinder(body: mujoco.MjsBody, name: str, radius: float, length: float, T: Floats) -> mujoco.MjsGeom:
    """Add a cylinder along z at the pose T (4, 4) of its middle; lengths [m]."""
    import mujoco

    rod = body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[radius, length / 2, 0.0], pos=T[:3, 3])
    rod.quat, rod.contype, rod.conaffinity, rod.rgba = quaternion(T[:3, :3]), _CELL, 0, [0.55, 0.55, 0.6, 1]
    return rod


def add_mesh(spec: mujoco.MjSpec, body: mujoco.MjsBody, name: str, hull: TriangleMesh) -> None:
    """Add a convex mesh, its vertices relative to its middle because the engine stores them in single precision."""
    import mujoco

    middle = (hull.vertices.min(axis=0) + hull.vertices.max(axis=0)) / 2
    spec.add_mesh(
        name=name,
        uservert=(hull.vertices - middle).ravel(),
        userface=hull.faces.ravel(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX,
    )
    geom = body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, pos=middle)
    geom.contype, geom.conaffinity, geom.rgba = _CELL, 0, [0.75, 0.6, 0.35, 1]


def quaternion(R: ArrayLike) -> Floats:
    """Return the unit quaternion (w, x, y, z) of a rotation (3, 3)."""
    import mujoco

    q = np.empty(4)
    mujoco.mju_mat2Quat(q, np.ascontiguousarray(R, dtype=np.float64).ravel())
    return q


def _rotation_to(direction: Floats) -> Floats:
    """Return a rotation (3, 3) with the unit vector `direction` as third column."""
    across = np.eye(3)[np.argmin(np.abs(direction))]
    x = np.cross(across, direction)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(direction, x), direction], axis=1)


_KIND = {6: 0, 5: 1}  # `planner.geometry.distance.BOX` and `CYLINDER` by MuJoCo's geom type

_CONTACT_REACH = 1e-9  # m; reach for the triangles of a pair whose hulls are in contact


class ShapeDistances:
    """Distances between the geoms of a model. It never changes, so checkers share it.

    Attributes:
        meshes: triangles by the geom whose hull is in the model.
        nonconvex: geoms that are measured by their triangles.
    """

    def __init__(self, model: mujoco.MjModel, meshes: Mapping[str, TriangleMesh], nonconvex: Collection[str]) -> None:
        """Prepare the distances. Trees of the triangles are built at their first use: that takes up to half a second.

        Args:
            model: the model that holds the geoms.
            meshes: triangles by the name of the geom whose hull is in the model, in the frame of its body [m].
            nonconvex: names of the meshes that their hull does not represent.
        """
        self._model = model
        self.meshes = {model.geom(name).id: mesh for name, mesh in meshes.items()}
        self._trees: dict[int, TriangleTree] = {}
        self.nonconvex = frozenset(model.geom(name).id for name in nonconvex)
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
        """Measure the distance of two geoms in a state of the model.

        Args:
            data: the state, kinematics up to date.
            a: a geom.
            b: another geom.
            reach: largest distance that is measured [m].
            any_nearer: whether any distance below `reach` is good enough: a yes or no, faster with triangles.
            points: (2, 3), overwritten with the nearest points of a and b [m], base frame, if nearer than `reach`.

        Returns:
            The distance [m]: `reach` if it is larger, 0 or less in contact.
        """
        import mujoco

        mesh, shape = (a, b) if a in self.nonconvex else (b, a)
        by_triangles = mesh in self.nonconvex and (self._kind[shape] is not None or shape in self.meshes)
        if by_triangles and any_nearer and reach > 0:  # yes or no needs no depth
            return self._by_triangles(data, mesh, shape, reach, any_nearer=True)
        ends = None if points is None else np.empty(6)
        measured = float(mujoco.mj_geomDistance(self._model, data, a, b, reach, ends))
        if ends is not None and points is not None:
            points[:] = ends.reshape(2, 3)
        if not by_triangles or measured >= reach:
            return measured
        exact = self._by_triangles(data, mesh, shape, max(reach, _CONTACT_REACH), any_nearer=any_nearer, points=points)
        if points is not None and mesh == a:
            points[:] = points[::-1].copy()
        # A surface has no depth: the depth of the hull replaces it.
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
        """Measure the distance of a shape and the triangles of a mesh; `points` are of the shape, then of the mesh."""
        tree, body, kind = self._tree(mesh), self._body[mesh], self._kind[shape]
        frame = data.xpos[body], data.xmat[body]
        if kind is not None:
            size, placement = self._model.geom_size[shape], (data.geom_xpos[shape], data.geom_xmat[shape])
            return tree.distance(kind, size, *placement, *frame, reach, any_nearer=any_nearer, points=points)
        other = self._body[shape]
        frames = frame, (data.xpos[other], data.xmat[other])
        if shape not in self.nonconvex:
            return tree.distance_to_hull(self._tree(shape), frames, reach, any_nearer=any_nearer, points=points)
        distance = tree.distance_to_tree(self._tree(shape), frames, reach, any_nearer=any_nearer, points=points)
        if points is not None:
            points[:] = points[::-1].copy()
        return distance

    def _tree(self, geom: int) -> TriangleTree:
        from planner.geometry.distance import TriangleTree  # its kernels load numba

        if geom not in self._trees:
            self._trees[geom] = TriangleTree(self.meshes[geom])
        return self._trees[geom]


def meshes_of(model: mujoco.MjModel) -> dict[str, TriangleMesh]:
    """Return the triangles of every mesh geom by name, each in the frame of its body [m]."""
    import mujoco

    geoms = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_MESH)
    return {model.geom(geom).name: mesh_of(model, int(geom)) for geom in geoms}


def enclosing_points(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> tuple[Floats, float]:
    """Return points (P, 3) and a radius [m]: a geom is inside the hull of the balls of this radius about the points.

    The points are in the base frame at the state's joint angles.
    """
    import mujoco

    size, kind = model.geom_size[geom], model.geom_type[geom]
    R, position = data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom]
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
        return position + (signs * size) @ R.T, 0.0
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return position + np.array([[0, 0, -size[1]], [0, 0, size[1]]]) @ R.T, float(size[0])
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        vertices = mesh_of(model, geom).vertices
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        corners = np.array(np.meshgrid(*np.stack([low, high], axis=1))).reshape(3, -1).T
        body = int(model.geom_bodyid[geom])
        return data.xpos[body] + corners @ data.xmat[body].reshape(3, 3).T, 0.0
    return position[None].copy(), float(model.geom_rbound[geom])

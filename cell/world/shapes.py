"""The pieces of the cell as MuJoCo shapes, and which pairs of them are guarded.

Which pairs are guarded, and why the others are not:

| pair | guarded |
| --- | --- |
| link_1..link_6, bracket, housing with part, post, fixtures | yes |
| link_2..link_6, bracket, housing with pedestal, floor | yes; link_1 of a base in the origin, upright, is above both |
| base with anything that stands still | no: neither moves; `cell.world.checks` looks once |
| links among themselves | as the robot's model says: neighbours share a bearing (`cell.world.robot_spec`) |
| bracket, housing with base, link_1..link_3 | yes |
| bracket, housing with link_4, housing with link_5 | yes, unless proven apart at all wrist angles (`wrist.py`) |
| bracket with link_5 of the KR 16 | no: bolted to link_6, it only turns about its own end against link_5 |
| bracket with link_5 of another arm | likewise where it touches at all wrist angles; else as the housing |
| bracket, housing, link_6 among themselves | no: one rigid piece |
| part and its fixtures on a rotary table with base, pedestal, floor, fixtures of the base | yes |
| post beside the axis of a rotary table with base, pedestal, fixtures of the base | yes; on it, it stays in place |

Every pair is guarded with the same margin, the scene's clearance; MuJoCo 4 *adds* the margins of two shapes, so each
carries half.

How far two shapes of a model are apart: by hulls, and by true triangles where a hull is more than its mesh.

A mesh none of whose faces lies deeper than `CONVEX` under its hull is taken as that hull, which contains it: MuJoCo's
GJK gives its distance. For another the hull only finds what to look at, and its triangles decide
(`planner.geometry.distance`).
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from cell.errors import SceneError
from cell.part import mesh_files
from cell.part.workpiece import UNITS
from cell.robot import model as robot
from cell.robot.model import mesh_of
from cell.scene.model import BoxFixture, CylinderFixture, MeshFixture, Scene
from planner.errors import PlannerError
from planner.geometry.hull import solid_hull
from planner.geometry.mesh import TriangleMesh
from planner.kinematics.rotary_table import RotaryTable
from planner.values import Floats

if TYPE_CHECKING:
    import mujoco

    from planner.geometry.distance import TriangleTree


TABLE = "rotary table"

POST_LENGTH = 6.0
"""The post's shape [m]: its top follows the part, its foot ends below the floor, so no placement changes a size."""

# Collision classes: two shapes are a candidate pair when one's type meets the other's affinity.
# The links' own class among themselves, 1, is that of models/kr16.xml.
_CELL, _GROUND, _TOOL, _TURNS, _SWINGS = 2, 4, 8, 16, 32
_LINK_MEETS = {"base": _TOOL, "link_1": _CELL | _TOOL, "link_6": _CELL | _GROUND}
"""Of the others all three."""


def set_robot_pairs(spec: mujoco.MjSpec, *, on_pedestal: bool = True) -> None:
    """Let the links meet what the table of this module pairs them with.

    Args:
        spec: the robot alone.
        on_pedestal: False lets link_1 meet the floor too, as it does where its axis is not upright.

    Raises:
        SceneError: if a shape of a link is of a kind whose distance from triangles is not known.
    """
    import mujoco

    # Only the pairs that the table above switches off are off: not what the engine takes for parent and child.
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_FILTERPARENT)
    spec.modelname = "scan_cell"
    kinds = (mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_MESH)
    on_pedestal = on_pedestal and abs(spec.joint("A1").axis[2]) > 1 - 1e-6
    for body in spec.bodies:
        meets = _LINK_MEETS.get(body.name, _CELL | _GROUND | _TOOL)
        if body.name == "link_1" and not on_pedestal:
            meets |= _GROUND
        for geom in body.geoms:
            if geom.type not in kinds:
                raise SceneError(f"the robot model's shape '{geom.name}' is no box, cylinder or mesh; make it one")
            geom.conaffinity |= meets


def add_tool(spec: mujoco.MjSpec, scene: Scene, T_flange_housing: Floats) -> None:
    """Bracket and housing, each in a body of its own whose frame is the flange's."""
    flange, last = spec.copy().compile().site(robot.FLANGE), spec.body("link_6")
    half = np.array(scene.housing.sides_mm) / 2000.0
    body = last.add_body(name="housing", pos=flange.pos, quat=flange.quat)
    housing = add_box(body, "housing", half, T_flange_housing, [0.1, 0.1, 0.12, 1])
    housing.contype, housing.conaffinity = _TOOL, _CELL | _GROUND
    # From the middle of the flange to the point of the housing that is nearest to it.
    in_housing = np.linalg.inv(T_flange_housing)[:3, 3]
    end = T_flange_housing[:3, :3] @ np.clip(in_housing, -half, half) + T_flange_housing[:3, 3]
    length = float(np.linalg.norm(end))
    if scene.housing.bracket_mm > 0 and length > 1e-6:
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = _turn_z_to(end / length), end / 2
        radius = scene.housing.bracket_mm / 2000.0
        body = last.add_body(name="bracket", pos=flange.pos, quat=flange.quat)
        bracket = add_cylinder(body, "bracket", radius, length, T)
        bracket.contype, bracket.conaffinity = _TOOL, _CELL | _GROUND


def add_ground(spec: mujoco.MjSpec, scene: Scene) -> None:
    """The floor, and the pedestal under the robot's foot."""
    import mujoco

    floor = spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[5.0, 5.0, 0.1])
    floor.pos, floor.rgba = [0.0, 0.0, -scene.robot.pedestal_height_mm / 1000.0], [0.8, 0.8, 0.8, 1]
    floor.contype, floor.conaffinity = _GROUND, 0
    if scene.robot.pedestal_mm is not None:
        size, middle = np.array(scene.robot.pedestal_mm) / 1000.0
        T = np.eye(4)
        T[:3, 3] = middle
        add_box(spec.worldbody, "pedestal", size / 2, T, [0.4, 0.42, 0.45, 1]).contype = _GROUND


def add_table(spec: mujoco.MjSpec, scene: Scene, table: RotaryTable) -> None:
    """The rotary table: a cylinder below its face. It looks the same however it has turned, so it stands."""
    middle = np.eye(4)
    middle[2, 3] = -scene.table.height_mm / 2000.0
    T = table.T_base_table @ middle
    add_cylinder(spec.worldbody, TABLE, scene.table.diameter_mm / 2000.0, scene.table.height_mm / 1000.0, T)


def enable_table_pairs(spec: mujoco.MjSpec, *, post_swings: bool, upright: bool) -> None:
    """Let the part and the fixtures on it meet what stands: robot's base, pedestal, floor and the base's fixtures.

    The post and the table carry them, and touch them.

    Args:
        spec: the cell.
        post_swings: whether the post stands beside the axis: it meets the same then.
        upright: whether it stands as high over the floor at every angle, and does not meet it.
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
    """Every fixture, on the part's body or the world's; returns the true triangles of the mesh fixtures by name."""
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
    try:
        return solid_hull(vertices, name)
    except PlannerError as error:
        raise SceneError(str(error)) from error


def fixture_mesh(fixture: MeshFixture) -> TriangleMesh:
    """The fixture's triangles in the frame that it is attached to [m]."""
    path = Path(fixture.path)
    vertices, faces = mesh_files.parse(path, mesh_files.read_bytes(path))
    T = fixture.T
    return TriangleMesh(vertices * UNITS[fixture.units] @ T[:3, :3].T + T[:3, 3], faces.astype(np.int32))


def add_box(body: mujoco.MjsBody, name: str, half: Floats, T: Floats, rgba: list[float]) -> mujoco.MjsGeom:
    """A box of half sides (3,) at the pose T (4, 4) of its middle [m]."""
    import mujoco

    box = body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_BOX, size=half, pos=T[:3, 3], rgba=rgba)
    box.quat, box.contype, box.conaffinity = quaternion(T[:3, :3]), _CELL, 0
    return box


def add_cylinder(body: mujoco.MjsBody, name: str, radius: float, length: float, T: Floats) -> mujoco.MjsGeom:
    """A cylinder along z of the pose T (4, 4), its middle there [m]; radius and length in metres."""
    import mujoco

    rod = body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[radius, length / 2, 0.0], pos=T[:3, 3])
    rod.quat, rod.contype, rod.conaffinity, rod.rgba = quaternion(T[:3, :3]), _CELL, 0, [0.55, 0.55, 0.6, 1]
    return rod


def add_mesh(spec: mujoco.MjSpec, body: mujoco.MjsBody, name: str, hull: TriangleMesh) -> None:
    """A convex shape. Its vertices are kept about its middle: the engine holds them in single precision."""
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
    """(4,) unit quaternion w, x, y, z of a rotation (3, 3)."""
    import mujoco

    q = np.empty(4)
    mujoco.mju_mat2Quat(q, np.ascontiguousarray(R, dtype=np.float64).ravel())
    return q


def _turn_z_to(direction: Floats) -> Floats:
    """(3, 3) a rotation whose third column is the unit vector `direction`."""
    across = np.eye(3)[np.argmin(np.abs(direction))]
    x = np.cross(across, direction)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(direction, x), direction], axis=1)


_KIND = {6: 0, 5: 1}  # `planner.geometry.distance.BOX` and `CYLINDER` by MuJoCo's type of a shape


_APART = 1e-9  # m; what triangles are asked for where a pair in contact is known already


class _Trees(Mapping[int, "TriangleTree"]):
    """Trees by geom, each built when it is first asked for: half a second where nothing comes near its hull."""

    def __init__(self, meshes: dict[int, TriangleMesh]) -> None:
        self._meshes = meshes
        self._built: dict[int, TriangleTree] = {}

    def __getitem__(self, geom: int) -> TriangleTree:
        if geom not in self._built:
            from planner.geometry.distance import TriangleTree  # its kernels load numba

            self._built[geom] = TriangleTree(self._meshes[geom])
        return self._built[geom]

    def __contains__(self, geom: object) -> bool:
        return geom in self._meshes

    def __iter__(self) -> Iterator[int]:
        return iter(self._meshes)

    def __len__(self) -> int:
        return len(self._meshes)


class ShapeDistances:
    """The shapes of a model, which answer how far two of them are apart; never changed, so that checkers share it.

    Attributes:
        trees: true triangles by the geom whose hull is in the model.
        nonconvex: geoms of them whose hull is more than they are.
    """

    def __init__(self, model: mujoco.MjModel, meshes: Mapping[str, TriangleMesh], nonconvex: Collection[str]) -> None:
        """Nothing is built before it is asked for.

        Args:
            model: that they are of.
            meshes: true triangles by the name of the geom whose hull is in the model, in the frame of its body [m].
            nonconvex: names of those whose hull is more than they are.
        """
        self._model = model
        self.trees = _Trees({model.geom(name).id: mesh for name, mesh in meshes.items()})
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

        mesh, shape = (a, b) if a in self.nonconvex else (b, a)
        by_triangles = mesh in self.nonconvex and (self._kind[shape] is not None or shape in self.trees)
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
        if shape not in self.nonconvex:
            return tree.from_hull(self.trees[shape], frames, reach, any_nearer=any_nearer, points=points)
        distance = tree.from_tree(self.trees[shape], frames, reach, any_nearer=any_nearer, points=points)
        if points is not None:
            points[:] = points[::-1].copy()
        return distance


def meshes_of(model: mujoco.MjModel) -> dict[str, TriangleMesh]:
    """The triangles of every mesh geom by its name, each in the frame of its body [m]."""
    import mujoco

    geoms = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_MESH)
    return {model.geom(geom).name: mesh_of(model, int(geom)) for geom in geoms}

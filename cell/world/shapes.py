"""The pieces of the cell as MuJoCo shapes, and which pairs of them are guarded.

Which pairs are guarded, and why the others are not:

| pair | guarded |
| --- | --- |
| link_1..link_6, bracket, housing with part, post, fixtures | yes |
| link_2..link_6, bracket, housing with pedestal, floor | yes; link_1 of a base in the origin turns above both |
| base with anything that stands still | no: neither moves; `cell.checks.possible` looks once |
| links among themselves | as the robot's model says: neighbours share a bearing |
| bracket, housing with base, link_1..link_3 | yes |
| bracket, housing with link_4 | yes, unless they keep apart whatever A5 and A6 are |
| housing with link_5 | yes, unless they keep apart whatever A6 is |
| bracket with link_5 | no: bolted to link_6, it only turns about its own end against link_5 |
| bracket, housing, link_6 among themselves | no: one rigid piece |

Every pair is guarded with the same margin, the scene's clearance; MuJoCo 4 *adds* the margins of two shapes, so each
carries half.
"""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from cell.errors import SceneError
from cell.part import mesh_files
from cell.part.workpiece import UNITS
from cell.robot import model as robot
from cell.scene.scene import BoxFixture, CylinderFixture, MeshFixture, Scene
from cell.world.solid_hull import solid_hull
from planner.surface.mesh import TriangleMesh
from planner.values import Floats

if TYPE_CHECKING:
    import mujoco

    from cell.world.gap import Shapes

POST_LENGTH = 6.0
"""The post's shape [m]: its top follows the part, its foot ends below the floor, so no placement changes a size."""

# Collision classes: two shapes are a candidate pair when one's type meets the other's affinity.
_CELL, _GROUND, _TOOL = 2, 4, 8  # the links' own class among themselves, 1, is that of models/kr16.xml
_LINK_MEETS = {
    "base": _TOOL,
    "link_1": _CELL | _TOOL,
    "link_2": _CELL | _GROUND | _TOOL,
    "link_3": _CELL | _GROUND | _TOOL,
    "link_4": _CELL | _GROUND | _TOOL,
    "link_5": _CELL | _GROUND | _TOOL,
    "link_6": _CELL | _GROUND,
}


_WRIST_STEP = np.deg2rad(3.0)
_APART = 0.01  # m


def prepare_robot(spec: mujoco.MjSpec, *, on_pedestal: bool = True) -> None:
    """Let the links meet what the table of this module pairs them with.

    Args:
        spec: the robot alone.
        on_pedestal: False lets link_1 meet the floor too.

    Raises:
        SceneError: if a shape of a link is of a kind whose distance from triangles is not known.
    """
    import mujoco

    # Only the pairs that the table above switches off are off: not what the engine takes for parent and child.
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_FILTERPARENT)
    spec.modelname = "scan_cell"
    kinds = (mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_MESH)
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
    import mujoco

    flange, last = spec.copy().compile().site(robot.FLANGE), spec.body("link_6")
    half = np.array(scene.housing.sides_mm) / 2000.0
    last.add_body(name="housing", pos=flange.pos, quat=flange.quat).add_geom(
        name="housing",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=half,
        pos=T_flange_housing[:3, 3],
        quat=quaternion(T_flange_housing[:3, :3]),
        contype=_TOOL,
        conaffinity=_CELL | _GROUND,
        rgba=[0.1, 0.1, 0.12, 1],
    )
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
        spec.add_exclude(name="bolted_bracket_link_5", bodyname1="bracket", bodyname2="link_5")


def exclude_what_the_wrist_keeps_apart(spec: mujoco.MjSpec, model: mujoco.MjModel, clearance: float) -> None:
    """Switch off the pairs of bracket or housing with link_4 or link_5 that keep apart at all wrist angles.

    Apart means by the clearance [m] or, where that is larger, by `_APART`: what the mount fixes is no collision, and a
    large clearance to the cell must not make every configuration one.
    """
    pieces = [name for name in ("housing", "bracket") if spec.geom(name) is not None]
    apart = [
        (piece, link)
        for piece in pieces
        for link, axes in (("link_5", ("A6",)), ("link_4", ("A5", "A6")))
        if (piece, link) != ("bracket", "link_5")
        and _wrist_keeps_apart(model, piece, link, axes, min(clearance, _APART))
    ]
    for piece, link in apart:
        spec.add_exclude(name=f"apart_{piece}_{link}", bodyname1=piece, bodyname2=link)


def _wrist_keeps_apart(model: mujoco.MjModel, piece: str, link: str, axes: tuple[str, ...], clearance: float) -> bool:
    """Whether a piece of the tool keeps the clearance from a link at every angle of the axes between the two.

    Looked at on a grid of angles. From a node of the grid to any angle half a step away no point of the piece moves
    farther than half a step times its distance from the axis, per axis; no axis is farther than the sum of what is
    between the two anchors and from the last to the point.
    """
    import mujoco

    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    geom = model.geom(piece).id
    shapes = np.flatnonzero(model.geom_bodyid == model.body(link).id)
    joints = [model.joint(axis) for axis in axes]
    first, nearest = data.xanchor[joints[0].id], data.xanchor[joints[-1].id]
    farthest = float(np.linalg.norm(data.geom_xpos[geom] - nearest) + model.geom_rbound[geom])
    farthest += float(np.linalg.norm(first - nearest))  # 0 where the wrist is spherical
    grids, slack = [], 0.0
    for joint in joints:
        low, high = joint.range if joint.name == "A5" else (0.0, 2 * np.pi)
        angles, step = np.linspace(low, high, int(np.ceil((high - low) / _WRIST_STEP)) + 1, retstep=True)
        grids.append(angles)
        slack += farthest * step / 2
    reach = clearance + slack
    addresses = [int(joint.qposadr[0]) for joint in joints]
    for angles in itertools.product(*grids):
        data.qpos[addresses] = angles
        mujoco.mj_kinematics(model, data)
        if any(mujoco.mj_geomDistance(model, data, geom, shape, reach, None) < reach for shape in shapes):
            return False
    return True


def kept_by_the_wrist(model: mujoco.MjModel, shapes: Shapes, clearance: float) -> dict[tuple[int, int], float]:
    """What bracket and housing keep of link_4 and link_5 where the mount holds them nearer than the clearance [m].

    Looked at on a grid of wrist angles, as `cell.world.robot_spec` looks at two links of an arm from a file: half of
    the smallest distance of two that never touch, half of the largest of two that do.
    """
    import mujoco

    data, kept = mujoco.MjData(model), {}
    joints = [model.joint(axis) for axis in ("A5", "A6")]
    grids = [np.arange(max(low, -np.pi), min(high, np.pi), 2 * _WRIST_STEP) for low, high in (j.range for j in joints)]
    names = [name for name in ("housing", "bracket") if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name) >= 0]
    pairs = {
        (model.geom(name).id, int(geom)): [np.inf, 0.0]
        for name in names
        for link in ("link_4", "link_5")
        for geom in np.flatnonzero(model.geom_bodyid == model.body(link).id)
    }
    for angles in itertools.product(*grids):
        data.qpos[[int(joint.qposadr[0]) for joint in joints]] = angles
        mujoco.mj_kinematics(model, data)
        for pair, found in pairs.items():
            apart = shapes.distance(data, *pair, 2 * clearance)
            found[:] = min(found[0], apart), max(found[1], apart)
    for (a, b), (lowest, widest) in pairs.items():
        keep = (lowest if lowest > 0 else widest) / 2
        if keep < clearance:
            kept[a, b] = kept[b, a] = keep
    return kept


def add_ground(spec: mujoco.MjSpec, scene: Scene) -> None:
    """The floor, and the pedestal under the robot's foot."""
    import mujoco

    ground = {"contype": _GROUND, "conaffinity": 0}
    spec.worldbody.add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[5.0, 5.0, 0.1],
        pos=[0.0, 0.0, -scene.robot.pedestal_height_mm / 1000.0],
        rgba=[0.8, 0.8, 0.8, 1],
        **ground,
    )
    if scene.robot.pedestal_mm is not None:
        size, middle = np.array(scene.robot.pedestal_mm) / 1000.0
        spec.worldbody.add_geom(
            name="pedestal",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=size / 2,
            pos=middle,
            rgba=[0.4, 0.42, 0.45, 1],
            **ground,
        )


def add_fixtures(spec: mujoco.MjSpec, scene: Scene, placed_body: mujoco.MjsBody) -> dict[str, TriangleMesh]:
    """Every fixture, on the part's body or the world's; returns the true triangles of the mesh fixtures by name."""
    import mujoco

    meshes = {}
    for fixture in scene.fixtures:
        body = placed_body if fixture.attached_to == "object" else spec.worldbody
        match fixture:
            case BoxFixture():
                geom = body.add_geom(
                    name=fixture.name,
                    type=mujoco.mjtGeom.mjGEOM_BOX,
                    size=np.array(fixture.size_mm) / 2000.0,
                    pos=fixture.T[:3, 3],
                    quat=quaternion(fixture.T[:3, :3]),
                    rgba=[0.35, 0.5, 0.65, 1],
                )
                geom.contype, geom.conaffinity = _CELL, 0
            case CylinderFixture():
                diameter, height = np.array(fixture.size_mm) / 1000.0
                add_cylinder(body, fixture.name, diameter / 2, height, fixture.T)
            case MeshFixture():
                meshes[fixture.name] = mesh = fixture_mesh(fixture)
                add_mesh(spec, body, fixture.name, solid_hull(mesh.vertices, f"fixture '{fixture.name}'"))
    return meshes


def fixture_mesh(fixture: MeshFixture) -> TriangleMesh:
    """The fixture's triangles in the frame that it is attached to [m]."""
    path = Path(fixture.path)
    vertices, faces = mesh_files.parse(path, mesh_files.read_bytes(path))
    T = fixture.T
    return TriangleMesh(vertices * UNITS[fixture.units] @ T[:3, :3].T + T[:3, 3], faces.astype(np.int32))


def add_cylinder(body: mujoco.MjsBody, name: str, radius: float, length: float, T: Floats) -> mujoco.MjsGeom:
    """A cylinder along z of the pose T (4, 4), its middle there [m]; radius and length in metres."""
    import mujoco

    return body.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        size=[radius, length / 2, 0.0],
        pos=T[:3, 3],
        quat=quaternion(T[:3, :3]),
        contype=_CELL,
        conaffinity=0,
        rgba=[0.55, 0.55, 0.6, 1],
    )


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
    body.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname=name,
        pos=middle,
        contype=_CELL,
        conaffinity=0,
        rgba=[0.75, 0.6, 0.35, 1],
    )


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

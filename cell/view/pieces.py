"""Geometry of the cell as coloured triangles: fixed pieces in base, moving pieces in the frame of their link.

The shapes are those of the checked MuJoCo model; part and mesh fixtures have their true triangles. Metres.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated

import numpy as np
from numpy.typing import NDArray

from cell.robot import model as robot
from cell.robot.model import FLANGE
from cell.runs.run import Run, reading
from cell.runs.schema import ResolvedScene, ScannerKeys
from cell.view.palette import MATERIALS, Material, material_of
from cell.view.rays import frustum_corners
from cell.world.model import World
from cell.world.occluders import geom_triangles, occluders_of_model
from cell.world.shapes import quaternion
from planner.geometry.mesh import TriangleMesh, without_unused
from planner.geometry.rigid import rigid_transform
from planner.ports import ARM_AXES
from planner.values import Bools, Floats, Ints, Value

if TYPE_CHECKING:
    import mujoco

_TOOL = ("bracket", "housing")

IGNORED = "part, not required"
"""Name of the piece of the part outside all regions that count."""


@dataclass(frozen=True, slots=True, eq=False)
class Piece(Value):
    """A named surface of one colour.

    Attributes:
        name: "robot", "scanner", "post" or a fixture's name; pieces with one name are hidden together.
        link: number of its frame: 0 the base, 1 to 6 the links, then bodies on mimic joints, then a rotary table.
        vertices: [m].
        faces: outward.
        rgb: from 0 to 1.
    """

    name: str
    link: int
    vertices: Annotated[Floats, "V 3"]
    faces: Annotated[NDArray[np.int32], "F 3"]
    rgb: Annotated[Floats, "3"]


@dataclass(frozen=True, slots=True, eq=False)
class ArmChain(Value):
    """Kinematic chain of the arm: link_1 to link_6, bodies on mimic joints, a rotary table.

    Attributes:
        T_parent_link: pose of each body in its parent [m] at the model's reference angles.
        parent: number of the parent: 0 the base, 1 to 6 the links, then the others.
        driver: number of the joint angle that turns the body.
        ratio: angle of the body per joint angle.
        reference: angle of the body in the reference configuration [rad].
        axis: of the joint, through the origin of the body's frame and in this frame.
        T_link_scanner: pose of the scanner in link_6 [m].
        home: joint angles [rad].
        limits: smallest and largest joint angles [rad].
    """

    T_parent_link: Annotated[Floats, "k 4 4"]
    parent: Annotated[Ints, "k"]
    driver: Annotated[Ints, "k"]
    ratio: Annotated[Floats, "k"]
    reference: Annotated[Floats, "k"]
    axis: Annotated[Floats, "k 3"]
    T_link_scanner: Annotated[Floats, "4 4"]
    home: Annotated[Floats, "_"]
    limits: Annotated[Floats, "_ 2"]

    def link_poses(self, q: Floats) -> Floats:
        """Return (1 + k, 4, 4) the poses of base and bodies in base [m] at (axes,) joint angles [rad]."""
        from scipy.spatial.transform import Rotation

        rotations = np.tile(np.eye(4), (len(self.axis), 1, 1))
        angles = np.asarray(q)[self.driver] * self.ratio
        rotations[:, :3, :3] = Rotation.from_rotvec(self.axis * (angles - self.reference)[:, None]).as_matrix()
        poses = [np.eye(4)]
        for parent, T, rotation in zip(self.parent, self.T_parent_link, rotations, strict=True):
            poses.append(poses[parent] @ T @ rotation)
        return np.stack(poses)


@dataclass(frozen=True, slots=True, eq=False)
class CellGeometry:
    """Pieces of a cell without the part, the arm's chain, and the placement of the part.

    Attributes:
        pieces: robot, scanner, post, pedestal, fixtures, floor.
        arm: the chain.
        T_base_object: (4, 4) placement [m].
        frustum: (4, 3) far corners of the measuring volume, scanner frame with the source as its origin [m].
        part_link: number of the link that carries the part: that of a rotary table, or 0.
        T_part_link_base: (4, 4) base in that link at angle 0 [m].
    """

    pieces: tuple[Piece, ...]
    arm: ArmChain
    T_base_object: Floats
    frustum: Floats
    part_link: int
    T_part_link_base: Floats

    def table_motion(self, q: Floats) -> Floats:
        """Return the (4, 4) displacement by a rotary table in base [m] at (axes,) joint angles [rad]."""
        turned: Floats = self.arm.link_poses(q)[self.part_link] @ self.T_part_link_base
        return turned


def cell_of_run(run: Run, scene: ResolvedScene) -> CellGeometry:
    """Return the cell of a run from its `cell.xml` and fixture files.

    Raises:
        FileError: if a file is missing, changed or damaged.
    """
    import mujoco

    model = run.cell_model()
    data, T = mujoco.MjData(model), scene.T_base_object
    meshes = {each.name: run.mesh(each.file) for each in scene.fixtures if each.file is not None}
    with reading(run.folder / "cell.xml"):
        data.mocap_quat[model.body("object").mocapid] = quaternion(T[:3, :3])
        data.qpos[:] = robot.MimicJoints.from_model(model).qpos(np.radians(scene.home_deg))
        mujoco.mj_kinematics(model, data)
        table = None if scene.table is None else scene.table.T_base_table
        return _cell_geometry(model, data, T, meshes, (scene.T_flange_scanner, table), _frustum_of(scene.scanner))


def cell_of_world(world: World, scanner: ScannerKeys) -> CellGeometry:
    """Return the cell of a compiled scene with this scanner, at its own placement and with the arm at home."""
    frames = world.T_flange_scanner, None if world.table is None else world.table.T_base_table
    return _cell_geometry(
        world.model, world.data(), world.T_base_object, world.fixture_meshes, frames, _frustum_of(scanner)
    )


def _frustum_of(scanner: ScannerKeys) -> Floats:
    """Return the (4, 3) far corners of a scanner's measuring volume [m], scanner frame."""
    return frustum_corners(scanner.opening_deg, scanner.drawn_range_mm[1] / 1000)


def with_ignored_faces(cell: CellGeometry, part: TriangleMesh, ignored: Bools | None) -> CellGeometry:
    """Return the cell with the ignored faces of the part as a separate piece.

    Args:
        cell: robot and surroundings.
        part: object frame.
        ignored: (F,) faces outside all regions that count; None for none.
    """
    if ignored is None or not ignored.any():
        return cell
    surface, T = without_unused(part.vertices, part.faces[ignored]), cell.T_part_link_base @ cell.T_base_object
    vertices = surface.vertices @ T[:3, :3].T + T[:3, 3]
    piece = Piece(IGNORED, cell.part_link, vertices, surface.faces, _rgb("surface"))
    return replace(cell, pieces=(*cell.pieces, piece))


def place_pieces(pieces: Sequence[Piece], link_poses: Floats) -> list[Piece]:
    """Return the pieces in base.

    Args:
        pieces: in the frames of their links.
        link_poses: from `ArmChain.link_poses` [m].
    """
    placed = []
    for piece in pieces:
        T = link_poses[piece.link]
        placed.append(Piece(piece.name, 0, piece.vertices @ T[:3, :3].T + T[:3, 3], piece.faces, piece.rgb))
    return placed


def _cell_geometry(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    T_base_object: Floats,
    meshes: Mapping[str, TriangleMesh],
    frames: tuple[Floats, Floats | None],
    frustum: Floats,
) -> CellGeometry:
    """Return the cell of a compiled model whose state has part and post at the placement and the arm at home.

    `frames` are T_flange_scanner and, with a rotary table, T_base_table.
    """
    T_flange_scanner, T_base_table = frames
    names = robot.bodies(model)  # the base of the robot is fixed: its shapes are in the cell's frame
    link_poses = np.tile(np.eye(4), (len(names), 1, 1))
    for number, name in enumerate(names[1:], 1):
        link_poses[number] = robot.frame_of(data.body(name))
    pieces, table = [], 0 if T_base_table is None else len(names)
    turned = {model.body(name).id for name in ("object", "post")}
    T_part_link_base: Floats = np.linalg.inv(np.eye(4) if T_base_table is None else T_base_table).astype(np.float64)
    for occluder in occluders_of_model(data, T_base_object, meshes, ()):
        link = table if int(model.geom(occluder.name).bodyid[0]) in turned else 0
        T = T_part_link_base @ T_base_object if link else T_base_object
        vertices = occluder.vertices @ T[:3, :3].T + T[:3, 3]
        rgb = _rgb(material_of(occluder.name, is_robot=False))
        pieces.append(Piece(occluder.name, link, vertices, occluder.faces, rgb))
    for geom in range(model.ngeom):
        body = model.body(model.geom_bodyid[geom]).name
        if body not in (*names, *_TOOL):
            continue
        link = names.index(body) if body in names else names.index("link_6")
        T = np.linalg.inv(link_poses[link])
        vertices, faces = geom_triangles(model, data, geom)
        material = material_of(model.geom(geom).name, is_robot=body in names)
        name = "robot" if body in names else "scanner"
        pieces.append(Piece(name, link, vertices @ T[:3, :3].T + T[:3, 3], faces, _rgb(material)))
    T_base_flange = robot.frame_of(data.site(FLANGE))
    arm = _arm_chain(model, data, np.linalg.inv(link_poses[6]) @ T_base_flange @ T_flange_scanner)
    if T_base_table is not None:
        arm = _with_table(arm, T_base_table)
    return CellGeometry(tuple(pieces), arm, np.asarray(T_base_object), frustum, table, T_part_link_base)


def _with_table(arm: ArmChain, T_base_table: Floats) -> ArmChain:
    """Return the chain with a rotary table as its last link, which E1 turns about z."""
    return replace(
        arm,
        T_parent_link=np.concatenate([arm.T_parent_link, T_base_table[None]]),
        parent=np.append(arm.parent, 0),
        driver=np.append(arm.driver, ARM_AXES),
        ratio=np.append(arm.ratio, 1.0),
        reference=np.append(arm.reference, 0.0),
        axis=np.concatenate([arm.axis, [[0.0, 0.0, 1.0]]]),
        home=np.append(arm.home, 0.0),
        limits=np.append(arm.limits, [[-2 * np.pi, 2 * np.pi]], axis=0),
    )


def _arm_chain(model: mujoco.MjModel, data: mujoco.MjData, T_link_scanner: Floats) -> ArmChain:
    """Return the chain of a compiled model whose state has the arm at home."""
    names, followers = robot.bodies(model), robot.MimicJoints.from_model(model)
    joints = [int(model.body(name).jntadr[0]) for name in names[1:]]
    T_parent_link = np.stack([_relative(model, name) for name in names[1:]])
    T_parent_link[0] = _relative(model, "base") @ T_parent_link[0]
    return ArmChain(
        T_parent_link,
        np.array([names.index(model.body(model.body(name).parentid[0]).name) for name in names[1:]]),
        np.concatenate([np.arange(6), followers.axis]),
        np.concatenate([np.ones(6), followers.ratio]),
        model.qpos0[joints],
        model.jnt_axis[joints],
        T_link_scanner,
        np.array(data.qpos[:6]),
        np.array(model.jnt_range[joints[:6]]),
    )


def _relative(model: mujoco.MjModel, body: str) -> Floats:
    """Return the (4, 4) pose of a body in its parent [m]."""
    from scipy.spatial.transform import Rotation

    rotation = Rotation.from_quat(model.body(body).quat, scalar_first=True)
    return rigid_transform(rotation.as_matrix(), model.body(body).pos)


def _rgb(material: Material) -> Floats:
    return np.array(MATERIALS[material])

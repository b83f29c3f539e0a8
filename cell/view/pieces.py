"""The cell as coloured triangles for the eye: what stands still in base, what moves in the frame of its link.

The shapes are those of the checked MuJoCo model; part and mesh fixtures are their true triangles. Metres.
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
from cell.view.palette import LOOKS, Look, look_of
from cell.view.rays import frustum
from cell.world.model import World
from cell.world.occluders import geom_triangles, occluders_of_model
from cell.world.shapes import quaternion
from planner.geometry.mesh import TriangleMesh
from planner.ports import ARM_AXES
from planner.values import Bools, Floats, Ints, Value

if TYPE_CHECKING:
    import mujoco

_TOOL = ("bracket", "housing")

ASIDE = "part, not asked for"
"""Name of what nobody cares for of a part."""


@dataclass(frozen=True, slots=True, eq=False)
class Piece(Value):
    """A named surface of one colour.

    Attributes:
        name: what a reader calls it ("robot", "scanner", "post", a fixture's name); pieces of one name hide together.
        link: in whose frame it is: 0 the cell's, 1 to 6 the links, then what these drive along, then a rotary table.
        vertices: (V, 3) [m].
        faces: (F, 3) int32, outward.
        rgb: (3,) from 0 to 1.
    """

    name: str
    link: int
    vertices: Annotated[Floats, "V 3"]
    faces: Annotated[NDArray[np.int32], "F 3"]
    rgb: Annotated[Floats, "3"]


@dataclass(frozen=True, slots=True, eq=False)
class Arm(Value):
    """The chain of the arm, enough to place its links: link_1 to link_6, what these drive along, a rotary table.

    Attributes:
        T_parent_link: (k, 4, 4) of each in its parent [m] at the model's reference angles.
        parent: (k,) number of the parent: 0 the cell's frame, 1 to 6 the links, then the others.
        driver: (k,) which of the joint angles turns it.
        ratio: (k,) by how much of it.
        reference: (k,) its own angle in the reference [rad].
        axis: (k, 3) of the joint, in the link's frame and through its origin.
        T_link_scanner: (4, 4) of the scanner in link_6 [m].
        home: (axes,) [rad].
    """

    T_parent_link: Annotated[Floats, "k 4 4"]
    parent: Annotated[Ints, "k"]
    driver: Annotated[Ints, "k"]
    ratio: Annotated[Floats, "k"]
    reference: Annotated[Floats, "k"]
    axis: Annotated[Floats, "k 3"]
    T_link_scanner: Annotated[Floats, "4 4"]
    home: Annotated[Floats, "_"]

    def links(self, q: Floats) -> Floats:
        """(1 + k, 4, 4) the cell's frame, and each link in it [m], at (axes,) joint angles [rad]."""
        from scipy.spatial.transform import Rotation

        turns = np.tile(np.eye(4), (len(self.axis), 1, 1))
        angles = np.asarray(q)[self.driver] * self.ratio
        turns[:, :3, :3] = Rotation.from_rotvec(self.axis * (angles - self.reference)[:, None]).as_matrix()
        placed = [np.eye(4)]
        for parent, T, turn in zip(self.parent, self.T_parent_link, turns, strict=True):
            placed.append(placed[parent] @ T @ turn)
        return np.stack(placed)


@dataclass(frozen=True, slots=True, eq=False)
class Cell:
    """A cell to be looked at: everything but the part, the arm's chain, and where the part stands.

    Attributes:
        pieces: robot, scanner, post, pedestal, fixtures, floor.
        arm: the chain.
        T_base_object: (4, 4) placement [m].
        frustum: (4, 3) far corners of what the scanner sees, its source at the origin, scanner frame [m].
        turns: link that the part is on: that of a rotary table; 0: it stands.
        T_turns_base: (4, 4) base in that link at angle 0 [m].
    """

    pieces: tuple[Piece, ...]
    arm: Arm
    T_base_object: Floats
    frustum: Floats
    turns: int
    T_turns_base: Floats

    def turn(self, q: Floats) -> Floats:
        """(4, 4) what a rotary table does to what stands on it [m], base frame, at (axes,) joint angles [rad]."""
        turned: Floats = self.arm.links(q)[self.turns] @ self.T_turns_base
        return turned


def cell_of_run(run: Run, scene: ResolvedScene) -> Cell:
    """The cell of a run, from its `cell.xml` and fixture files.

    Raises:
        FileError: if one of these is missing, changed or damaged.
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
        return _cell(model, data, T, meshes, (scene.T_flange_scanner, table), _seen_by(scene.scanner))


def cell_of_world(world: World, scanner: ScannerKeys) -> Cell:
    """The cell of a compiled scene at its own placement, the arm at home.

    Args:
        world: the compiled scene.
        scanner: what defines it.
    """
    frames = world.T_flange_scanner, None if world.table is None else world.table.T_base_table
    return _cell(world.model, world.data(), world.T_base_object, world.fixture_meshes, frames, _seen_by(scanner))


def _seen_by(scanner: ScannerKeys) -> Floats:
    """(4, 3) far corners of what a scanner sees [m], scanner frame."""
    return frustum(scanner.opening_deg, scanner.drawn_range_mm[1] / 1000)


def beside(cell: Cell, part: TriangleMesh, aside: Bools | None) -> Cell:
    """The cell with what nobody cares for of the part, which is then drawn without it.

    Args:
        cell: robot and surroundings.
        part: object frame.
        aside: (F,) its faces that nobody cares for; None: there are none.
    """
    if aside is None or not aside.any():
        return cell
    T = cell.T_base_object
    used, faces = np.unique(part.faces[aside], return_inverse=True)
    T = cell.T_turns_base @ T
    vertices = part.vertices[used] @ T[:3, :3].T + T[:3, 3]
    piece = Piece(ASIDE, cell.turns, vertices, faces.reshape(-1, 3).astype(np.int32), _rgb("surface"))
    return replace(cell, pieces=(*cell.pieces, piece))


def placed(pieces: Sequence[Piece], links: Floats) -> list[Piece]:
    """The pieces where the arm stands.

    Args:
        pieces: in the frames of their links.
        links: from `Arm.links` [m].
    """
    moved = []
    for piece in pieces:
        T = links[piece.link]
        moved.append(Piece(piece.name, 0, piece.vertices @ T[:3, :3].T + T[:3, 3], piece.faces, piece.rgb))
    return moved


def _cell(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    T_base_object: Floats,
    meshes: Mapping[str, TriangleMesh],
    frames: tuple[Floats, Floats | None],
    frustum: Floats,
) -> Cell:
    """The cell of a compiled model whose state has part and post at the placement and the arm at home.

    `frames` are T_flange_scanner and, where a rotary table turns the part, T_base_table.
    """
    T_flange_scanner, T_base_table = frames
    names = robot.bodies(model)  # the base does not move: what is on it is given in the cell's frame
    links = np.tile(np.eye(4), (len(names), 1, 1))
    for number, name in enumerate(names[1:], 1):
        links[number, :3, :3], links[number, :3, 3] = data.body(name).xmat.reshape(3, 3), data.body(name).xpos
    pieces, table = [], 0 if T_base_table is None else len(names)
    turned = {model.body(name).id for name in ("object", "post")}
    T_turns_base: Floats = np.linalg.inv(np.eye(4) if T_base_table is None else T_base_table).astype(np.float64)
    for occluder in occluders_of_model(data, T_base_object, meshes, ()):
        link = table if int(model.geom(occluder.name).bodyid[0]) in turned else 0
        T = T_turns_base @ T_base_object if link else T_base_object
        vertices = occluder.vertices @ T[:3, :3].T + T[:3, 3]
        rgb = _rgb(look_of(occluder.name, of_robot=False))
        pieces.append(Piece(occluder.name, link, vertices, occluder.faces, rgb))
    for geom in range(model.ngeom):
        body = model.body(model.geom_bodyid[geom]).name
        if body not in (*names, *_TOOL):
            continue
        link = names.index(body) if body in names else names.index("link_6")
        T = np.linalg.inv(links[link])
        vertices, faces = geom_triangles(model, data, geom)
        look = look_of(model.geom(geom).name, of_robot=body in names)
        name = "robot" if body in names else "scanner"
        pieces.append(Piece(name, link, vertices @ T[:3, :3].T + T[:3, 3], faces, _rgb(look)))
    flange = np.eye(4)
    flange[:3, :3], flange[:3, 3] = data.site(FLANGE).xmat.reshape(3, 3), data.site(FLANGE).xpos
    arm = _arm(model, data, np.linalg.inv(links[6]) @ flange @ T_flange_scanner)
    if T_base_table is not None:
        arm = _with_table(arm, T_base_table)
    return Cell(tuple(pieces), arm, np.asarray(T_base_object), frustum, table, T_turns_base)


def _with_table(arm: Arm, T_base_table: Floats) -> Arm:
    """The chain with a rotary table as its last link, which E1 turns about z."""
    return replace(
        arm,
        T_parent_link=np.concatenate([arm.T_parent_link, T_base_table[None]]),
        parent=np.append(arm.parent, 0),
        driver=np.append(arm.driver, ARM_AXES),
        ratio=np.append(arm.ratio, 1.0),
        reference=np.append(arm.reference, 0.0),
        axis=np.concatenate([arm.axis, [[0.0, 0.0, 1.0]]]),
        home=np.append(arm.home, 0.0),
    )


def _arm(model: mujoco.MjModel, data: mujoco.MjData, T_link_scanner: Floats) -> Arm:
    """The chain of a compiled model whose state has the arm at home."""
    names, followers = robot.bodies(model), robot.MimicJoints.from_model(model)
    joints = [int(model.body(name).jntadr[0]) for name in names[1:]]
    T_parent_link = np.stack([_relative(model, name) for name in names[1:]])
    T_parent_link[0] = _relative(model, "base") @ T_parent_link[0]
    return Arm(
        T_parent_link,
        np.array([names.index(model.body(model.body(name).parentid[0]).name) for name in names[1:]]),
        np.concatenate([np.arange(6), followers.axis]),
        np.concatenate([np.ones(6), followers.ratio]),
        model.qpos0[joints],
        model.jnt_axis[joints],
        T_link_scanner,
        np.array(data.qpos[:6]),
    )


def _relative(model: mujoco.MjModel, body: str) -> Floats:
    """(4, 4) pose of a body in its parent [m]."""
    from scipy.spatial.transform import Rotation

    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat(model.body(body).quat, scalar_first=True).as_matrix()
    T[:3, 3] = model.body(body).pos
    return T


def _rgb(look: Look) -> Floats:
    return np.array(LOOKS[look])

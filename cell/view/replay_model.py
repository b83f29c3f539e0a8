"""Model for replay: the checked cell of a run folder with colours and visual meshes.

Made from the run's `cell.xml`. Its geoms, poses, joints and collision pairs stay as they were checked. Colours, light
and sky are added. The true surfaces of the part (`reference.ply`) and of mesh fixtures replace their hulls in the
picture and take no part in collisions; the hulls move to a hidden group (key 4 in the viewer shows it). World frame =
base frame, metres.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np

from cell.errors import FileError
from cell.robot import model as robot
from cell.runs.cell import table_of
from cell.runs.run import Run
from cell.runs.schema import ResolvedScene
from cell.view.appearance import add_surface, add_visual_mesh, is_robot_body, part_geoms, set_colours, set_lighting
from cell.view.rays import GLYPH_SHARE, frustum_corners
from cell.world.shapes import ShapeDistances, meshes_of
from planner.geometry.hull import is_convex
from planner.geometry.mesh import TriangleMesh
from planner.kinematics.rotary_table import RotaryTable
from planner.values import Floats, Value

if TYPE_CHECKING:
    import mujoco


MAX_POINTS = 6_000
"""Largest number of points of a scan in the picture; more would cost time and cover the surface no better."""


@dataclass(frozen=True, slots=True, eq=False)
class ReplayModel(Value):
    """The model of a run for replay, and the meshes that are drawn into it.

    Attributes:
        model: compiled; its joints are the robot's.
        home: joint angles of the key `home`, a rotary table at 0 [rad].
        T_flange_scanner: the mount [m].
        T_base_object: placement [m].
        centre: middle of the part's bounding box, base frame [m].
        frustum_mesh: number of the mesh of the scanner's measuring volume, scanner frame.
        glyph_mesh: number of the mesh of a small pyramid with its tip in the source, scanner frame.
        frustum_corners: corners of the measuring volume, near four and far four, scanner frame [m].
        cloud_meshes: number of the mesh of each scan's points, object frame; -1 for a scan without points.
        geom_names: name of each geom in messages ("link_4", "housing", "part").
        clearance: required distance [m].
        pair_clearances: smaller required distances of some pairs of geoms [m].
        shapes: measures distances, with true triangles where these were checked.
        table: rotary table that turns the part; None for a fixed part.
    """

    model: mujoco.MjModel
    home: Annotated[Floats, "axes"]
    T_flange_scanner: Annotated[Floats, "4 4"]
    T_base_object: Annotated[Floats, "4 4"]
    centre: Annotated[Floats, "3"]
    frustum_mesh: int
    glyph_mesh: int
    frustum_corners: Annotated[Floats, "8 3"]
    cloud_meshes: tuple[int, ...]
    geom_names: tuple[str, ...]
    clearance: float
    pair_clearances: Mapping[tuple[int, int], float]
    shapes: ShapeDistances
    table: RotaryTable | None


def build_replay_model(
    run: Run, scene: ResolvedScene, reference: TriangleMesh, clouds: Sequence[Floats] = ()
) -> ReplayModel:
    """Return the model for replay.

    Args:
        run: a run with cell.xml.
        scene: its scene.
        reference: the part, object frame [m].
        clouds: points of each scan, (P, 3) object frame [m].

    Raises:
        FileError: if cell.xml is missing, changed, or not a model of this robot.
    """
    spec = run.cell_spec()
    missing = [name for name in ("object", "housing", "link_6") if spec.body(name) is None]
    if missing or spec.geom("part") is None:
        raise FileError(
            f"{run.folder / 'cell.xml'} is damaged: the body {', '.join(missing) or 'of the part'} is missing; plan "
            "again"
        )
    centre = (scene.T_base_object @ scene.T_object_centre)[:3, 3]
    opening, (nearest, farthest) = scene.scanner.opening_deg, np.array(scene.scanner.drawn_range_mm) / 1000.0
    corners = np.concatenate([frustum_corners(opening, nearest), frustum_corners(opening, farthest)])
    geom_names = {geom.name: body.name for body in spec.bodies for geom in body.geoms if is_robot_body(body)}
    geom_names |= {piece.name: "part" for piece in part_geoms(spec)}
    set_colours(spec)
    set_lighting(spec, centre)
    radius = reference.diagonal / 2
    add_surface(spec, "surface", reference, part_geoms(spec))
    exact = [fixture for fixture in scene.fixtures if fixture.collision == "exact"]
    checked = {fixture.name: run.mesh(fixture.file) for fixture in exact if fixture.file is not None}
    for name, mesh in checked.items():
        add_surface(spec, f"{name}_surface", mesh, [spec.geom(name)])
    if scene.plan.collision == "exact":
        checked["part"] = reference
    for name, tips in (("frustum", corners), ("glyph", np.concatenate([np.zeros((1, 3)), GLYPH_SHARE * corners[4:]]))):
        spec.add_mesh(name=name, uservert=tips.ravel())
    for number, points in enumerate(clouds):
        if len(points):
            add_visual_mesh(spec, f"cloud_{number}", point_marks(points, 0.010 * radius))
    with run.compiling():
        model = spec.compile()
    links = {name: mesh for name, mesh in meshes_of(model).items() if name in geom_names and geom_names[name] != "part"}
    nonconvex = [*checked, *(name for name, mesh in links.items() if not is_convex(mesh))]
    mesh_of = {model.mesh(number).name: number for number in range(model.nmesh)}
    return ReplayModel(
        model=model,
        home=np.append(robot.home(model), [] if scene.table is None else [0.0]),
        T_flange_scanner=scene.T_flange_scanner,
        T_base_object=scene.T_base_object,
        centre=centre,
        frustum_mesh=mesh_of["frustum"],
        glyph_mesh=mesh_of["glyph"],
        frustum_corners=corners,
        cloud_meshes=tuple(mesh_of.get(f"cloud_{number}", -1) for number in range(len(clouds))),
        geom_names=tuple(geom_names.get(model.geom(i).name, model.geom(i).name) for i in range(model.ngeom)),
        clearance=scene.clearance_mm / 1000,
        pair_clearances=robot.reduced_clearances(model),
        shapes=ShapeDistances(model, {**links, **checked}, nonconvex),
        table=table_of(scene),
    )


def point_marks(points: Floats, size: float) -> TriangleMesh:
    """Return a small octahedron [m] at each point, thinned evenly to MAX_POINTS."""
    centres = points[np.linspace(0, len(points) - 1, min(len(points), MAX_POINTS)).astype(np.int64)]
    star = size * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=np.float64)
    faces = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]])
    vertices = (centres[:, None] + star).reshape(-1, 3)
    return TriangleMesh(vertices, (6 * np.arange(len(centres))[:, None, None] + faces).reshape(-1, 3))

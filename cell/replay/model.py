"""The model that is looked at: the checked cell of a run folder, dressed for the eye.

Made from the run's `cell.xml`, whose shapes, poses, joints and collision pairs stay as they were checked: colours,
light and sky are added, the true surfaces of part (`reference.ply`) and mesh fixtures stand where their
hulls stand, and all that is added takes no part in collisions. The hulls move to a hidden group (key 4 in the viewer
shows it). World frame = base frame, metres.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np

from cell.errors import FileError
from cell.replay.appearance import add_mesh, light, of_robot, paint, part_pieces, show_surface
from cell.robot import model as robot
from cell.runs.cell import table_of
from cell.runs.run import Run
from cell.runs.schema import ResolvedScene
from cell.view.rays import frustum
from cell.world.shapes import ShapeDistances, meshes_of
from planner.geometry.hull import is_convex
from planner.geometry.mesh import TriangleMesh
from planner.kinematics.rotary_table import RotaryTable
from planner.values import Floats, Value

if TYPE_CHECKING:
    import mujoco


POINTS_SHOWN = 6_000
"""Points of one scan that are shown; more cover the surface without a gap and cost time alone."""

GLYPH_SHARE = 0.16
"""Length of a view's small pyramid, as a share of its frustum's."""


@dataclass(frozen=True, slots=True, eq=False)
class Theatre(Value):
    """The dressed model of a run and what is drawn into it.

    Attributes:
        model: compiled; the robot's joints are its only ones.
        home: (axes,) joint angles of the key `home`, a rotary table at 0 [rad].
        T_flange_scanner: (4, 4) the mount [m]; the scanner's frame is where frustum and TCP path are drawn.
        T_base_object: (4, 4) placement [m].
        centre: (3,) middle of the part's bounding box, base frame [m].
        frustum_mesh: number of the mesh of the scanner's measuring volume, scanner frame.
        glyph_mesh: number of the mesh of its first part, a pyramid with its tip in the source.
        frustum_corners: (8, 3) its corners, near four and far four, scanner frame [m].
        cloud_mesh: number of the mesh of each scan's points, object frame, by scan; -1 for a scan without points.
        entities: for each geom, the name a reader knows ("link_4", "housing", "part").
        clearance: distance that a free configuration keeps [m].
        near: what pairs of geoms keep that are guarded by less [m].
        shapes: who measures distances, by true triangles where these were checked.
        table: turns the part; None: it stands.
    """

    model: mujoco.MjModel
    home: Annotated[Floats, "axes"]
    T_flange_scanner: Annotated[Floats, "4 4"]
    T_base_object: Annotated[Floats, "4 4"]
    centre: Annotated[Floats, "3"]
    frustum_mesh: int
    glyph_mesh: int
    frustum_corners: Annotated[Floats, "8 3"]
    cloud_mesh: tuple[int, ...]
    entities: tuple[str, ...]
    clearance: float
    near: Mapping[tuple[int, int], float]
    shapes: ShapeDistances
    table: RotaryTable | None


def dress(
    run: Run,
    scene: ResolvedScene,
    reference: TriangleMesh,
    clouds: Sequence[Floats] = (),
) -> Theatre:
    """Make the model that is looked at.

    Args:
        run: a run folder that holds cell.xml.
        scene: its scene.
        reference: the part, object frame [m].
        clouds: points of each scan, (P, 3) object frame [m].

    Raises:
        FileError: if cell.xml is missing, changed, or is no model of this robot.
    """
    spec = run.cell_spec()
    missing = [name for name in ("object", "housing", "link_6") if spec.body(name) is None]
    if missing or spec.geom("part") is None:
        raise FileError(
            f"{run.folder / 'cell.xml'} is damaged: it has no body {', '.join(missing) or 'with a part'}; plan again"
        )
    centre = (scene.T_base_object @ scene.T_object_centre)[:3, 3]
    opening, (nearest, farthest) = scene.scanner.opening_deg, np.array(scene.scanner.drawn_range_mm) / 1000.0
    corners = np.concatenate([frustum(opening, nearest), frustum(opening, farthest)])
    entities = {geom.name: body.name for body in spec.bodies for geom in body.geoms if of_robot(body)}
    entities |= {piece.name: "part" for piece in part_pieces(spec)}
    paint(spec)
    light(spec, centre)
    radius = reference.diagonal / 2
    show_surface(spec, "surface", reference, part_pieces(spec))
    exact = [fixture for fixture in scene.fixtures if fixture.collision == "exact"]
    checked = {fixture.name: run.mesh(fixture.file) for fixture in exact if fixture.file is not None}
    for name, mesh in checked.items():
        show_surface(spec, f"{name}_surface", mesh, [spec.geom(name)])
    if scene.plan.collision == "exact":
        checked["part"] = reference
    for name, tips in (("frustum", corners), ("glyph", np.concatenate([np.zeros((1, 3)), GLYPH_SHARE * corners[4:]]))):
        spec.add_mesh(name=name, uservert=tips.ravel())
    for number, points in enumerate(clouds):
        if len(points):
            add_mesh(spec, f"cloud_{number}", specks(points, 0.010 * radius))
    with run.compiling():
        model = spec.compile()
    links = {name: mesh for name, mesh in meshes_of(model).items() if name in entities and entities[name] != "part"}
    hollow = [*checked, *(name for name, mesh in links.items() if not is_convex(mesh))]
    mesh_of = {model.mesh(number).name: number for number in range(model.nmesh)}
    return Theatre(
        model=model,
        home=np.append(robot.home(model), [] if scene.table is None else [0.0]),
        T_flange_scanner=scene.T_flange_scanner,
        T_base_object=scene.T_base_object,
        centre=centre,
        frustum_mesh=mesh_of["frustum"],
        glyph_mesh=mesh_of["glyph"],
        frustum_corners=corners,
        cloud_mesh=tuple(mesh_of.get(f"cloud_{number}", -1) for number in range(len(clouds))),
        entities=tuple(entities.get(model.geom(i).name, model.geom(i).name) for i in range(model.ngeom)),
        clearance=scene.clearance_mm / 1000,
        near=robot.reduced_clearances(model),
        shapes=ShapeDistances(model, {**links, **checked}, hollow),
        table=table_of(scene),
    )


def specks(points: Floats, size: float) -> TriangleMesh:
    """A small octahedron [m] at each point, thinned evenly to POINTS_SHOWN."""
    shown = points[np.linspace(0, len(points) - 1, min(len(points), POINTS_SHOWN)).astype(np.int64)]
    star = size * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=np.float64)
    faces = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]])
    vertices = (shown[:, None] + star).reshape(-1, 3)
    return TriangleMesh(vertices, (6 * np.arange(len(shown))[:, None, None] + faces).reshape(-1, 3))

"""The model that is looked at: the checked cell of a run folder, dressed for the eye.

Made from the run's `cell.xml`, whose shapes, poses, joints and collision pairs stay as they were checked: colours,
light, floor pattern and sky are added, the part's true surface (`reference.ply`) stands where its hull stands, and all
that is added takes no part in collisions. The part's hull moves to a hidden group (key 5 in the viewer shows it). World
frame = base frame, metres.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from cell import robot
from cell.errors import FileError
from cell.replay_marks import GLYPH_SHARE
from cell.run_record import RunRecord, artefact, understood
from planner.ports import Floats
from planner.readonly import readonly
from planner.surface import TriangleMesh, decimate

if TYPE_CHECKING:
    import mujoco

VIEW_FACES = 200_000
"""Faces above which the part is decimated for the view: software rendering draws this many in some 50 ms."""

POINTS_SHOWN = 6_000
"""Points of one scan that are shown; more cover the surface without a gap and cost time alone."""

_VISUAL_GROUP, _ROBOT_GROUP, _HIDDEN_GROUP = 1, 3, 4
_DARK = ("motor", "feet", "turntable", "flange", "collar", "front")  # pieces that are black on the machine
_LOOK: dict[str, dict[str, Any]] = {
    "orange": {"rgba": [0.95, 0.33, 0.02, 1], "specular": 0.35, "shininess": 0.45},
    "anthracite": {"rgba": [0.13, 0.13, 0.145, 1], "specular": 0.4, "shininess": 0.4},
    "aluminium": {"rgba": [0.66, 0.68, 0.71, 1], "specular": 0.6, "shininess": 0.6},
    "painted": {"rgba": [0.36, 0.39, 0.43, 1], "specular": 0.15, "shininess": 0.2},
    "fixture": {"rgba": [0.33, 0.47, 0.62, 1], "specular": 0.2, "shininess": 0.3},
    "surface": {"rgba": [0.84, 0.80, 0.72, 1], "specular": 0.25, "shininess": 0.35},
}


@dataclass(frozen=True, slots=True, eq=False)
class Theatre:
    """The dressed model of a run and what is drawn into it.

    Attributes:
        model: compiled; the robot's joints are its only ones.
        home: (6,) joint angles of the key `home` [rad].
        T_flange_scanner: (4, 4) the mount [m]; the scanner's frame is where frustum and TCP path are drawn.
        T_base_object: (4, 4) placement [m].
        centre: (3,) middle of the part's bounding box, base frame [m].
        part_radius: half the diagonal of the part's bounding box [m].
        frustum_mesh: number of the mesh of the scanner's measuring volume, scanner frame.
        glyph_mesh: number of the mesh of its first part, a pyramid with its tip in the source.
        frustum_corners: (8, 3) its corners, near four and far four, scanner frame [m].
        cloud_mesh: number of the mesh of each scan's points, object frame, by scan; -1 for a scan without points.
        entities: for each geom, the name a reader knows ("link_4", "housing", "part").
        clearance: distance that a free configuration keeps [m].
    """

    model: mujoco.MjModel
    home: Floats
    T_flange_scanner: Floats
    T_base_object: Floats
    centre: Floats
    part_radius: float
    frustum_mesh: int
    glyph_mesh: int
    frustum_corners: Floats
    cloud_mesh: tuple[int, ...]
    entities: tuple[str, ...]
    clearance: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "home", readonly("home", self.home, (6,)))
        object.__setattr__(self, "centre", readonly("centre", self.centre, (3,)))
        object.__setattr__(self, "frustum_corners", readonly("frustum_corners", self.frustum_corners, (8, 3)))
        for name in ("T_flange_scanner", "T_base_object"):
            object.__setattr__(self, name, readonly(name, getattr(self, name), (4, 4)))


def dress(
    run: RunRecord,
    scene: Mapping[str, Any],
    reference: TriangleMesh | None,
    clouds: Sequence[Floats] = (),
    size: tuple[int, int] = (960, 720),
) -> Theatre:
    """Make the model that is looked at.

    Args:
        run: a run folder that holds cell.xml.
        scene: its resolved scene.
        reference: the part, object frame [m]; None shows the checked hull.
        clouds: points of each scan, (P, 3) object frame [m].
        size: (width, height) of the largest picture [pixels].

    Raises:
        FileError: if cell.xml is missing, changed, or is no model of this robot.
    """
    import mujoco

    path = run.folder / "cell.xml"
    text = artefact(run, "cell.xml").decode("utf-8", errors="replace")
    try:
        spec = mujoco.MjSpec.from_string(text)
    except ValueError as error:
        raise FileError(f"{path} is damaged: {' '.join(str(error).split())[:160]}; plan again") from error
    missing = [name for name in ("object", "housing", "link_6") if spec.body(name) is None]
    if missing or spec.geom("part") is None:
        raise FileError(f"{path} is damaged: it has no body {', '.join(missing) or 'with a part'}; plan again")
    with understood(run.folder / "scene.resolved.json"):
        T_flange_scanner = readonly("T_flange_scanner", scene["T_flange_scanner"], (4, 4))
        T_base_object = readonly("T_base_object", scene["T_base_object"], (4, 4))
        centre = (T_base_object @ readonly("T_object_centre", scene["T_object_centre"], (4, 4)))[:3, 3]
        clearance = float(scene["clearance_mm"]) / 1000.0
        scanner = scene["scanner"]
        corners = frustum(*np.radians(scanner["fov_deg"]), *(np.array(scanner["range_mm"]) / 1000.0))

    entities = {geom.name: body.name for body in spec.bodies for geom in body.geoms if body.name in robot.LINKS}
    _paint(spec)
    _light(spec, centre, size)
    shown = reference if reference is not None else _hull(spec)
    radius = float(np.linalg.norm(np.ptp(shown.vertices, axis=0))) / 2
    if reference is not None:
        _show_surface(spec, reference)
    add_mesh(spec, "frustum", corners)
    add_mesh(spec, "glyph", _pyramid(GLYPH_SHARE * corners.vertices[4:]))
    for number, points in enumerate(clouds):
        if len(points):
            add_mesh(spec, f"cloud_{number}", _specks(points, 0.010 * radius))
    try:
        model = spec.compile()
    except ValueError as error:
        raise FileError(f"{path} cannot be shown: {' '.join(str(error).split())[:160]}; plan again") from error
    mesh_of = {model.mesh(number).name: number for number in range(model.nmesh)}
    return Theatre(
        model=model,
        home=robot.home(model),
        T_flange_scanner=T_flange_scanner,
        T_base_object=T_base_object,
        centre=centre,
        part_radius=radius,
        frustum_mesh=mesh_of["frustum"],
        glyph_mesh=mesh_of["glyph"],
        frustum_corners=corners.vertices,
        cloud_mesh=tuple(mesh_of.get(f"cloud_{number}", -1) for number in range(len(clouds))),
        entities=tuple(entities.get(model.geom(i).name, model.geom(i).name) for i in range(model.ngeom)),
        clearance=clearance,
    )


def frustum(fov_h: float, fov_v: float, nearest: float, farthest: float) -> TriangleMesh:
    """The volume in which the scanner measures: both angles of the field of view, range as plane depth on the axis.

    The farthest face is drawn flat through the middle of the range's end, as drawings of sensors do.

    Args:
        fov_h: full angle about the scanner's y, along the baseline [rad].
        fov_v: full angle about the scanner's x [rad].
        nearest: smallest range [m].
        farthest: largest range [m].

    Returns:
        Eight corners (near four, far four), scanner frame [m].
    """
    x, y = np.tan(fov_h / 2), np.tan(fov_v / 2)
    square = np.array([[-x, -y, 1.0], [x, -y, 1.0], [x, y, 1.0], [-x, y, 1.0]])
    sides = [[i, (i + 1) % 4, (i + 1) % 4 + 4] for i in range(4)] + [[i, (i + 1) % 4 + 4, i + 4] for i in range(4)]
    ends = [[0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7]]
    return TriangleMesh(np.concatenate([square * nearest, square * farthest]), np.array(sides + ends))


def _pyramid(base: Floats) -> TriangleMesh:
    """Tip in the origin, over a base of four corners (4, 3)."""
    faces = [[0, 1 + (i + 1) % 4, 1 + i] for i in range(4)] + [[1, 2, 3], [1, 3, 4]]
    return TriangleMesh(np.concatenate([np.zeros((1, 3)), base]), np.array(faces))


def add_mesh(spec: mujoco.MjSpec, name: str, mesh: TriangleMesh, *, smooth: bool = False) -> None:
    """A mesh for the eye alone: surface inertia, so that open and thin ones compile as well."""
    import mujoco

    spec.add_mesh(
        name=name,
        uservert=mesh.vertices.ravel(),
        userface=mesh.faces.ravel(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        smoothnormal=smooth,
    )


def _chamfer(spec: mujoco.MjSpec, box: mujoco.MjsGeom) -> None:
    """Show a box of the robot with its edges taken off, inside the checked box, which moves to a hidden group."""
    import mujoco

    half = np.array(box.size)
    cut = min(0.022, 0.4 * float(half.min()))
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    corners = np.concatenate([signs * (half - cut * (1 - np.eye(3)[axis])) for axis in range(3)])
    from scipy.spatial import ConvexHull

    hull = ConvexHull(corners)
    outward = np.einsum("ij,ij->i", hull.equations[:, :3], _facing(corners, hull.simplices)) > 0
    faces = np.where(outward[:, None], hull.simplices, hull.simplices[:, ::-1])
    add_mesh(spec, f"{box.name}_look", TriangleMesh(corners, faces))
    box.parent.add_geom(
        name=f"{box.name}_look",
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname=f"{box.name}_look",
        pos=box.pos,
        quat=box.quat,
        material=box.material,
        group=_VISUAL_GROUP,
        contype=0,
        conaffinity=0,
    )
    box.group = _HIDDEN_GROUP


def _facing(vertices: Floats, faces: np.ndarray[Any, np.dtype[np.int32]]) -> Floats:
    """(F, 3) normals by the order of the corners, not of unit length."""
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    return np.cross(b - a, c - a)


def _paint(spec: mujoco.MjSpec) -> None:
    import mujoco

    for name, look in _LOOK.items():
        spec.add_material(name=name, **look)
    links = {geom.name for body in spec.bodies if body.name in robot.LINKS for geom in body.geoms}
    special = {"housing": "anthracite", "bracket": "aluminium", "pedestal": "painted", "post": "aluminium"}
    for geom in list(spec.geoms):
        if geom.name in links:
            geom.group = _ROBOT_GROUP
            geom.material = "anthracite" if any(word in geom.name for word in _DARK) else "orange"
            if geom.type == mujoco.mjtGeom.mjGEOM_BOX:
                _chamfer(spec, geom)
        elif geom.name != "floor":
            geom.material = special.get(geom.name, "surface" if geom.name == "part" else "fixture")
        if geom.material:
            geom.rgba = _LOOK[geom.material]["rgba"]


def _light(spec: mujoco.MjSpec, centre: Floats, size: tuple[int, int]) -> None:
    """Sky, patterned floor, a key light that casts shadows and a fill light from the other side."""
    import mujoco

    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.97, 0.98, 1.0],
        rgb2=[0.72, 0.78, 0.86],
        width=512,
        height=3072,
    )
    spec.add_texture(
        name="grid",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
        mark=mujoco.mjtMark.mjMARK_EDGE,
        rgb1=[0.86, 0.87, 0.88],
        rgb2=[0.86, 0.87, 0.88],
        markrgb=[0.72, 0.74, 0.77],
        width=512,
        height=512,
    )
    textures = [""] * int(mujoco.mjtTextureRole.mjNTEXROLE)
    textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "grid"
    # One square of the pattern is half a metre.
    spec.add_material(
        name="floor",
        textures=textures,
        texuniform=True,
        texrepeat=[2, 2],
        reflectance=0.0,
        specular=0.0,
        shininess=0.0,
    )
    floor = spec.geom("floor")
    floor.material, floor.rgba = "floor", [1, 1, 1, 1]
    floor.size = [0.0, 0.0, 0.1]  # drawn to the horizon; a plane is endless to collisions anyway
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [0.40] * 3, [0.22] * 3
    spec.visual.headlight.specular = [0.05] * 3
    lights: list[dict[str, Any]] = [
        {"pos": [1.6, -2.6, 4.2], "diffuse": [0.62, 0.61, 0.58], "specular": [0.3] * 3, "castshadow": True},
        {"pos": [-2.5, 3.0, 3.0], "diffuse": [0.20, 0.22, 0.26], "specular": [0.0] * 3, "castshadow": False},
    ]
    aim = np.array([0.5 * centre[0], 0.5 * centre[1], 0.4])
    for light in lights:
        direction = aim - light["pos"]
        spec.worldbody.add_light(
            type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, dir=direction / np.linalg.norm(direction), **light
        )
    spec.visual.global_.offwidth, spec.visual.global_.offheight = size
    spec.visual.quality.shadowsize = 4096
    spec.visual.map.znear, spec.visual.map.zfar, spec.visual.map.shadowclip = 0.01, 30.0, 1.2
    spec.visual.rgba.haze = [0.93, 0.95, 0.97, 1.0]
    spec.stat.extent, spec.stat.center = 2.0, aim


def _show_surface(spec: mujoco.MjSpec, reference: TriangleMesh) -> None:
    """The part's true surface in place of its hull."""
    import mujoco

    shown = decimate(reference, VIEW_FACES) if len(reference.faces) > VIEW_FACES else reference
    add_mesh(spec, "surface", shown, smooth=True)
    spec.body("object").add_geom(
        name="surface",
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname="surface",
        material="surface",
        group=_VISUAL_GROUP,
        contype=0,
        conaffinity=0,
    )
    spec.geom("part").group = _HIDDEN_GROUP


def _hull(spec: mujoco.MjSpec) -> TriangleMesh:
    mesh = spec.mesh(spec.geom("part").meshname)
    vertices = np.asarray(mesh.uservert, dtype=np.float64).reshape(-1, 3)
    return TriangleMesh(vertices, np.asarray(mesh.userface, dtype=np.int32).reshape(-1, 3))


def _specks(points: Floats, size: float) -> TriangleMesh:
    """A small octahedron [m] at each point, thinned evenly to POINTS_SHOWN."""
    shown = points[np.linspace(0, len(points) - 1, min(len(points), POINTS_SHOWN)).astype(np.int64)]
    star = size * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=np.float64)
    faces = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]])
    vertices = (shown[:, None] + star).reshape(-1, 3)
    return TriangleMesh(vertices, (6 * np.arange(len(shown))[:, None, None] + faces).reshape(-1, 3))

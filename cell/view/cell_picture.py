"""Picture of the cell by ray casting: the arm at a view, all views, the path of the scanner, the part.

The camera is fitted to part and arm; pieces in front of them are translucent. Base frame, metres.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from cell.errors import UsageError
from cell.view import rays
from cell.view.palette import BLUE, MATERIALS, ORANGE, material_of
from cell.view.pieces import CellGeometry, Piece, place_pieces
from cell.world.embree import EmbreeRayCaster
from cell.world.occluders import geom_triangles
from planner.geometry.mesh import TriangleMesh, concatenate_meshes
from planner.values import Floats

if TYPE_CHECKING:
    import mujoco

_AZIMUTH_DEG, _ELEVATION_DEG = -53.0, 20.0  # of the camera from the part, relative to the arm: both side by side
_OPACITY = 0.22  # of pieces in front of part and arm
_MAX_HIDDEN = 0.04  # of part and arm: a piece that hides more is translucent
_COARSE = 8  # times fewer pixels per side to measure that
_SUN = rays.direction(-70.0, 55.0)
_SUN_DISTANCE, _LIFT = 8.0, 2e-4  # m: start of shadow rays, and height of their end above the surface
_SKY = (np.array([0.97, 0.98, 1.0]), np.array([0.80, 0.85, 0.91]))
_GRID = 0.5  # m between the lines of the floor
_MAX_PATH_POINTS = 300


def draw_cell(
    cell: CellGeometry,
    part: TriangleMesh,
    q: Floats,
    *,
    views: Floats,
    path: Floats,
    size: tuple[int, int] = (960, 720),
    camera: rays.Camera | tuple[float, float] | None = None,
    hide: Collection[str] = (),
    extra: Sequence[Piece] = (),
) -> tuple[Image.Image, rays.DepthImage]:
    """Draw the cell.

    Args:
        cell: robot and surroundings.
        part: object frame.
        q: (axes,) joint angles [rad].
        views: (n, 4, 4) T_base_scanner of every view.
        path: (M, 3) positions of the scanner's source.
        size: (width, height) [pixels].
        camera: a camera, or its azimuth (0 is base x, 90 base y) and elevation as seen from the part [deg], fitted to
            part and arm; None for a camera that sees both side by side.
        hide: names of pieces to hide.
        extra: further pieces, base frame.

    Returns:
        The picture and its depth.

    Raises:
        UsageError: if a name is unknown.
    """
    T, link_poses = cell.table_motion(q) @ cell.T_base_object, cell.arm.link_poses(q)
    vertices = part.vertices @ T[:3, :3].T + T[:3, 3]
    part_piece = Piece("part", 0, vertices, part.faces, np.array(MATERIALS["surface"]))
    pieces = [*place_pieces(cell.pieces, link_poses), part_piece, *extra]
    names = dict.fromkeys(piece.name for piece in pieces)
    if (unknown := next((name for name in hide if name not in names), None)) is not None:
        raise UsageError(f"--hide {unknown} is not a piece of this cell; it has: {', '.join(names)}")
    pieces = [piece for piece in pieces if piece.name not in hide]
    subject = [piece for piece in pieces if piece.name in ("robot", "scanner", "part")] or pieces
    marks = rays.pyramid_edges(views, rays.GLYPH_SHARE * cell.frustum)
    if not isinstance(camera, rays.Camera):
        fit = np.concatenate([*(piece.vertices for piece in subject), marks.reshape(-1, 3), path])
        toward = rays.direction(*(camera or _default_camera(vertices)))
        camera = rays.fit_camera(fit, toward, size, parallel=False)
    always_solid = ("robot", "scanner", "part", "points", "post", "pedestal", "floor")
    translucent = _occluding_names(camera, subject, [piece for piece in pieces if piece.name not in always_solid])
    solid = _LitScene(camera.eye, [piece for piece in pieces if piece.name not in translucent])
    front = _LitScene(camera.eye, [piece for piece in pieces if piece.name in translucent]) if translucent else None

    def colour_of(origins: Floats, directions: Floats) -> tuple[Floats, Floats]:
        colour, distance = solid.colour_of(origins, directions)
        if front is not None:
            front_colour, front_distance = front.colour_of(origins, directions)
            through = front_distance < distance
            colour[through] = (1 - _OPACITY) * colour[through] + _OPACITY * front_colour[through]
        return colour, distance

    image, depth = rays.render(camera, colour_of)
    samples = np.linspace(0, len(path) - 1, min(len(path), _MAX_PATH_POINTS)).astype(np.int64)
    line = path[samples] if len(path) else path
    rays.draw_lines(image, depth, np.stack([line[:-1], line[1:]], axis=1), BLUE, width=2)
    rays.draw_lines(image, depth, marks, "#0b5d57")
    here = link_poses[6] @ cell.arm.T_link_scanner
    if any(np.allclose(here, view, atol=1e-6) for view in views):
        rays.draw_lines(image, depth, rays.pyramid_edges(here[None], cell.frustum), ORANGE, width=2)
    return image, depth


def tour_camera(
    cell: CellGeometry,
    part: TriangleMesh,
    poses: Sequence[Floats],
    path: Floats,
    size: tuple[int, int],
    half: float | None = None,
) -> rays.Camera:
    """Return a camera that sees the part and the arm side by side at all given configurations.

    Args:
        cell: robot and surroundings.
        part: object frame.
        poses: (axes,) joint angles of each configuration [rad].
        path: (M, 3) positions of the scanner's source.
        size: (width, height) [pixels].
        half: tangent of half the smaller opening; None for the default of pictures.
    """
    T, arm = cell.T_base_object, [piece for piece in cell.pieces if piece.name in ("robot", "scanner")]
    vertices = part.vertices @ T[:3, :3].T + T[:3, 3]
    moved = [piece.vertices for q in poses for piece in place_pieces(arm, cell.arm.link_poses(q))]
    toward = rays.direction(*_default_camera(vertices))
    return rays.fit_camera(np.concatenate([*moved, vertices, path]), toward, size, parallel=False, half=half)


def draw_robot(model: mujoco.MjModel) -> Image.Image:
    """Draw a compiled robot alone, at its home configuration, or at zero if it has none."""
    import mujoco

    data = mujoco.MjData(model)
    data.qpos[:] = model.key("home").qpos if model.nkey else 0.0
    mujoco.mj_kinematics(model, data)
    pieces = []
    for geom in range(model.ngeom):
        colour = np.array(MATERIALS[material_of(model.geom(geom).name, is_robot=True)])
        pieces.append(Piece("robot", 0, *geom_triangles(model, data, geom), colour))
    fit = np.concatenate([piece.vertices for piece in pieces])
    camera = rays.fit_camera(fit, rays.direction(-60.0, _ELEVATION_DEG), (720, 720), parallel=False)
    return rays.render(camera, _LitScene(camera.eye, pieces).colour_of)[0]


def best_view(cell: CellGeometry, part: TriangleMesh, views: Floats) -> int:
    """Return the view farthest to the side and up, at which the picture shows the arm beside the part.

    Args:
        cell: robot and surroundings.
        part: object frame.
        views: (n, 4, 4) T_base_scanner.

    Returns:
        Row of the view, or -1 without views.
    """
    if not len(views):
        return -1
    T = cell.T_base_object
    middle = T[:3, :3] @ part.vertices.mean(axis=0) + T[:3, 3]
    azimuth = np.arctan2(middle[1], middle[0]) + np.radians(_AZIMUTH_DEG)
    off = views[:, :3, 3] - middle
    return int(np.argmax(np.abs(off @ [-np.sin(azimuth), np.cos(azimuth), 0.0]) + off[:, 2]))


def _default_camera(part: Floats) -> tuple[float, float]:
    """Return azimuth and elevation of the camera [deg] as seen from a part with (V, 3) vertices."""
    middle = part.mean(axis=0)
    return float(np.degrees(np.arctan2(middle[1], middle[0]))) + _AZIMUTH_DEG, _ELEVATION_DEG


class _LitScene:
    """Pieces lit by sun and sky."""

    def __init__(self, eye: Floats, pieces: Sequence[Piece]) -> None:
        mesh, of_face = _merge(pieces)
        self._caster, self._normals = EmbreeRayCaster(mesh.vertices, mesh.faces), mesh.normals
        self._rgb = np.array([piece.rgb for piece in pieces])[of_face]
        self._floor = np.array([piece.name == "floor" for piece in pieces])[of_face]
        self._far = 2.5 * float(np.linalg.norm(eye))

    def colour_of(self, origins: Floats, directions: Floats) -> tuple[Floats, Floats]:
        """Return colours and distances, see `rays.ColourOf`."""
        hits = self._caster.first_hit(origins, directions)
        high = np.clip(0.5 + 2.0 * directions[:, 2:], 0.0, 1.0)
        colour = _SKY[1] + high * (_SKY[0] - _SKY[1])
        hit = np.flatnonzero(hits.face >= 0)
        face, distance = hits.face[hit], hits.distance[hit]
        along, normals = np.take(directions, hit, axis=0), np.take(self._normals, face, axis=0)
        at = np.take(origins, hit, axis=0) + distance[:, None] * along
        facing = -np.einsum("ij,ij->i", normals, along)
        normals *= np.where(facing < 0, -1.0, 1.0)[:, None]
        sun = np.maximum(normals @ _SUN, 0.0)
        toward = np.flatnonzero(sun > 0)
        lifted = np.take(at, toward, axis=0) + _LIFT * np.take(normals, toward, axis=0)
        sun[toward[self._caster.blocked(lifted + _SUN_DISTANCE * _SUN, lifted)]] = 0.0
        lit = np.take(self._rgb, face, axis=0) * (0.40 + 0.22 * np.abs(facing) + 0.46 * sun)[:, None]
        floor = np.flatnonzero(self._floor[face])
        # The floor fades into the sky with the distance, so no edge is visible.
        far = np.clip(distance[floor] / self._far - 0.5, 0.0, 1.0)
        lit[floor] *= (_floor_brightness(at[floor]) * (1 - far))[:, None]
        lit[floor] += far[:, None] * colour[hit[floor]]
        colour[hit] = lit
        return colour, hits.distance


def _floor_brightness(at: Floats) -> Floats:
    """Return the (N,) brightness of the floor with thin lines along x and y."""
    x, y = np.abs((at[:, :2].T / _GRID + 0.5) % 1.0 - 0.5) * _GRID
    return np.where(np.minimum(x, y) < 0.006, 0.86, 1.0)


def _occluding_names(camera: rays.Camera, subject: Sequence[Piece], others: Sequence[Piece]) -> set[str]:
    """Return the names of the pieces that hide part and arm from the camera."""
    if not others:
        return set()
    coarse = rays.Camera(
        camera.eye, camera.forward, camera.right, camera.half,
        (max(camera.size[0] // _COARSE, 1), max(camera.size[1] // _COARSE, 1)), camera.parallel,
    )  # fmt: skip
    names, to_subject = set(), _depth(coarse, subject)
    for name in dict.fromkeys(piece.name for piece in others):
        distance = _depth(coarse, [piece for piece in others if piece.name == name])
        if ((distance < to_subject) & np.isfinite(to_subject)).sum() > _MAX_HIDDEN * np.isfinite(to_subject).sum():
            names.add(name)
    return names


def _depth(camera: rays.Camera, pieces: Sequence[Piece]) -> NDArray[np.float64]:
    """Return the (P,) distance to the first piece along each ray [m]; inf without a hit."""
    mesh, _ = _merge(pieces)
    return EmbreeRayCaster(mesh.vertices, mesh.faces).first_hit(*camera.rays()).distance


def _merge(pieces: Sequence[Piece]) -> tuple[TriangleMesh, NDArray[np.int64]]:
    """Return the pieces as one mesh, and the piece of each of its faces."""
    vertices, faces, of_face = concatenate_meshes((piece.vertices, piece.faces) for piece in pieces)
    return TriangleMesh(vertices, faces.astype(np.int32)), of_face

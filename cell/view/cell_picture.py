"""One picture of the cell by rays: the arm at one of its views, all views, the way of the scanner, the part.

The camera is fitted to part and arm; what stands between it and them is glass. Base frame, metres.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from cell.errors import UsageError
from cell.view import rays
from cell.view.palette import BLUE, LOOKS, ORANGE, look_of
from cell.view.pieces import Cell, Piece, placed
from cell.world.embree import EmbreeRayCaster
from cell.world.occluders import geom_triangles
from planner.geometry.mesh import TriangleMesh, concatenate_meshes
from planner.values import Floats

if TYPE_CHECKING:
    import mujoco

_BESIDE_DEG, _ABOVE_DEG = -53.0, 20.0  # of the camera, from the part as the arm sees it: both next to each other
_GLASS = 0.22
_IN_FRONT = 0.04  # of part and arm: what hides more is glass
_COARSE = 8  # times fewer pixels a side to find out
_SUN = rays.direction(-70.0, 55.0)
_SUN_AWAY, _LIFT = 8.0, 2e-4  # m: where shadow rays begin, and how far above a surface they end
_SKY = (np.array([0.97, 0.98, 1.0]), np.array([0.80, 0.85, 0.91]))
_GRID = 0.5  # m between the lines of the floor
_SHARE = 0.16  # of its frustum: a view's small pyramid
_PATH = 300  # pieces of the scanner's way


def draw_cell(
    cell: Cell,
    part: TriangleMesh,
    q: Floats,
    *,
    views: Floats,
    way: Floats,
    size: tuple[int, int] = (960, 720),
    camera: rays.Camera | tuple[float, float] | None = None,
    hide: Collection[str] = (),
    extra: Sequence[Piece] = (),
) -> tuple[Image.Image, rays.Seen]:
    """Draw it.

    Args:
        cell: robot and surroundings.
        part: object frame.
        q: (axes,) joint angles [rad].
        views: (n, 4, 4) T_base_scanner of every view.
        way: (M, 3) places of the scanner's source.
        size: (width, height) [pixels].
        camera: where it stands; or its azimuth (0 is base x, 90 base y) and elevation as seen from the part [deg], part
            and arm in the picture; None is beside both.
        hide: names of pieces to leave out.
        extra: further pieces, base frame.

    Returns:
        The picture, and what the camera saw.

    Raises:
        UsageError: if a name is none of the cell's.
    """
    T, links = cell.turn(q) @ cell.T_base_object, cell.arm.links(q)
    stands = Piece("part", 0, part.vertices @ T[:3, :3].T + T[:3, 3], part.faces, np.array(LOOKS["surface"]))
    pieces = [*placed(cell.pieces, links), stands, *extra]
    _require_known(hide, [piece.name for piece in pieces])
    pieces = [piece for piece in pieces if piece.name not in hide]
    subject = [piece for piece in pieces if piece.name in ("robot", "scanner", "part")] or pieces
    marks = rays.pyramids(views, _SHARE * cell.frustum)
    if not isinstance(camera, rays.Camera):
        fit = np.concatenate([*(piece.vertices for piece in subject), marks.reshape(-1, 3), way])
        camera = rays.fitted(fit, rays.direction(*(camera or _beside(stands.vertices))), size, parallel=False)
    known = ("robot", "scanner", "part", "points", "post", "pedestal", "floor")
    glass = _in_front(camera, subject, [piece for piece in pieces if piece.name not in known])
    solid = _Lit(camera.eye, [piece for piece in pieces if piece.name not in glass])
    panes = _Lit(camera.eye, [piece for piece in pieces if piece.name in glass]) if glass else None

    def colour_of(origins: Floats, directions: Floats) -> tuple[Floats, Floats]:
        colour, distance = solid.colour_of(origins, directions)
        if panes is not None:
            before, to_pane = panes.colour_of(origins, directions)
            through = to_pane < distance
            colour[through] = (1 - _GLASS) * colour[through] + _GLASS * before[through]
        return colour, distance

    drawn, seen = rays.render(camera, colour_of)
    line = way[np.linspace(0, len(way) - 1, min(len(way), _PATH)).astype(np.int64)] if len(way) else way
    rays.lines(drawn, seen, np.stack([line[:-1], line[1:]], axis=1), BLUE, width=2)
    rays.lines(drawn, seen, marks, "#0b5d57")
    here = links[6] @ cell.arm.T_link_scanner
    if any(np.allclose(here, view, atol=1e-6) for view in views):
        rays.lines(drawn, seen, rays.pyramids(here[None], cell.frustum), ORANGE, width=2)
    return drawn, seen


def tour_camera(
    cell: Cell,
    part: TriangleMesh,
    poses: Sequence[Floats],
    way: Floats,
    size: tuple[int, int],
    half: float | None = None,
) -> rays.Camera:
    """A camera beside part and arm that has both in its picture at every one of some poses.

    Args:
        cell: robot and surroundings.
        part: object frame.
        poses: (axes,) joint angles of each [rad].
        way: (M, 3) places of the scanner's source.
        size: (width, height) [pixels].
        half: tangent of half its smaller opening; None is that of pictures.
    """
    T, arm = cell.T_base_object, [piece for piece in cell.pieces if piece.name in ("robot", "scanner")]
    stands = part.vertices @ T[:3, :3].T + T[:3, 3]
    moved = [piece.vertices for q in poses for piece in placed(arm, cell.arm.links(q))]
    toward = rays.direction(*_beside(stands))
    return rays.fitted(np.concatenate([*moved, stands, way]), toward, size, parallel=False, half=half)


def draw_robot(model: mujoco.MjModel) -> Image.Image:
    """A compiled robot alone, at its home; in its zero where it has none."""
    import mujoco

    data = mujoco.MjData(model)
    data.qpos[:] = model.key("home").qpos if model.nkey else 0.0
    mujoco.mj_kinematics(model, data)
    pieces = []
    for geom in range(model.ngeom):
        colour = np.array(LOOKS[look_of(model.geom(geom).name, of_robot=True)])
        pieces.append(Piece("robot", 0, *geom_triangles(model, data, geom), colour))
    fit = np.concatenate([piece.vertices for piece in pieces])
    camera = rays.fitted(fit, rays.direction(-60.0, _ABOVE_DEG), (720, 720), parallel=False)
    return rays.render(camera, _Lit(camera.eye, pieces).colour_of)[0]


def best_view(cell: Cell, part: TriangleMesh, views: Floats) -> int:
    """The view at which a picture shows the arm beside the part: the one farthest to the side and up; -1: no view.

    Args:
        cell: robot and surroundings.
        part: object frame.
        views: (n, 4, 4) T_base_scanner.
    """
    if not len(views):
        return -1
    T = cell.T_base_object
    middle = T[:3, :3] @ part.vertices.mean(axis=0) + T[:3, 3]
    azimuth = np.arctan2(middle[1], middle[0]) + np.radians(_BESIDE_DEG)
    off = views[:, :3, 3] - middle
    return int(np.argmax(np.abs(off @ [-np.sin(azimuth), np.cos(azimuth), 0.0]) + off[:, 2]))


def _beside(part: Floats) -> tuple[float, float]:
    """Azimuth and elevation of a camera [deg] as seen from the part, by its (V, 3) vertices."""
    middle = part.mean(axis=0)
    return float(np.degrees(np.arctan2(middle[1], middle[0]))) + _BESIDE_DEG, _ABOVE_DEG


class _Lit:
    """Pieces under the sun and the sky."""

    def __init__(self, eye: Floats, pieces: Sequence[Piece]) -> None:
        mesh, of_face = _joined(pieces)
        self._caster, self._normals = EmbreeRayCaster(mesh.vertices, mesh.faces), mesh.normals
        self._rgb = np.array([piece.rgb for piece in pieces])[of_face]
        self._floor = np.array([piece.name == "floor" for piece in pieces])[of_face]
        self._far = 2.5 * float(np.linalg.norm(eye))

    def colour_of(self, origins: Floats, directions: Floats) -> tuple[Floats, Floats]:
        """Colours and distances; see `rays.ColourOf`."""
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
        sun[toward[self._caster.blocked(lifted + _SUN_AWAY * _SUN, lifted)]] = 0.0
        lit = np.take(self._rgb, face, axis=0) * (0.40 + 0.22 * np.abs(facing) + 0.46 * sun)[:, None]
        floor = np.flatnonzero(self._floor[face])
        # The floor fades into the sky with the distance, so that it has no edge.
        far = np.clip(distance[floor] / self._far - 0.5, 0.0, 1.0)
        lit[floor] *= (_tiles(at[floor]) * (1 - far))[:, None]
        lit[floor] += far[:, None] * colour[hit[floor]]
        colour[hit] = lit
        return colour, hits.distance


def _tiles(at: Floats) -> Floats:
    """(N,) brightness of the floor: thin lines along x and y."""
    x, y = np.abs((at[:, :2].T / _GRID + 0.5) % 1.0 - 0.5) * _GRID
    return np.where(np.minimum(x, y) < 0.006, 0.86, 1.0)


def _in_front(camera: rays.Camera, subject: Sequence[Piece], others: Sequence[Piece]) -> set[str]:
    """Names of the pieces that hide part and arm from the camera."""
    if not others:
        return set()
    coarse = rays.Camera(
        camera.eye, camera.forward, camera.right, camera.half,
        (max(camera.size[0] // _COARSE, 1), max(camera.size[1] // _COARSE, 1)), camera.parallel,
    )  # fmt: skip
    hidden, wanted = set(), _distance(coarse, subject)
    for name in dict.fromkeys(piece.name for piece in others):
        distance = _distance(coarse, [piece for piece in others if piece.name == name])
        if ((distance < wanted) & np.isfinite(wanted)).sum() > _IN_FRONT * np.isfinite(wanted).sum():
            hidden.add(name)
    return hidden


def _distance(camera: rays.Camera, pieces: Sequence[Piece]) -> NDArray[np.float64]:
    """(P,) to the first of the pieces along each ray [m]; inf where there is none."""
    mesh, _ = _joined(pieces)
    return EmbreeRayCaster(mesh.vertices, mesh.faces).first_hit(*camera.rays()).distance


def _joined(pieces: Sequence[Piece]) -> tuple[TriangleMesh, NDArray[np.int64]]:
    """The pieces as one mesh, and the piece of each of its faces."""
    vertices, faces, of_face = concatenate_meshes((piece.vertices, piece.faces) for piece in pieces)
    return TriangleMesh(vertices, faces.astype(np.int32)), of_face


def _require_known(hide: Collection[str], names: Sequence[str]) -> None:
    """Refuse to hide what is not there.

    Raises:
        UsageError: if a name is none of these.
    """
    for name in hide:
        if name not in names:
            raise UsageError(f"--hide {name} is nothing of this cell; it has: {', '.join(dict.fromkeys(names))}")

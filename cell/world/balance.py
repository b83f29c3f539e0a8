"""Balance of an object on its supports: contacts below it, centre of mass, and the distance from tipping.

Vertical rays find the contacts. Base frame, metres.
"""

import numpy as np
from numpy.typing import NDArray

from cell.world.embree import EmbreeRayCaster
from cell.world.model import World
from cell.world.occluders import floor_triangles
from cell.world.solids import Solid, cell_solids, robot_bodies
from planner.geometry.mesh import concatenate_meshes
from planner.values import Floats

CONTACT_DISTANCE = 1e-3
"""Objects that are nearer than this are in contact [m]: a plan of a cell is hardly more precise."""

FINE_GRID = 512
"""Number of vertical rays across the longer side of an object if a length is reported."""

_GRID = 64  # else


class Rest:
    """The contacts of an object with the objects vertically below it.

    Args:
        solid: the object.
        others: objects below or beside it.
        floor: height [m].
        grid: number of vertical rays across the longer side.
    """

    def __init__(self, solid: Solid, others: list[Solid], floor: float, grid: int = _GRID) -> None:
        self._solid, self._names = solid, [*(other.name for other in others), "floor"]
        ground = Solid("floor", *floor_triangles(floor))
        vertices, faces, self._object_of_face = concatenate_meshes(
            (each.vertices, each.faces) for each in (*others, ground)
        )
        below = EmbreeRayCaster(vertices, faces)
        size = solid.high - solid.low
        self._step = float(max(size[:2].max(), 1e-6)) / grid
        sides = [np.arange(solid.low[axis] + self._step / 2, solid.high[axis], self._step) for axis in range(2)]
        x, y = np.meshgrid(*sides)
        bottom = _vertical_hits(solid.caster, x.ravel(), y.ravel(), float(solid.low[2]) - self._step, up=True)[0]
        points = np.column_stack([x.ravel(), y.ravel(), bottom])
        feet = solid.vertices[np.unique(solid.faces)]
        points = np.concatenate([points[np.isfinite(bottom)], feet[feet[:, 2] <= solid.low[2] + CONTACT_DISTANCE]])
        height, face = _vertical_hits(below, points[:, 0], points[:, 1], points[:, 2] + CONTACT_DISTANCE)
        height[(face < 0) & (points[:, 2] >= floor)] = floor  # it is endless
        self._points, self._gaps = points, points[:, 2] - height
        self._below = np.where(face >= 0, self._object_of_face[face], len(self._names) - 1)

    @property
    def on(self) -> set[str]:
        """Names of the objects that it rests on, without the floor."""
        return {self._names[k] for k in np.unique(self._below[self._gaps <= CONTACT_DISTANCE])} - {"floor"}

    def gap(self) -> tuple[float, str]:
        """Return the smallest vertical gap below it [m], and the object there."""
        nearest = int(np.argmin(self._gaps))
        return float(self._gaps[nearest]), self._names[self._below[nearest]]

    def margin(self) -> float:
        """Return the distance of its centre of mass from the edge of its contacts, negative outside [m]."""
        return hull_margin(self._points[self._gaps <= CONTACT_DISTANCE][:, :2], centre_of_mass(self._solid)[:2])

    def move_to_balance(self) -> Floats | None:
        """Return the shortest move (3,) [m] that brings its centre of mass above its contacts; None if it is there."""
        points = self._points[self._gaps <= CONTACT_DISTANCE][:, :2]
        if not len(points):
            return None
        move = _to_hull(points, centre_of_mass(self._solid)[:2])
        return None if np.linalg.norm(move) <= self._step + CONTACT_DISTANCE else np.array([*move, 0.0])


def _vertical_hits(
    caster: EmbreeRayCaster, x: Floats, y: Floats, start: Floats | float, *, up: bool = False
) -> tuple[Floats, NDArray[np.int32]]:
    """Return height (N,) [m] and face of the first hit of vertical rays; without a hit an infinite height and -1."""
    origins = np.column_stack([x, y, np.broadcast_to(start, x.shape)])
    direction = np.array([0.0, 0.0, 1.0 if up else -1.0])
    hits = caster.first_hit(origins, np.broadcast_to(direction, origins.shape))
    return origins[:, 2] + direction[2] * hits.distance, hits.face


def _to_hull(points: Floats, at: Floats) -> Floats:
    """Return the vector (2,) from a point (2,) to the nearest point of the convex hull of points (N, 2); 0 inside."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(points)
        if (hull.equations[:, :2] @ at + hull.equations[:, 2] <= 0).all():
            return np.zeros(2)
        corners = points[hull.vertices]
    except QhullError:  # a point or a line
        along = np.linalg.svd(points - points.mean(axis=0))[2][0]
        corners = points[[np.argmin(points @ along), np.argmax(points @ along)]]
    ends = np.roll(corners, -1, axis=0) - corners
    share = np.einsum("ij,ij->i", at - corners, ends) / np.maximum((ends**2).sum(axis=1), 1e-300)
    nearest = corners + np.clip(share, 0, 1)[:, None] * ends
    vector: Floats = nearest[np.argmin(np.linalg.norm(nearest - at, axis=1))] - at
    return vector


def hull_margin(points: Floats, at: Floats) -> float:
    """Return the distance of a point (2,) from the edge of the convex hull of points (N, 2), negative outside [m].

    It is -inf if the points are on a line: a body on an edge tips.
    """
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):
        return -np.inf
    return -float((hull.equations[:, :2] @ at + hull.equations[:, 2]).max())


def support_margin(world: World) -> float:
    """Return the distance of the part's centre of mass from the edge of its contact polygon in plan view [m].

    Supports are post, table, fixtures and floor below the part.

    Returns:
        Negative outside the polygon; -inf if nothing supports the part.
    """
    solids = {name: solid for name, solid in cell_solids(world).items() if name not in robot_bodies(world)}
    below = [solid for name, solid in solids.items() if name != "part"]
    return Rest(solids["part"], below, world.floor, FINE_GRID).margin()


def centre_of_mass(solid: Solid) -> Floats:
    """Return the centre of mass (3,) of uniform density, or of the surface if that is open [m]."""
    corners = solid.triangles - solid.low
    weights = np.einsum("fi,fi->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
    middles = corners.sum(axis=1) / 4
    if not solid.closed or abs(weights.sum()) < 1e-15:
        weights = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        middles = corners.mean(axis=1)
    centre: Floats = (weights[:, None] * middles).sum(axis=0) / weights.sum() + solid.low
    return centre

"""True triangles of what stands in a cell, whether two of them share space, and the shortest way out.

Two surfaces share space where an edge of one passes through a face of the other, or where one lies inside the other.
Edges are cast as rays (`cell.world.embree`), inside is told by the solid angle that a surface subtends
(`cell.part.mesh_checks.encloses`), so that an open surface has an inside where it winds round enough of it. Base frame,
metres.

What stands in a cell while the robot is at home, as solids in the base frame.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from cell.part.mesh_checks import encloses
from cell.robot.model import bodies
from cell.world.embree import EmbreeRayCaster
from cell.world.model import World
from cell.world.occluders import geom_triangles, post_triangles
from planner.geometry.decimation import decimate
from planner.geometry.mesh import TriangleMesh, concatenate_meshes
from planner.values import Floats, Ints

FLUSH = 1e-4
"""What is less deep than this stands flush [m]: scene files are written in tenths of a millimetre."""

_STEPS = 24  # at which a direction is looked at before it is halved: hollows narrower than a 24th of the way are missed
_HALVINGS = 16
_SEARCHED = 8_000  # faces above which ways are searched for with a decimated copy, and settled with the true triangles
_STEPS_BACK, _BACK = 8, 1e-3  # m; how far the true depth is looked for below that of the copies
_STEEPEST = 2.0  # of the way that a corner goes so that its faces go 1: less than a needle's, more than a cube's 1.73


class Solid:
    """A named triangle mesh that stands in the cell.

    Attributes:
        name: what a reader calls it.
        axes: (n, 3) unit vectors along which it is likely to be pushed out of something: normals of a box.
        low: (3,) lowest corner of its upright bounding box [m].
        high: (3,) highest.
    """

    def __init__(
        self,
        name: str,
        vertices: Floats,
        faces: NDArray[np.integer],
        axes: Floats | None = None,
        *,
        T: Floats | None = None,
        hull: Floats | None = None,
    ) -> None:
        """Nothing but the box is worked out before it is asked for.

        Args:
            name: what a reader calls it.
            vertices: (V, 3) [m].
            faces: (F, 3), outward where the surface has an inside.
            axes: (n, 3) unit vectors, base frame.
            T: (4, 4) from the frame of the vertices to base [m]; None where they are in base.
            hull: (n, 3) some vertices that have the same box [m], where they are fewer.
        """
        self.name, self._vertices, self._faces, self._T = name, vertices, faces, T
        self.axes = np.empty((0, 3)) if axes is None else axes
        outline = self._placed(vertices if hull is None else hull)
        self.low, self.high = outline.min(axis=0), outline.max(axis=0)

    def _placed(self, points: Floats) -> Floats:
        return points if self._T is None else points @ self._T[:3, :3].T + self._T[:3, 3]

    @cached_property
    def vertices(self) -> Floats:
        """(V, 3) [m], base frame."""
        return self._placed(self._vertices)

    @cached_property
    def faces(self) -> Ints:
        """(F, 3)."""
        return np.asarray(self._faces, dtype=np.int64)

    @cached_property
    def caster(self) -> EmbreeRayCaster:
        """Casts on it."""
        return EmbreeRayCaster(self.vertices, self.faces)

    @cached_property
    def closed(self) -> bool:
        """Whether every edge is shared by an even number of faces."""
        start, end = self.faces.T.ravel(), np.roll(self.faces, -1, axis=1).T.ravel()
        keys = np.minimum(start, end) * len(self.vertices) + np.maximum(start, end)
        return bool((np.unique(keys[start != end], return_counts=True)[1] % 2 == 0).all())

    @cached_property
    def bodies(self) -> Ints:
        """(n,) a vertex of each connected body."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        one, two = self.faces[:, [0, 1]].T.ravel(), self.faces[:, [1, 2]].T.ravel()
        graph = coo_array((np.ones(len(one), dtype=np.int8), (one, two)), shape=(len(self.vertices),) * 2)
        labels = connected_components(graph, directed=False)[1]
        used = np.unique(self.faces)
        return np.asarray(used[np.unique(labels[used], return_index=True)[1]])

    @cached_property
    def triangles(self) -> Floats:
        """(F, 3, 3) corners [m]."""
        return self.vertices[self.faces]

    @cached_property
    def coarse(self) -> Solid:
        """Itself, or a decimated copy where it has more faces than a search for a way needs."""
        if len(self.faces) <= _SEARCHED:
            return self
        copy = decimate(TriangleMesh(self.vertices, self.faces.astype(np.int32)), _SEARCHED // 2)
        return Solid(self.name, copy.vertices, copy.faces, self.axes)

    def offset_by(self, by: float) -> Solid:
        """The same with every face moved outward [m], inward where that is negative."""
        return Solid(self.name, self.vertices + by * self._outward, self.faces, self.axes)

    @cached_property
    def _outward(self) -> Floats:
        """(V, 3) where a vertex goes as its faces go 1 outward: along the mean of their normals, weighted by angle."""
        corners = self.triangles
        sides: Floats = np.roll(corners, -1, axis=1) - corners
        along = sides / np.maximum(np.linalg.norm(sides, axis=2, keepdims=True), 1e-300)
        angle = np.arccos(np.clip(-(along * np.roll(along, 1, axis=1)).sum(axis=2), -1, 1))
        normal = np.cross(along[:, 0], along[:, 1])
        normal = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
        mean = np.stack(
            [
                np.bincount(self.faces.ravel(), (angle * normal[:, None, axis]).ravel(), len(self.vertices))
                for axis in range(3)
            ],
            axis=1,
        )
        mean = mean / np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-300)
        least = np.ones(len(self.vertices))
        np.minimum.at(least, self.faces.ravel(), np.einsum("fi,fki->fk", normal, mean[self.faces]).ravel())
        outward: Floats = mean / np.maximum(least, 1 / _STEEPEST)[:, None]
        return outward


def intersect(one: Solid, other: Solid, move: Floats | None = None) -> bool:
    """Whether two surfaces cross, or one of them holds a body of the other.

    Args:
        one: is looked at ...
        other: beside this.
        move: (3,) ... after going this way [m].
    """
    move = np.zeros(3) if move is None else move
    low, high = np.maximum(one.low + move, other.low), np.minimum(one.high + move, other.high)
    if (low > high).any():
        return False
    pairs = ((one, other, move, low - move, high - move), (other, one, -move, low, high))
    for a, b, shift, bottom, top in pairs:
        starts, ends = _edges(a, bottom, top)
        if len(starts) and b.caster.blocked(starts + shift, ends + shift).any():
            return True
    for a, b, shift, *_ in pairs:
        for point in a.vertices[a.bodies] + shift:
            if (point >= b.low).all() and (point <= b.high).all() and encloses(b.triangles, point):
                return True
    return False


def _edges(solid: Solid, low: Floats, high: Floats) -> tuple[Floats, Floats]:
    """(E, 3) and (E, 3) ends of the edges of the faces that come near an upright box [m]."""
    faces = solid.faces
    for axis in range(3):
        at = solid.vertices[:, axis][faces]
        faces = faces[(at.min(axis=1) <= high[axis]) & (at.max(axis=1) >= low[axis])]
    ends = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    edges = np.unique(ends[:, 0] * len(solid.vertices) + ends[:, 1])
    return solid.vertices[edges // len(solid.vertices)], solid.vertices[edges % len(solid.vertices)]


def penetrates(one: Solid, other: Solid) -> bool:
    """Whether one stands deeper than `FLUSH` in the other."""
    if (np.minimum(one.high, other.high) - np.maximum(one.low, other.low) <= FLUSH).any():
        return False
    return intersect(*_without_skin(one, other))


def touches(one: Solid, other: Solid, gap: float) -> bool:
    """Whether one comes nearer than a gap [m] to the other, or stands in it."""
    if (np.minimum(one.high, other.high) - np.maximum(one.low, other.low) < -gap).any():
        return False
    wide, thin = (one, other) if one.closed else (other, one)
    return intersect(wide.offset_by(gap), thin)


def minimum_translation(one: Solid, other: Solid, gap: float = 0.0) -> Floats:
    """(3,) the shortest way [m] that was found for `one` to stand no longer in `other`.

    Looked at along the axes of the base frame and of both solids, and along the line of their middles: the length is
    the depth of convex solids whose faces meet, and an upper bound on that of others. Of meshes of many faces decimated
    copies choose the direction; its length is that of the true triangles.

    Args:
        one: deeper than `FLUSH` in the other.
        other: or nearer to it than the gap.
        gap: what is between them afterwards [m].
    """
    if one.coarse is one and other.coarse is other:
        return _searched(one, other, gap)
    rough = _searched(one.coarse, other.coarse, gap)
    return _settled(one, other, gap, rough)


def _settled(one: Solid, other: Solid, gap: float, rough: Floats) -> Floats:
    """(3,) the way out in the direction of a rough one, its length that of the true triangles [m]."""
    near = other.offset_by(gap) if gap else other
    thin, wide = (one, near) if gap else _without_skin(one, near)
    length = float(np.linalg.norm(rough))
    along = rough / length
    high = length
    while intersect(thin, wide, high * along):
        high += _BACK
    low = high
    for _ in range(_STEPS_BACK):
        low = max(0.0, high - _BACK)
        if intersect(thin, wide, low * along):
            break
        high = low
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if intersect(thin, wide, middle * along) else (low, middle)
    return np.asarray((high + (0.0 if gap else FLUSH)) * along)


def _searched(one: Solid, other: Solid, gap: float) -> Floats:
    """(3,) the shortest way out that was found [m]; arguments as for `way_out`."""
    near = other.offset_by(gap) if gap else other
    thin, wide = (one, near) if gap else _without_skin(one, near)
    ways = []
    for direction in _directions(one, other):
        sure = float((near.vertices @ direction).max() - (one.vertices @ direction).min())
        ways.append((sure, direction))
    ways.sort(key=lambda each: each[0])
    best, way = ways[0]
    for sure, direction in ways:
        steps = np.linspace(0, min(sure, best), _STEPS + 1)
        clear = next((k for k in range(1, _STEPS) if not intersect(thin, wide, steps[k] * direction)), _STEPS)
        if clear == _STEPS and sure > best:
            continue  # not out where another way is
        low, high = steps[clear - 1], steps[clear]
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            low, high = (middle, high) if intersect(thin, wide, middle * direction) else (low, middle)
        # What is out because all of it is beyond, is out exactly there.
        length = sure if high > sure - 3 * FLUSH else high + (0.0 if gap else FLUSH)
        if length < best:
            best, way = length, direction
    return np.asarray(best * way)


def _without_skin(one: Solid, other: Solid) -> tuple[Solid, Solid]:
    """Both, the first that has an inside without its outermost `FLUSH`."""
    if one.closed:
        return one.offset_by(-FLUSH), other
    return (one, other.offset_by(-FLUSH)) if other.closed else (one, other)


def _directions(one: Solid, other: Solid) -> Iterator[Floats]:
    for axis in (*np.eye(3), *one.axes, *other.axes):
        yield axis
        yield -axis
    between = (one.low + one.high - other.low - other.high) / 2
    for along in (between, *(between - (between @ axis) * axis for axis in (*np.eye(3), *other.axes))):
        if (length := float(np.linalg.norm(along))) > 1e-6:
            yield along / length


_SIDES = 192  # of a prism around a cylinder: its corners stand off by 0.04 mm at a radius of 300 mm
BUILT_IN_OBSTACLES = ("post", "pedestal", "floor")
"""What the cell has without being a fixture."""


def cell_solids(world: World) -> dict[str, Solid]:
    """Part, fixtures, post, pedestal, base, links, bracket and housing by name; the floor, which is endless, is not."""
    data, T = world.data(), world.T_base_object
    attached = {fixture.name: fixture.attached_to == "object" for fixture in world.scene.fixtures}
    of_robot = robot_bodies(world)
    meshes = {"part": world.part_mesh, **world.fixture_meshes}
    found = {}
    for name in dict.fromkeys(world.entities):
        geoms = [geom for geom, entity in enumerate(world.entities) if entity == name]
        if name == "floor":
            continue
        if name in meshes:
            mesh = meshes[name]
            frame = T if attached.get(name, True) else np.eye(4)
            hull = world.part_hull.vertices if name == "part" else None
            found[name] = Solid(name, mesh.vertices, mesh.faces, frame[:3, :3].T, T=frame, hull=hull)
        elif name == "post":
            if data.body("post").xpos[2] > world.floor:
                found[name] = Solid(name, *post_triangles(data, world.floor, _SIDES))
        else:
            sides = {} if name in of_robot else {"sides": _SIDES}
            pieces = [geom_triangles(world.model, data, geom, **sides) for geom in geoms]
            axes = data.geom_xmat[geoms[0]].reshape(3, 3).T if len(geoms) == 1 else None
            found[name] = Solid(name, *concatenate_meshes(pieces)[:2], axes)
    return found


def robot_bodies(world: World) -> tuple[str, ...]:
    """Names of base, links, what they drive along, bracket and housing."""
    return (*bodies(world.model), "bracket", "housing")


def robot_solid(world: World, solids: dict[str, Solid]) -> Solid:
    """Base, arm, bracket and housing as one."""
    pieces = [(solids[name].vertices, solids[name].faces) for name in robot_bodies(world) if name in solids]
    return Solid("robot", *concatenate_meshes(pieces)[:2])

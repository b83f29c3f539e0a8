"""The objects of a cell as triangle meshes: intersection, and the minimum translation that separates two of them.

Two surfaces intersect if an edge of one passes through a face of the other, or if one is inside the other. Edges are
cast as rays (`cell.world.embree`); the solid angle of a surface decides what is inside
(`cell.part.mesh_checks.encloses`), so that an open surface has an inside where it encloses enough of it. Base frame,
metres.
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
"""Largest depth of objects that touch [m]: scene files are written in tenths of a millimetre."""

BUILT_IN_OBSTACLES = ("post", "pedestal", "floor")
"""Obstacles of every cell that are no fixtures."""

_STEPS = 24  # first subdivision of a direction: gaps narrower than a 24th of the distance are missed
_HALVINGS = 16
_SAME = 1e-12  # largest difference of unit vectors of the same direction
_SEARCH_FACES = 8_000  # meshes with more faces are searched with a decimated copy, and refined with the true triangles
_STEPS_BACK, _BACK = 8, 1e-3  # m; how far the true depth is searched below that of the copies
_MAX_OFFSET_RATIO = 2.0  # of the offset of a corner to that of its faces: below a needle's, above a cube's 1.73
_SIDES = 192  # of a prism around a cylinder: its corners exceed a radius of 300 mm by 0.04 mm


class Solid:
    """A named triangle mesh in the cell.

    Attributes:
        name: in reports.
        axes: (n, 3) unit vectors along which it is likely to be separated: normals of a box.
        low: (3,) lowest corner of its upright bounding box [m].
        high: (3,) highest corner [m].
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
        """Compute the bounding box; everything else is computed at its first use.

        Args:
            name: in reports.
            vertices: (V, 3) [m].
            faces: (F, 3), outward if the surface has an inside.
            axes: (n, 3) unit vectors, base frame.
            T: (4, 4) from the frame of the vertices to base [m]; None: the vertices are in base.
            hull: (n, 3) fewer vertices with the same bounding box [m].
        """
        self.name, self._vertices, self._faces, self._T = name, vertices, faces, T
        self._original: Solid | None = None
        self._offset_copies: dict[float, Solid] = {}
        self.axes = np.empty((0, 3)) if axes is None else axes
        outline = self._in_base(vertices if hull is None else hull)
        self.low, self.high = outline.min(axis=0), outline.max(axis=0)

    def _in_base(self, points: Floats) -> Floats:
        return points if self._T is None else points @ self._T[:3, :3].T + self._T[:3, 3]

    @cached_property
    def vertices(self) -> Floats:
        """(V, 3) [m], base frame."""
        return self._in_base(self._vertices)

    @cached_property
    def faces(self) -> Ints:
        """(F, 3)."""
        return np.asarray(self._faces, dtype=np.int64)

    @cached_property
    def caster(self) -> EmbreeRayCaster:
        """Ray caster on the mesh."""
        return EmbreeRayCaster(self.vertices, self.faces)

    @cached_property
    def closed(self) -> bool:
        """Whether every edge is shared by an even number of faces."""
        ends, uses = self._edges_and_uses
        return bool((uses[ends[:, 0] != ends[:, 1]] % 2 == 0).all())

    @cached_property
    def edges(self) -> Floats:
        """(E, 2, 3) ends of the edges [m]."""
        return np.asarray(self.vertices[self._edges_and_uses[0]])

    @cached_property
    def _edges_and_uses(self) -> tuple[Ints, Ints]:
        """(E, 2) vertices at the ends of the edges, and (E,) number of faces at each."""
        if self._original is not None:
            return self._original._edges_and_uses
        start, end = self.faces.T.ravel(), np.roll(self.faces, -1, axis=1).T.ravel()
        keys = np.sort(np.minimum(start, end) * len(self.vertices) + np.maximum(start, end))
        first = np.flatnonzero(np.append(True, keys[1:] != keys[:-1]))  # np.unique takes ten times as long
        uses: Ints = np.diff(np.append(first, len(keys)))
        return np.stack(np.divmod(keys[first], len(self.vertices)), axis=1), uses

    @cached_property
    def edge_boxes(self) -> tuple[Floats, Floats]:
        """Lowest and highest corners (E, 3) of the boxes of the edges [m]."""
        return self.edges.min(axis=1), self.edges.max(axis=1)

    @cached_property
    def bodies(self) -> Ints:
        """(n,) one vertex of each connected body."""
        if self._original is not None:
            return self._original.bodies
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
        """The solid itself, or a decimated copy if it has more faces than a search needs."""
        if len(self.faces) <= _SEARCH_FACES:
            return self
        copy = decimate(TriangleMesh(self.vertices, self.faces.astype(np.int32)), _SEARCH_FACES // 2)
        return Solid(self.name, copy.vertices, copy.faces, self.axes)

    def with_vertices(self, vertices: Floats) -> Solid:
        """Return the solid with its vertices (V, 3) elsewhere [m], base frame; the properties of its faces are kept."""
        other = Solid(self.name, vertices, self.faces, self.axes)
        other._original = self
        return other

    def offset_by(self, distance: float) -> Solid:
        """Return the solid with every face moved outward [m], inward for a negative distance."""
        if distance not in self._offset_copies:
            self._offset_copies[distance] = self.with_vertices(self.vertices + distance * self._offsets)
        return self._offset_copies[distance]

    @cached_property
    def _offsets(self) -> Floats:
        """(V, 3) displacement of each vertex if its faces move 1 outward: along the angle-weighted mean normal."""
        corners = self.triangles
        sides: Floats = np.roll(corners, -1, axis=1) - corners
        along = sides / np.maximum(np.linalg.norm(sides, axis=2, keepdims=True), 1e-300)
        angle = np.arccos(np.clip(-(along * np.roll(along, 1, axis=1)).sum(axis=2), -1, 1))
        normal = np.cross(along[:, 0], along[:, 1])
        normal = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
        weighted = angle[:, None, :] * normal[:, :, None]
        mean = np.stack(
            [np.bincount(self.faces.ravel(), weighted[:, axis].ravel(), len(self.vertices)) for axis in range(3)],
            axis=1,
        )
        mean = mean / np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-300)
        least = np.ones(len(self.vertices))
        np.minimum.at(least, self.faces.ravel(), np.einsum("fi,fki->fk", normal, mean[self.faces]).ravel())
        offsets: Floats = mean / np.maximum(least, 1 / _MAX_OFFSET_RATIO)[:, None]
        return offsets


def intersect(one: Solid, other: Solid, move: Floats | None = None) -> bool:
    """Return whether two surfaces cross, or one contains a body of the other.

    Args:
        one: a solid.
        other: another solid.
        move: (3,) translation of `one` [m].
    """
    move = np.zeros(3) if move is None else move
    low, high = np.maximum(one.low + move, other.low), np.minimum(one.high + move, other.high)
    if (low > high).any():
        return False
    pairs = ((one, other, move, low - move, high - move), (other, one, -move, low, high))
    for a, b, shift, bottom, top in pairs:
        low_end, high_end = a.edge_boxes
        near = a.edges[((low_end <= top) & (high_end >= bottom)).all(axis=1)] + shift
        if len(near) and b.caster.blocked(near[:, 0], near[:, 1]).any():
            return True
    for a, b, shift, *_ in pairs:
        for point in a.vertices[a.bodies] + shift:
            if (point >= b.low).all() and (point <= b.high).all() and encloses(b.triangles, point):
                return True
    return False


def penetrates(one: Solid, other: Solid) -> bool:
    """Return whether one is deeper than `FLUSH` in the other."""
    if (np.minimum(one.high, other.high) - np.maximum(one.low, other.low) <= FLUSH).any():
        return False
    return intersect(*_without_skin(one, other))


def touches(one: Solid, other: Solid, gap: float) -> bool:
    """Return whether one is nearer than a gap [m] to the other, or intersects it."""
    if (np.minimum(one.high, other.high) - np.maximum(one.low, other.low) < -gap).any():
        return False
    wide, thin = (one, other) if one.closed else (other, one)
    return intersect(wide.offset_by(gap), thin)


def minimum_translation(one: Solid, other: Solid, gap: float = 0.0) -> Floats:
    """Return the shortest translation (3,) [m] that was found to separate `one` from `other`.

    Searched along the axes of the base frame and of both solids, and along the line of their middles: the length is the
    penetration depth of convex solids whose faces meet, and an upper bound for others. Decimated copies of meshes with
    many faces choose the direction; the length is that of the true triangles.

    Args:
        one: deeper than `FLUSH` in the other, or nearer to it than the gap.
        other: the other solid.
        gap: distance between them afterwards [m].
    """
    if one.coarse is one and other.coarse is other:
        return _search(one, other, gap)
    return _refine(one, other, gap, _search(one.coarse, other.coarse, gap))


def _refine(one: Solid, other: Solid, gap: float, rough: Floats) -> Floats:
    """Return the separation (3,) in the direction of a rough one, with the length of the true triangles [m]."""
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
    high = _bisect(thin, wide, along, low, high)
    return np.asarray((high + (0.0 if gap else FLUSH)) * along)


def _search(one: Solid, other: Solid, gap: float) -> Floats:
    """Return the shortest separation (3,) [m] of all directions; arguments as of `minimum_translation`."""
    near = other.offset_by(gap) if gap else other
    thin, wide = (one, near) if gap else _without_skin(one, near)
    directions: list[tuple[float, Floats]] = []
    for direction in _directions(one, other):
        if any(np.abs(direction - known).max() < _SAME for _, known in directions):
            continue
        sure = float((near.vertices @ direction).max() - (one.vertices @ direction).min())
        directions.append((sure, direction))
    directions.sort(key=lambda each: each[0])
    shortest, best = directions[0]
    for sure, direction in directions:
        steps = np.linspace(0, min(sure, shortest), _STEPS + 1)
        clear = next((k for k in range(1, _STEPS) if not intersect(thin, wide, steps[k] * direction)), _STEPS)
        if clear == _STEPS and sure > shortest:
            continue  # another direction is shorter
        high = _bisect(thin, wide, direction, steps[clear - 1], steps[clear])
        # If they separate only when all of `one` is beyond `other`, the length is known exactly.
        length = sure if high > sure - 3 * FLUSH else high + (0.0 if gap else FLUSH)
        if length < shortest:
            shortest, best = length, direction
    return np.asarray(shortest * best)


def _bisect(thin: Solid, wide: Solid, direction: Floats, low: float, high: float) -> float:
    """Return a length at which two solids are separate, within 2^-16 of the interval from the length of contact."""
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if intersect(thin, wide, middle * direction) else (low, middle)
    return high


def _without_skin(one: Solid, other: Solid) -> tuple[Solid, Solid]:
    """Return both, the first closed one without its outermost `FLUSH`."""
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


def cell_solids(world: World) -> dict[str, Solid]:
    """Return the objects of a cell with the robot at home by name, all but the endless floor, base frame."""
    data, T = world.data(), world.T_base_object
    attached = {fixture.name: fixture.attached_to == "object" for fixture in world.scene.fixtures}
    on_robot = robot_bodies(world)
    meshes = {"part": world.part_mesh, **world.fixture_meshes}
    solids = {}
    for name in dict.fromkeys(world.entities):
        geoms = [geom for geom, entity in enumerate(world.entities) if entity == name]
        if name == "floor":
            continue
        if name in meshes:
            mesh = meshes[name]
            frame = T if attached.get(name, True) else np.eye(4)
            hull = world.part_hull.vertices if name == "part" else None
            solids[name] = Solid(name, mesh.vertices, mesh.faces, frame[:3, :3].T, T=frame, hull=hull)
        elif name == "post":
            if data.body("post").xpos[2] > world.floor:
                solids[name] = Solid(name, *post_triangles(data, world.floor, _SIDES))
        else:
            sides: tuple[int, ...] = () if name in on_robot else (_SIDES,)
            known = world.shapes.meshes
            pieces = [geom_triangles(world.model, data, geom, *sides, mesh=known.get(geom)) for geom in geoms]
            axes = data.geom_xmat[geoms[0]].reshape(3, 3).T if len(geoms) == 1 else None
            solids[name] = Solid(name, *concatenate_meshes(pieces)[:2], axes)
    return solids


def robot_bodies(world: World) -> tuple[str, ...]:
    """Return the names of base, links, bodies of mimic joints, bracket and housing."""
    return (*bodies(world.model), "bracket", "housing")


def robot_solid(world: World, solids: dict[str, Solid]) -> Solid:
    """Return base, arm, bracket and housing as one solid."""
    pieces = [(solids[name].vertices, solids[name].faces) for name in robot_bodies(world) if name in solids]
    return Solid("robot", *concatenate_meshes(pieces)[:2])

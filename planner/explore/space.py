"""Voxel space of an unknown part: free, occupied or unknown voxels within an upright cylinder.

The part is in the cylinder; at first all of it is unknown, and everything outside is free. A ray that returns a
point says two things: the point is on the part, and both line segments (source to point, point to sensor) are free. A
ray that returns no point says nothing certain: it may have missed the part, or met it at a grazing angle. So a voxel is

    occupied  if a point lies in it, whatever else crossed it;
    free      if a line segment crossed it and no point lies in it;
    unknown   otherwise.

A ray without a point still makes it less likely that the part is on its path: `votes` counts this, for the belief
and for planning, never for safety. A ray that may have met the part in front of the scanner's range says nothing about
the space behind it.

The part may be in every voxel that is not free, to within a voxel: a segment may pass by a piece of surface in the same
voxel, and a piece that is thinner than the distance of rays may be missed. Object frame, metres: the origin is the
centre of the cylinder, z is its axis.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from planner.compiled import compiled
from planner.errors import PlannerError
from planner.explore.gain import OpenSamples
from planner.values import Bools, Floats, Ints, Value

UNKNOWN, FREE, OCCUPIED = 0, 1, 2

MAX_VOXELS = 8_000_000
"""Largest number of voxels of a grid, which takes four bytes for each, and eight more while rays are added."""

_BELIEF_BOX, _BELIEF_STEPS = 3, 5
"""Distance from measured voxels up to which the belief continues [edges]: a box, and steps to face neighbours around
it. This is eight along each axis and nine at most, nearly a ball in a tenth of its time. Farther away the part may be
anywhere in uncrossed space, or nowhere, and a surface around all of it would occlude the space between in planning."""

_PADDING = 3  # free voxels around the cylinder, so that surfaces around voxels that are not free are closed
_FIRST_BELIEF = 0.6  # of the cylinder: a view of this size looks deep into it, where the part's surface may be
_GAP_SPACINGS, _GAP_EDGES = 0.9, 0.35
"""Distance across its normal of a belief surface from a measured point from which there is a gap, in point distances at
the standoff, and in edges (the belief has no higher resolution); the larger one counts."""
_ABOVE, _BELOW = 0.5, 1.6
"""Edges above and below a measured point within which the belief surface around it lies."""
_THINNING = 0.7  # of a gap: side of the cubes that keep one point each
_NEIGHBOURS = 8  # nearest points that are compared: near the middle of a gap there are fewer
_NO_RETURN_VOTE = np.int16(2)
"""Votes of a view for a ray without a point: most such rays miss the part, while anything may lie behind a point."""
_RAY_STEP = 0.7  # edges between the positions at which the path of such a ray is checked
_NEIGHBOURHOOD = np.ones((3, 3, 3), dtype=np.bool_)


@dataclass(frozen=True, slots=True, eq=False)
class VoxelSpace(Value):
    """Voxels and measured points.

    Attributes:
        low: (3,) lowest corner of the grid [m].
        edge: of a voxel [m].
        state: (X, Y, Z) UNKNOWN, FREE or OCCUPIED.
        votes: (X, Y, Z) twice the number of views with a ray through a voxel that returned no point, less the number of
            views with a point in front of it.
        tries: (X, Y, Z) number of executed views that should have measured uncovered surface in a voxel.
        gap: distance to the nearest measured point above which surface is not measured [m].
        points: (P, 3) measured points, the first in each of small cubes, in the order of measurement [m].
        between: (Q, 3) positions between points of neighbouring rays, thinned likewise [m].
        radius: of the cylinder [m].
        height: of the cylinder [m].
    """

    low: Annotated[Floats, "3"]
    edge: float
    state: Annotated[NDArray[np.uint8], "X Y Z"]
    votes: Annotated[NDArray[np.int16], "X Y Z"]
    tries: Annotated[NDArray[np.uint8], "X Y Z"]
    gap: float
    points: Annotated[Floats, "P 3"]
    between: Annotated[Floats, "Q 3"]
    radius: float
    height: float

    @classmethod
    def from_cylinder(cls, radius: float, height: float, edge: float, spacing: float) -> "VoxelSpace":
        """Return a space in which all voxels of the cylinder are unknown.

        Args:
            radius: of the cylinder [m].
            height: of the cylinder [m].
            edge: of a voxel [m].
            spacing: distance of points at perpendicular incidence [m].

        Raises:
            PlannerError: if one of them is not positive, or the grid has too many voxels.
        """
        if not min(radius, height, edge, spacing) > 0:
            sizes = f"radius {radius:g}, height {height:g}, edge {edge:g} and spacing {spacing:g}"
            raise PlannerError(f"{sizes} must be above 0 (in metres)")
        half = np.ceil(np.array([radius, radius, height / 2]) / edge) + _PADDING
        shape = tuple(int(2 * n) for n in half)
        if (count := np.prod([float(n) for n in shape])) > MAX_VOXELS:
            limit = f"{count:.3g} voxels of {1000 * edge:g} mm exceed the limit of {MAX_VOXELS}"
            raise PlannerError(f"{limit}; choose larger voxels or a smaller cylinder")
        low = -half * edge
        zeros = np.zeros(shape, np.uint8)
        votes, no_points = zeros.astype(np.int16), np.empty((0, 3))
        gap = max(_GAP_SPACINGS * spacing, _GAP_EDGES * edge)
        space = cls(low, edge, zeros, votes, zeros, gap, no_points, no_points, radius, height)
        return replace(space, state=np.where(space._within(edge / 2), UNKNOWN, FREE).astype(np.uint8))

    def centres(self, which: Bools) -> Floats:
        """Return the (n, 3) centres of some voxels [m]."""
        return np.asarray(self.low + self.edge * (np.argwhere(which) + 0.5))

    @property
    def unseen_volume(self) -> float:
        """Volume without points that no line segment crossed [m^3]: interior of the part, and hidden space."""
        return float((self.state == UNKNOWN).sum() * self.edge**3)

    def outside(self, points: Floats) -> Bools:
        """Return (N,) whether points (N, 3) [m] are outside the cylinder by more than a voxel."""
        is_outside = np.hypot(points[:, 0], points[:, 1]) > self.radius + self.edge
        return np.asarray(is_outside | (np.abs(points[:, 2]) > self.height / 2 + self.edge))

    def values_at(self, points: Floats, values: NDArray[np.generic]) -> NDArray[np.generic]:
        """Return the (N,) values of an (X, Y, Z) array at points (N, 3) [m]; outside the grid those of its border."""
        at_points: NDArray[np.generic] = values[tuple(self._index(points).T)]
        return at_points

    @property
    def maybe_part(self) -> Bools:
        """(X, Y, Z) whether the part may be in a voxel: it has a point, or is neither crossed nor voted down."""
        return np.asarray((self.state == OCCUPIED) | ((self.state == UNKNOWN) & (self.votes <= 0)))

    def with_points(self, points: Floats, origins: Sequence[Floats]) -> "VoxelSpace":
        """Add the points of one view, and free the voxels on their lines of sight.

        Args:
            points: (N, 3) measured [m].
            origins: (3,) positions from which every point was visible [m]: the source, the sensor.
        """
        crossed = np.zeros(self.state.shape, dtype=np.bool_)
        for origin in origins:
            segments = points - origin
            length = np.linalg.norm(segments, axis=1, keepdims=True)
            # noise moves a point along its line of sight: stop an edge before it
            share = np.maximum(1.0 - self.edge / np.maximum(length, 1e-12), 0.0)
            crossed |= self._crossed(np.broadcast_to(origin, points.shape), origin + share * segments)
        state = np.array(self.state)
        state[crossed & (state == UNKNOWN)] = FREE
        inside = points[~self.outside(points)]
        state[tuple(self._index(inside).T)] = OCCUPIED
        return replace(self, state=state, points=self._thinned(np.concatenate([self.points, inside])))

    def with_surface_between(self, positions: Floats) -> "VoxelSpace":
        """Add (N, 3) positions between points of neighbouring rays of one view, on the same surface [m]."""
        inside = positions[~self.outside(positions)]
        return replace(self, between=self._thinned(np.concatenate([self.between, inside])))

    def with_votes(
        self, points: Floats, source: Floats, sensor: Floats, blank: Floats, near: float, far: float
    ) -> "VoxelSpace":
        """Add the votes of one view.

        A ray without a point says nothing about voxels that are hidden from the sensor by points. It says nothing at
        all if the part may be on its path in front of the scanner's range.

        Args:
            points: (N, 3) measured [m].
            source: (3,) origin of the rays [m].
            sensor: (3,) position of the sensor [m].
            blank: (M, 3) unit directions of the rays without a point.
            near: begin of the range [m].
            far: end of the range [m].
        """
        behind, hidden = (self._behind(points, origin, far) for origin in (source, sensor))
        blank = blank[self.is_ray_clear(source, blank, near)]
        through = self._crossed(source + near * blank, source + far * blank)
        return replace(self, votes=self.votes + _NO_RETURN_VOTE * (through & ~behind & ~hidden) - behind)

    def is_ray_clear(self, source: Floats, rays: Floats, length: float) -> Bools:
        """Return (N,) whether the part cannot be on a ray up to a distance from its source.

        Args:
            source: (3,) [m].
            rays: (N, 3) unit vectors.
            length: [m].
        """
        clear, maybe_part = np.arange(len(rays)), self.maybe_part
        outside = np.linalg.norm(source) - np.linalg.norm(self.low)  # no ray is in the grid up to this distance
        for distance in np.arange(0.0, length, _RAY_STEP * self.edge):
            if distance < outside:
                continue
            clear = clear[~self.values_at(source + distance * rays[clear], maybe_part).astype(np.bool_)]
        return np.isin(np.arange(len(rays)), clear)

    def contradicted_share(self, points: Floats) -> float:
        """Return the share of points (N, 3) [m] in free voxels with free neighbours: a sign that the part moved."""
        far = ~ndimage.binary_dilation(self.state != FREE, _NEIGHBOURHOOD)
        return float(self.values_at(points, far & self._within(0.0)).mean()) if len(points) else 0.0

    def belief_voxels(self, *, unlimited: bool = False) -> Bools:
        """Return (X, Y, Z) whether the part is believed to be in a voxel.

        Such a voxel is not free, not voted down, and connected to a voxel with a point: a part, or each body of it, is
        connected, and unknown space without a connection to a point has merely not been crossed yet. The belief
        continues `_BELIEF_BOX` and `_BELIEF_STEPS` behind measured voxels, and in space that they enclose. Before the
        first point it is `_FIRST_BELIEF` of the cylinder in its middle, at least two voxels.

        Args:
            unlimited: continue to any distance from measured voxels: the largest extent of the part.
        """
        if not (self.state == OCCUPIED).any():
            return self._cylinder(*(max(_FIRST_BELIEF * half, self.edge) for half in (self.radius, self.height / 2)))
        solid = self.maybe_part
        if not unlimited:
            near = ndimage.maximum_filter((self.state == OCCUPIED).view(np.uint8), 2 * _BELIEF_BOX + 1)
            solid &= ndimage.binary_dilation(near, iterations=_BELIEF_STEPS)
        labels, count = ndimage.label(solid, _NEIGHBOURHOOD)
        has_points = np.zeros(count + 1, dtype=np.bool_)
        has_points[labels[self.state == OCCUPIED]] = True
        return np.asarray(ndimage.binary_fill_holes(has_points[labels]) & (self.state != FREE))

    def is_measured(self, points: Floats, normals: Floats) -> Bools:
        """Return (N,) whether points of a belief surface have a measured point near their normal.

        Args:
            points: (N, 3) [m].
            normals: (N, 3) outward unit normals.
        """
        return self._has_neighbour(self.points, points, normals)

    def is_near_measured(self, points: Floats) -> Bools:
        """Return (N,) whether points (N, 3) [m] are at most an edge from a measured one."""
        return np.isfinite(_tree(self.points).query(points, distance_upper_bound=self.edge)[0])

    def measured_since(self, before: "VoxelSpace", points: Floats, normals: Floats) -> tuple[Bools, Bools]:
        """Return (N,) whether points are measured, and whether they are and were not in the earlier space `before`."""
        measured, new = self.is_measured(points, normals), np.zeros(len(points), dtype=np.bool_)
        added = _tree(self.points[len(before.points) :])
        near = np.isfinite(added.query(points[measured], distance_upper_bound=self._max_distance)[0])
        candidates = np.flatnonzero(measured)[near]  # nothing is new without a new point nearby
        new[candidates] = ~before.is_measured(points[candidates], normals[candidates])
        return measured, new

    def is_new(self, points: Floats) -> Bools:
        """Return (N,) whether points (N, 3) of a view [m] lie in a gap between earlier points, or beyond them."""
        near = _tree(self.points).query(points, distance_upper_bound=self.gap)[0]
        return np.asarray(~np.isfinite(near))

    def is_still_open(self, points: Floats, normals: Floats) -> Bools:
        """Return (N,) whether points of an earlier belief surface are neither measured nor free.

        Args:
            points: (N, 3) [m].
            normals: (N, 3) outward unit normals.
        """
        inside = points - self.edge * normals
        is_free = self.values_at(inside, self.state) == FREE
        return np.asarray(~self.is_measured(points, normals) & ~is_free, dtype=np.bool_)

    def with_tries(self, points: Floats) -> "VoxelSpace":
        """Count one more try for the voxels of points (N, 3) [m], each voxel once."""
        tries = np.array(self.tries)
        index = tuple(np.unique(self._index(points), axis=0).T)
        tries[index] = np.minimum(tries[index].astype(np.int64) + 1, 255).astype(np.uint8)
        return replace(self, tries=tries)

    def open_samples_at(self, points: Floats, normals: Floats) -> OpenSamples:
        """Return the features of points of a belief surface; tries within two voxels count for the same patch."""
        measured = self.centres(self.state == OCCUPIED)
        distance = _tree(measured).query(points)[0] / self.edge if len(measured) else np.full(len(points), np.inf)
        tries = self.values_at(points, ndimage.maximum_filter(self.tries, 5))
        between = self._has_neighbour(self.between, points, normals)
        return OpenSamples(np.asarray(tries, dtype=np.int64), np.asarray(distance), between)

    def _has_neighbour(self, known: Floats, points: Floats, normals: Floats) -> Bools:
        """Return (N,) whether one of the `known` positions (P, 3) next to each point is within a gap of its normal."""
        has_neighbour, tree = np.zeros(len(points), dtype=np.bool_), _tree(known)
        for n_neighbours in (1, _NEIGHBOURS):  # the nearest one decides most
            left = np.flatnonzero(~has_neighbour)
            k = np.arange(1, n_neighbours + 1)
            distance, at = map(np.asarray, tree.query(points[left], k=k, distance_upper_bound=self._max_distance))
            which, _ = np.nonzero(np.isfinite(distance))
            offsets, along = known[at[np.isfinite(distance)]] - points[left][which], normals[left][which]
            height = np.einsum("ij,ij->i", offsets, along)
            across = np.linalg.norm(offsets - height[:, None] * along, axis=1)
            on_surface = (height <= _ABOVE * self.edge) & (height >= -_BELOW * self.edge)
            has_neighbour[left] = np.bincount(which[(across <= self.gap) & on_surface], minlength=len(left)) > 0
        return has_neighbour

    def _thinned(self, points: Floats) -> Floats:
        """Return the first of the points (N, 3) [m] in each of small cubes."""
        return points[first_in_cubes(points - self.low, _THINNING * self.gap)]

    def _crossed(self, starts: Floats, ends: Floats) -> Bools:
        """Return (X, Y, Z) whether segments from (N, 3) to (N, 3) cross a voxel [m]."""
        count = np.zeros(self.state.size, dtype=np.int64)
        begin, end = (np.ascontiguousarray(each, dtype=np.float64) for each in (starts, ends))
        count_crossings(begin, end, np.array(self.low), self.edge, self._shape, count)
        return np.asarray(count > 0).reshape(self.state.shape)

    def _behind(self, points: Floats, origin: Floats, far: float) -> Bools:
        """Return (X, Y, Z) whether points (N, 3) hide a voxel from a position (3,), up to `far` from it [m]."""
        length = np.linalg.norm(points - origin, axis=1, keepdims=True)
        direction = (points - origin) / np.maximum(length, 1e-12)
        return self._crossed(points + self.edge * direction, origin + np.maximum(far, length) * direction)

    @property
    def _max_distance(self) -> float:
        """Largest distance of a measured point from the belief surface near it [m]."""
        return float(np.hypot(self.gap, _BELOW * self.edge))

    @property
    def _shape(self) -> Ints:
        return np.array(self.state.shape, dtype=np.int64)

    def _index(self, points: Floats) -> Ints:
        """Return the (N, 3) voxel of each point, the nearest of the grid."""
        return np.clip(np.floor((points - self.low) / self.edge).astype(np.int64), 0, self._shape - 1)

    def _within(self, margin: float) -> Bools:
        """Return (X, Y, Z) whether the centre of a voxel is inside the cylinder, or at most the margin outside [m]."""
        return self._cylinder(self.radius + margin, self.height / 2 + margin)

    def _cylinder(self, radius: float, half: float) -> Bools:
        """Return (X, Y, Z) whether the centre of a voxel is in a cylinder about the axis [m]."""
        x, y, z = (low + self.edge * (np.arange(n) + 0.5) for low, n in zip(self.low, self._shape, strict=True))
        disc = np.hypot(x[:, None], y[None]) <= radius
        return np.asarray(disc[:, :, None] & (np.abs(z) <= half))


def _tree(points: Floats) -> cKDTree:
    """Return a tree that is built in half the time of a balanced one: each is used for one query."""
    return cKDTree(points, balanced_tree=False, compact_nodes=False)


def first_in_cubes(points: Floats, side: float) -> Ints:
    """Return the (M,) indices of the first point (N, 3) [m] in each cube of a side [m], ascending.

    The extent of the points must be less than two million sides.
    """
    if not len(points):
        return np.empty(0, dtype=np.int64)
    cubes = np.floor(points / side).astype(np.int64)
    cubes -= cubes.min(axis=0)
    number = np.ravel_multi_index(tuple(cubes.T), tuple(cubes.max(axis=0) + 1))
    return np.sort(np.unique(number, return_index=True)[1])


@compiled
def count_crossings(starts: Floats, ends: Floats, low: Floats, edge: float, shape: Ints, crossed: Ints) -> None:
    """Count the segments that cross each voxel of a grid (Amanatides and Woo 1987).

    Voxel (i, j, k) is the box from `low + edge * (i, j, k)` to one edge further; its flat index is that of a C-ordered
    array.

    Args:
        starts: (N, 3) begin of each segment [m].
        ends: (N, 3) end of each segment [m].
        low: (3,) lowest corner of the grid [m].
        edge: of a voxel [m].
        shape: (3,) voxels along each axis.
        crossed: (shape[0] * shape[1] * shape[2],) the counts are added to it.
    """
    at, step = np.empty(3, np.int64), np.empty(3, np.int64)
    border, across = np.empty(3), np.empty(3)
    for n in range(len(starts)):
        begin, end = 0.0, 1.0  # part of the segment in the grid, as shares of its length
        for axis in range(3):
            along = ends[n, axis] - starts[n, axis]
            first = low[axis] - starts[n, axis]
            last = first + edge * shape[axis]
            if along == 0.0:
                if first > 0.0 or last < 0.0:
                    begin = 2.0
            else:
                begin = max(begin, min(first / along, last / along))
                end = min(end, max(first / along, last / along))
        if begin >= end:
            continue
        for axis in range(3):
            along = ends[n, axis] - starts[n, axis]
            place = (starts[n, axis] + begin * along - low[axis]) / edge
            at[axis] = min(max(np.int64(np.floor(place)), 0), shape[axis] - 1)
            step[axis] = 1 if along > 0.0 else -1
            if along == 0.0:
                border[axis], across[axis] = np.inf, np.inf
            else:
                wall = low[axis] + edge * (at[axis] + (1 if along > 0.0 else 0))
                border[axis] = (wall - starts[n, axis]) / along
                across[axis] = edge / abs(along)
        while True:
            crossed[(at[0] * shape[1] + at[1]) * shape[2] + at[2]] += 1
            axis = 0
            if border[1] < border[axis]:
                axis = 1
            if border[2] < border[axis]:
                axis = 2
            if border[axis] >= end:
                break
            at[axis] += step[axis]
            if at[axis] < 0 or at[axis] >= shape[axis]:
                break
            border[axis] += across[axis]

"""What is known of the space about a part: free, occupied or unknown voxels within an upright cylinder.

A part stands somewhere in the cylinder; all of it is unknown at first, all beyond it is free. A ray that came back says
two things: its point is on the part, and both its legs (source to point, point to sensor) crossed nothing. What did
not come back says nothing: it may have missed the part, or met it too steeply. So a voxel is

    occupied  where a point lies in it, whatever else crossed it;
    free      where a leg crossed it and no point lies in it;
    unknown   otherwise.

What did not come back still makes it less likely that the part is where its ray went: `votes` counts, for what is
believed and planned for, never for what is safe. A ray that may have met the part before the scanner begins to measure
tells nothing of what lies behind.

The part may be in every voxel that is not free, to within a voxel: a leg may pass beside a piece of surface that lies
in the same voxel, and what is thinner than the rays are apart may be missed altogether. Object frame, metres: its
origin is the cylinder's middle, z is its axis.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from planner.errors import PlannerError
from planner.explore.cubes import first_in_cubes
from planner.explore.gain import OpenSamples
from planner.values import Bools, Floats, Ints, Value

UNKNOWN, FREE, OCCUPIED = 0, 1, 2

MOST_VOXELS = 8_000_000
"""Of a grid; two arrays of bytes and one of 8-byte counters are made of it."""

_BOX, _STEPS = 3, 5
"""Edges behind what was measured to which the part is believed to go on, a box and steps to face neighbours about it:
eight along each axis, nine at most, nearly a ball in a tenth of its time. Farther off the part may be anywhere in what
no leg crossed, or nowhere, and a surface about all of that hides from the planning what lies between."""

_PADDING = 3  # free voxels about the cylinder, so that surfaces about what is not free are closed
_LIKELY = 0.6  # of the cylinder: a view for this much of it looks deep into it, where the part's surface may be
_GAP, _KNOWN = 0.9, 0.35
"""Distances of points at the standoff, and edges (what is believed is known to no less), across its normal from what is
believed to a measured point, above which there is a gap between points ..."""
_ABOVE, _BELOW = 0.5, 1.6
"""... of those no more edges above and below it than a believed surface lies beside the points that it is made of."""
_APART = 0.7  # of a gap: side of the cubes of which each keeps one point
_NEIGHBOURS = 8  # that are looked at: next to the middle of a gap there are fewer
_BLANK = np.int16(2)
"""Votes of a view whose ray did not come back: most miss the part, while behind a point lies anything."""
_LOOKED = 0.7  # edges between places at which the way of such a ray is looked at
_ALL_ROUND = np.ones((3, 3, 3), dtype=np.bool_)


@dataclass(frozen=True, slots=True, eq=False)
class VoxelSpace(Value):
    """The voxels.

    Attributes:
        low: (3,) lowest corner of the grid [m].
        edge: of a voxel [m].
        state: (X, Y, Z) UNKNOWN, FREE or OCCUPIED.
        votes: (X, Y, Z) twice the views with a ray through a voxel that did not come back, less those that saw a point
            before it.
        tries: (X, Y, Z) how many views were executed that were expected to measure what is open in a voxel.
        gap: distance to the nearest measured point above which nothing is measured [m].
        points: (P, 3) measured ones, the first in each of small cubes, in the order in which they came [m].
        between: (Q, 3) places between those of neighbouring rays, likewise [m].
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
        """All unknown.

        Args:
            radius: of the cylinder [m].
            height: of the cylinder [m].
            edge: of a voxel [m].
            spacing: distance of points where the scanner looks squarely [m].

        Raises:
            PlannerError: if one of them is not positive, or the grid would have too many voxels.
        """
        if not min(radius, height, edge, spacing) > 0:
            sizes = f"radius {radius:g}, height {height:g}, edge {edge:g} and spacing {spacing:g}"
            raise PlannerError(f"{sizes} must be above 0 (in metres)")
        half = np.ceil(np.array([radius, radius, height / 2]) / edge) + _PADDING
        shape = tuple(int(2 * n) for n in half)
        if np.prod([float(n) for n in shape]) > MOST_VOXELS:
            raise PlannerError(f"voxels of {1000 * edge:g} mm are too many for the cylinder; choose larger ones")
        low = -half * edge
        nothing = np.zeros(shape, np.uint8)
        votes, none = nothing.astype(np.int16), np.empty((0, 3))
        gap = max(_GAP * spacing, _KNOWN * edge)
        space = cls(low, edge, nothing, votes, nothing, gap, none, none, radius, height)
        return replace(space, state=np.where(space._within(edge / 2), UNKNOWN, FREE).astype(np.uint8))

    def centres(self, chosen: Bools) -> Floats:
        """(n, 3) middles of the chosen voxels [m]."""
        return np.asarray(self.low + self.edge * (np.argwhere(chosen) + 0.5))

    @property
    def unseen_volume(self) -> float:
        """Volume that no leg crossed and no point lies in [m^3]: the part's inside, solid or hollow, and what hides."""
        return float((self.state == UNKNOWN).sum() * self.edge**3)

    def outside(self, points: Floats) -> Bools:
        """(N,) which points (N, 3) [m] are beyond the cylinder by more than a voxel."""
        beyond = np.hypot(points[:, 0], points[:, 1]) > self.radius + self.edge
        return np.asarray(beyond | (np.abs(points[:, 2]) > self.height / 2 + self.edge))

    def values_at(self, points: Floats, values: NDArray[np.generic]) -> NDArray[np.generic]:
        """(N,) the value of an (X, Y, Z) array at each of the points (N, 3) [m]; beyond the grid that of its border."""
        found: NDArray[np.generic] = values[tuple(self._place(points).T)]
        return found

    @property
    def maybe_part(self) -> Bools:
        """(X, Y, Z) where the part may be: hit, or neither crossed nor voted down."""
        return np.asarray((self.state == OCCUPIED) | ((self.state == UNKNOWN) & (self.votes <= 0)))

    def with_points(self, points: Floats, stands: Sequence[Floats]) -> "VoxelSpace":
        """With the points of one view, and its legs.

        Args:
            points: (N, 3) measured [m].
            stands: (3,) places from which every point was in sight [m]: the source, the sensor.
        """
        crossed = np.zeros(self.state.shape, dtype=np.bool_)
        for stand in stands:
            legs = points - stand
            length = np.linalg.norm(legs, axis=1, keepdims=True)
            kept = np.maximum(1.0 - self.edge / np.maximum(length, 1e-12), 0.0)  # noise moves a point along its leg
            crossed |= self._crossed(np.broadcast_to(stand, points.shape), stand + kept * legs)
        state = np.array(self.state)
        state[crossed & (state == UNKNOWN)] = FREE
        within = points[~self.outside(points)]
        state[tuple(self._place(within).T)] = OCCUPIED
        return replace(self, state=state, points=self._thinned(np.concatenate([self.points, within])))

    def with_surface_between(self, places: Floats) -> "VoxelSpace":
        """With (N, 3) places between points of neighbouring rays of one view, on one surface with them [m]."""
        return replace(self, between=self._thinned(np.concatenate([self.between, places[~self.outside(places)]])))

    def with_votes(
        self, points: Floats, source: Floats, sensor: Floats, blank: Floats, near: float, far: float
    ) -> "VoxelSpace":
        """With the votes of one view; what points hide from the sensor would not have come back.

        Nor would what lies behind a part that stands too near: a ray says nothing where its way to the range leads
        through what may be the part's.

        Args:
            points: (N, 3) measured [m].
            source: (3,) where the rays began [m].
            sensor: (3,) from where they are seen [m].
            blank: (M, 3) unit directions of the rays that did not come back.
            near: from where on they would have [m].
            far: to where they would have [m].
        """
        behind, hidden = (self._behind(points, stand, far) for stand in (source, sensor))
        blank = blank[self.is_ray_clear(source, blank, near)]
        through = self._crossed(source + near * blank, source + far * blank)
        return replace(self, votes=self.votes + _BLANK * (through & ~behind & ~hidden) - behind)

    def is_ray_clear(self, source: Floats, rays: Floats, length: float) -> Bools:
        """(N,) along which rays nothing that may be the part's stands so far from their source.

        Args:
            source: (3,) [m].
            rays: (N, 3) unit vectors.
            length: [m].
        """
        clear, possible = np.arange(len(rays)), self.maybe_part
        outside = np.linalg.norm(source) - np.linalg.norm(self.low)  # as far no ray is in the grid
        for distance in np.arange(0.0, length, _LOOKED * self.edge):
            if distance < outside:
                continue
            clear = clear[~self.values_at(source + distance * rays[clear], possible).astype(np.bool_)]
        return np.isin(np.arange(len(rays)), clear)

    def contradicted_share(self, points: Floats) -> float:
        """Share of points (N, 3) [m] in space that is free, all its neighbours too: what moved has such points."""
        far = ~ndimage.binary_dilation(self.state != FREE, _ALL_ROUND)
        return float(self.values_at(points, far & self._within(0.0)).mean()) if len(points) else 0.0

    def belief_voxels(self, *, unlimited: bool = False) -> Bools:
        """(X, Y, Z) where the part is believed to be: not free, not voted down, in one piece with a point of it.

        A part, or each body of it, that was hit hangs together; what hangs together with nothing that was hit is space
        that no leg has crossed yet. It goes on `_BOX` and `_STEPS` behind what was measured, and where that encloses
        space no leg enters it. Before the first point it is the middle of the cylinder, `_LIKELY`, two voxels at least.

        Args:
            unlimited: however far it is from what was measured: where the part may be at most.
        """
        if not (self.state == OCCUPIED).any():
            return self._cylinder(*(max(_LIKELY * half, self.edge) for half in (self.radius, self.height / 2)))
        solid = self.maybe_part
        if not unlimited:
            about = ndimage.maximum_filter((self.state == OCCUPIED).view(np.uint8), 2 * _BOX + 1)
            solid &= ndimage.binary_dilation(about, iterations=_STEPS)
        labels, count = ndimage.label(solid, _ALL_ROUND)
        hit = np.zeros(count + 1, dtype=np.bool_)
        hit[labels[self.state == OCCUPIED]] = True
        return np.asarray(ndimage.binary_fill_holes(hit[labels]) & (self.state != FREE))

    def is_measured(self, points: Floats, normals: Floats) -> Bools:
        """(N,) which points of a believed surface have a measured point beside them, looked at along their normals.

        Args:
            points: (N, 3) [m].
            normals: (N, 3) outward unit normals.
        """
        return self._beside(self.points, points, normals)

    def is_near_measured(self, points: Floats) -> Bools:
        """(N,) which points (N, 3) [m] are at most an edge from a measured one."""
        tree = cKDTree(self.points, balanced_tree=False, compact_nodes=False)  # builds faster than it is asked
        return np.isfinite(tree.query(points, distance_upper_bound=self.edge)[0])

    def measured_since(self, before: "VoxelSpace", points: Floats, normals: Floats) -> tuple[Bools, Bools]:
        """(N,) what is seen, and what of it was not `before`, of which this is what followed; `points` as in `seen`."""
        seen, new = self.is_measured(points, normals), np.zeros(len(points), dtype=np.bool_)
        added = cKDTree(self.points[len(before.points) :])
        near = np.isfinite(added.query(points[seen], distance_upper_bound=self._farthest)[0])
        some = np.flatnonzero(seen)[near]  # without a point more beside it nothing is new
        new[some] = ~before.is_measured(points[some], normals[some])
        return seen, new

    def is_new(self, points: Floats) -> Bools:
        """(N,) which points (N, 3) of a view [m] lie in a gap between those that were measured before, or beyond."""
        near = cKDTree(self.points).query(points, distance_upper_bound=self.gap)[0]
        return np.asarray(~np.isfinite(near))

    def is_still_open(self, points: Floats, normals: Floats) -> Bools:
        """(N,) which points of an earlier believed surface are neither seen nor free.

        Args:
            points: (N, 3) [m].
            normals: (N, 3) outward unit normals.
        """
        inside = points - self.edge * normals
        return np.asarray(
            ~self.is_measured(points, normals) & (self.values_at(inside, self.state) != FREE), dtype=np.bool_
        )

    def with_tries(self, points: Floats) -> "VoxelSpace":
        """With one more try for the voxels of points (N, 3) [m], each voxel once."""
        tries = np.array(self.tries)
        place = tuple(np.unique(self._place(points), axis=0).T)
        tries[place] = np.minimum(tries[place].astype(np.int64) + 1, 255).astype(np.uint8)
        return replace(self, tries=tries)

    def open_samples_at(self, points: Floats, normals: Floats) -> OpenSamples:
        """What class points of a believed surface are of, as in `seen`; tries within two voxels are of one patch."""
        measured = self.centres(self.state == OCCUPIED)
        beside = cKDTree(measured).query(points)[0] / self.edge if len(measured) else np.full(len(points), np.inf)
        tries = self.values_at(points, ndimage.maximum_filter(self.tries, 5))
        between = self._beside(self.between, points, normals)
        return OpenSamples(np.asarray(tries, dtype=np.int64), np.asarray(beside), between)

    def _beside(self, known: Floats, points: Floats, normals: Floats) -> Bools:
        """(N,) whether one of the `known` places (P, 3) next to each is within a gap of its normal."""
        found, tree = np.zeros(len(points), dtype=np.bool_), cKDTree(known)
        for many in (1, _NEIGHBOURS):  # the nearest says enough of most
            rest = np.flatnonzero(~found)
            k = np.arange(1, many + 1)
            distance, at = map(np.asarray, tree.query(points[rest], k=k, distance_upper_bound=self._farthest))
            which, _ = np.nonzero(np.isfinite(distance))
            legs, along = known[at[np.isfinite(distance)]] - points[rest][which], normals[rest][which]
            height = np.einsum("ij,ij->i", legs, along)
            across = np.linalg.norm(legs - height[:, None] * along, axis=1)
            on_it = (height <= _ABOVE * self.edge) & (height >= -_BELOW * self.edge)
            found[rest] = np.bincount(which[(across <= self.gap) & on_it], minlength=len(rest)) > 0
        return found

    def _thinned(self, points: Floats) -> Floats:
        """The first of the points (N, 3) [m] in each of small cubes."""
        return points[first_in_cubes(points - self.low, _APART * self.gap)]

    def _crossed(self, starts: Floats, ends: Floats) -> Bools:
        """(X, Y, Z) the voxels that legs from (N, 3) to (N, 3) cross [m]."""
        from planner.explore.traverse import cross  # puts off numba

        count = np.zeros(self.state.size, dtype=np.int64)
        begin, end = (np.ascontiguousarray(each, dtype=np.float64) for each in (starts, ends))
        cross(begin, end, np.array(self.low), self.edge, self._shape, count)
        return np.asarray(count > 0).reshape(self.state.shape)

    def _behind(self, points: Floats, stand: Floats, far: float) -> Bools:
        """(X, Y, Z) the voxels that points (N, 3) hide from a place (3,), as far as `far` from it [m]."""
        length = np.linalg.norm(points - stand, axis=1, keepdims=True)
        onward = (points - stand) / np.maximum(length, 1e-12)
        return self._crossed(points + self.edge * onward, stand + np.maximum(far, length) * onward)

    @property
    def _farthest(self) -> float:
        """Distance of a measured point that is beside a believed surface, at most [m]."""
        return float(np.hypot(self.gap, _BELOW * self.edge))

    @property
    def _shape(self) -> Ints:
        return np.array(self.state.shape, dtype=np.int64)

    def _place(self, points: Floats) -> Ints:
        """(N, 3) the voxel of each point, the nearest of the grid."""
        return np.clip(np.floor((points - self.low) / self.edge).astype(np.int64), 0, self._shape - 1)

    def _within(self, more: float) -> Bools:
        """(X, Y, Z) whose middle is in the cylinder, or so much beyond [m]."""
        return self._cylinder(self.radius + more, self.height / 2 + more)

    def _cylinder(self, radius: float, half: float) -> Bools:
        """(X, Y, Z) whose middle is in a cylinder about the axis [m]."""
        x, y, z = (low + self.edge * (np.arange(n) + 0.5) for low, n in zip(self.low, self._shape, strict=True))
        disc = np.hypot(x[:, None], y[None]) <= radius
        return np.asarray(disc[:, :, None] & (np.abs(z) <= half))

"""Scenes that can be and are hardly meant: fixtures in each other, things in the air or about to tip, lost units.

Something is carried where a chain of things that touch leads to the floor or the pedestal; the part on its post is.
Something rests where all that carries it touches it from below; it then has to have its centre of mass (of even
density; of its surface where that is open) above what it rests on. Contact is looked for by vertical rays.
"""

import numpy as np
from numpy.typing import NDArray

from cell.checks.sentences import called, move, stands_inside
from cell.checks.solid import Solid, inside, touches
from cell.checks.standing import arm, standing
from cell.part.workpiece import size_findings
from cell.rays.embree import EmbreeRayCaster
from cell.rays.occluders import floor_square
from cell.robot import told
from cell.scene.fixtures import MeshFixture
from cell.world.model import World
from planner.geometry.mesh import joined
from planner.values import Floats

TOUCHING = 1e-3
"""What comes nearer than this stands on each other [m]: a plan of a cell is hardly more precise."""

_GRID = 64  # vertical rays across the longer side of something ...
_FINE = 512  # ... where a length is told


def doubtful(world: World) -> list[str]:
    """What is hardly meant in a compiled scene, one sentence each."""
    fixtures, of_arm = world.scene.fixtures, told.doubts(world.spec)
    of_arm += _stopped_table(world)
    if not fixtures and world.scene.post.enabled:
        return of_arm
    solids = {name: solid for name, solid in standing(world).items() if name not in arm(world)}
    said = [
        finding.sentence
        for fixture in fixtures
        if isinstance(fixture, MeshFixture)
        for finding in size_findings(np.ptp(world.fixture_meshes[fixture.name].vertices, axis=0), fixture.units,
                                     called(world, fixture.name))
    ]  # fmt: skip
    return of_arm + said + _in_each_other(world, solids) + _standing_badly(world, solids)


def _stopped_table(world: World) -> list[str]:
    """A rotary table that cannot turn its part all the way."""
    if world.table is None:
        return []
    lower, upper = np.degrees([world.table.lower, world.table.upper]).round(4)
    low, high = world.scene.table.limits_deg or (-180.0, 180.0)
    if (lower, upper) == (low, high) or upper - lower >= 359:
        return []
    return [
        f"the rotary table turns its part from {lower:g} to {upper:g} deg only: farther it would come nearer than the "
        "clearance to what stands beside it"
    ]


def _in_each_other(world: World, solids: dict[str, Solid]) -> list[str]:
    """Fixtures in fixtures, in the pedestal and in the floor; the post through a fixture."""
    names = [fixture.name for fixture in world.scene.fixtures]
    said = []
    for number, name in enumerate(names):
        for other in (*names[:number], "pedestal"):
            if other in solids and inside(solids[name], solids[other]):
                said.append(stands_inside(world, solids[name], solids[other]))
        if "post" in solids and inside(solids["post"], solids[name]):
            said.append(
                f"the post goes through {called(world, name)}; set post.enabled = false where that carries the part"
            )
        if (depth := world.floor - float(solids[name].low[2])) > TOUCHING:
            said.append(
                f"{called(world, name)} reaches {1000 * depth:.1f} mm below the floor; "
                f"{move(world, name, np.array([0.0, 0.0, depth]))}"
            )
    return said


def _standing_badly(world: World, solids: dict[str, Solid]) -> list[str]:
    """What nothing carries, and what tips."""
    beside = {
        name: {other for other in solids if other != name and touches(solids[name], solids[other], TOUCHING)}
        for name in solids
    }
    if "post" in solids:  # it holds the part, wherever that touches it
        beside["part"].add("post")
        beside["post"].add("part")
    ground = [name for name in solids if solids[name].low[2] <= world.floor + TOUCHING or name == "pedestal"]
    carried = _joined(beside, ground, "")
    said, left = [], [name for name in solids if name not in carried]
    while left:
        together = _joined(beside, left[:1], "")
        left = [name for name in left if name not in together]
        said.append(_in_the_air(world, solids, together))
    for name in solids:
        carriers = beside[name] & _joined(beside, ground, name)
        if name in ("post", "pedestal") or name not in carried or "post" in carriers:
            continue
        below = [solids[each] for each in sorted(carriers)]
        rests = _Rests(solids[name], below, world.floor)
        if rests.on >= carriers and rests.tips() is not None:
            way = _Rests(solids[name], below, world.floor, _FINE).tips()
            if way is not None:
                said.append(
                    f"the centre of mass of {called(world, name)} is {1000 * float(np.linalg.norm(way)):.1f} mm beside "
                    f"what it rests on ({', '.join(called(world, each) for each in sorted(rests.on)) or 'the floor'}); "
                    f"it tips unless it is fastened: {move(world, name, way)}"
                )
    return said


def _in_the_air(world: World, solids: dict[str, Solid], together: set[str]) -> str:
    """A sentence about things that touch each other and that nothing carries."""
    others = [solid for name, solid in solids.items() if name not in together]
    gaps = {name: _Rests(solids[name], others, world.floor, _FINE).gap() for name in solids if name in together}
    name = min(gaps, key=lambda each: gaps[each][0])
    gap, below = gaps[name]
    rest = [called(world, each) for each in solids if each in together and each != name]
    with_it = f" (with {', '.join(rest)})" if rest else ""
    return (
        f"nothing carries {called(world, name)}{with_it}: it hangs {1000 * gap:.1f} mm above {called(world, below)}; "
        f"{move(world, name, np.array([0.0, 0.0, -gap]))}"
    )


def _joined(beside: dict[str, set[str]], some: list[str], without: str) -> set[str]:
    """What a chain of contacts joins with some things, `without` one thing."""
    found = {name for name in some if name != without}
    open_ends = list(found)
    while open_ends:
        for name in beside[open_ends.pop()] - found - {without}:
            found.add(name)
            open_ends.append(name)
    return found


class _Rests:
    """What something has vertically below it.

    Args:
        solid: that stands or hangs.
        others: below or beside it.
        floor: height [m].
        grid: vertical rays across the longer side.
    """

    def __init__(self, solid: Solid, others: list[Solid], floor: float, grid: int = _GRID) -> None:
        self._solid, self._names = solid, [*(other.name for other in others), "floor"]
        ground = Solid("floor", *floor_square(floor))
        vertices, faces, self._of_face = joined((each.vertices, each.faces) for each in (*others, ground))
        below = EmbreeRayCaster(vertices, faces)
        size = solid.high - solid.low
        self._step = float(max(size[:2].max(), 1e-6)) / grid
        sides = [np.arange(solid.low[axis] + self._step / 2, solid.high[axis], self._step) for axis in range(2)]
        x, y = np.meshgrid(*sides)
        under = _down(solid.caster, x.ravel(), y.ravel(), float(solid.low[2]) - self._step, up=True)[0]
        points = np.column_stack([x.ravel(), y.ravel(), under])
        feet = solid.vertices[np.unique(solid.faces)]
        points = np.concatenate([points[np.isfinite(under)], feet[feet[:, 2] <= solid.low[2] + TOUCHING]])
        start = points[:, 2] + TOUCHING
        height, face = _down(below, points[:, 0], points[:, 1], start)
        self._points, self._gaps = points, points[:, 2] - height
        self._below = np.where(face >= 0, self._of_face[face], len(self._names) - 1)

    @property
    def on(self) -> set[str]:
        """What it touches from above; the floor is not named."""
        return {self._names[k] for k in np.unique(self._below[self._gaps <= TOUCHING])} - {"floor"}

    def gap(self) -> tuple[float, str]:
        """How far it hangs above what is below it [m], and the name of that."""
        nearest = int(np.argmin(self._gaps))
        return float(self._gaps[nearest]), self._names[self._below[nearest]]

    def tips(self) -> Floats | None:
        """(3,) the shortest way [m] that brings the centre of mass above what it rests on; None where it is."""
        points = self._points[self._gaps <= TOUCHING][:, :2]
        if not len(points):
            return None
        way = _towards_hull(points, centre_of_mass(self._solid)[:2])
        return None if np.linalg.norm(way) <= self._step + TOUCHING else np.array([*way, 0.0])


def _down(
    caster: EmbreeRayCaster, x: Floats, y: Floats, start: Floats | float, *, up: bool = False
) -> tuple[Floats, NDArray[np.int32]]:
    """(N,) height at which a vertical ray meets a surface, inf or -inf where it does not [m]; and the face, or -1."""
    origins = np.column_stack([x, y, np.broadcast_to(start, x.shape)])
    direction = np.array([0.0, 0.0, 1.0 if up else -1.0])
    hits = caster.first_hit(origins, np.broadcast_to(direction, origins.shape))
    return origins[:, 2] + direction[2] * hits.distance, hits.face


def _towards_hull(points: Floats, at: Floats) -> Floats:
    """(2,) from a point (2,) to the nearest point of the convex hull of points (N, 2); 0 inside."""
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
    way: Floats = nearest[np.argmin(np.linalg.norm(nearest - at, axis=1))] - at
    return way


def centre_of_mass(solid: Solid) -> Floats:
    """(3,) of the body of even density, or of the surface where that is open [m]."""
    corners = solid.triangles - solid.low
    weights = np.einsum("fi,fi->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
    middles = corners.sum(axis=1) / 4
    if not solid.closed or abs(weights.sum()) < 1e-15:
        weights = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        middles = corners.mean(axis=1)
    centre: Floats = (weights[:, None] * middles).sum(axis=0) / weights.sum() + solid.low
    return centre

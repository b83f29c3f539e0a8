"""What the scanner's own body hides of its field of view: a mount or housing that is off by a sign does."""

import numpy as np
from numpy.typing import NDArray

from cell.checks.sentences import moved
from cell.rays.occluders import Occluder, caster_of, shape_triangles
from cell.world.model import World
from planner.values import Floats

_GRID = 33  # rays per axis of the field of view, its edges included: 2 deg apart at 60 deg
_SKIN = 1e-6  # m; a housing whose front face lies in the source's plane is not in the way
_LEG_ENDS = 1.0  # m; where the sensor's lines of sight are taken to end: nearer ends lie inside the same fan
_BEHIND = ("link_6", "bracket")  # what the housing is bolted to
_STEPS, _HALVINGS = 24, 12


def own_view(world: World) -> list[str]:
    """What hides a part of the scanner's own field of view, one sentence each."""
    problems = []
    if share := hidden_share(world):
        problems.append(
            f"the housing hides {100 * share:.0f} % of the scanner's own field of view; its front must lie behind "
            f"source and sensor: {moved('housing.position_mm', _housing(world)[:3, 3], _way_out(world))}, or "
            "change housing.size_mm or the mount"
        )
    if share := _hidden_by_the_wrist(world):
        problems.append(
            f"the robot's flange and bracket hide {100 * share:.0f} % of the scanner's own field of view; turn the "
            "scanner away from them: change mount.abc_deg or mount.position_mm"
        )
    return problems


def hidden_share(world: World, move: Floats | None = None) -> float:
    """Share of the field of view, from source and sensor, that the housing hides.

    Args:
        world: the compiled scene.
        move: (3,) of the housing, scanner frame [m]; None leaves it.
    """
    T_housing_scanner = np.asarray(np.linalg.inv(_housing(world)), dtype=np.float64)
    shift = np.zeros(3) if move is None else T_housing_scanner[:3, :3] @ move
    box = np.array(world.scene.housing.sides_mm) / 2000 - _SKIN
    starts, ends = _sight(world)
    hidden = np.zeros(len(ends), dtype=bool)
    for start in starts:
        hidden |= _hits(_moved(T_housing_scanner, start[None]) - shift, _moved(T_housing_scanner, ends) - shift, box)
    return float(hidden.mean())


def _housing(world: World) -> Floats:
    """(4, 4) the middle of the housing in the scanner frame [m]."""
    return world.scene.housing.T_scanner_housing(1000 * world.baseline)


def _sight(world: World) -> tuple[Floats, Floats]:
    """(2, 3) source and sensor, and (n, 3) ends of their lines of sight [m], scanner frame."""
    half = np.tan(np.radians(world.scene.scanner.opening_deg) / 2)
    x, y = np.meshgrid(*(np.linspace(-side, side, _GRID) for side in half))
    ends = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3) * _LEG_ENDS
    return np.array([[0.0, 0.0, 0.0], [world.baseline, 0.0, 0.0]]), ends


def _way_out(world: World) -> Floats:
    """(3,) the shortest way along an axis of the scanner frame on which the housing hides nothing any more [m]."""
    half = np.array(world.scene.housing.sides_mm) / 2000
    T = _housing(world)
    ahead = float(T[2, 3] + np.abs(T[2, :3]) @ half)  # its foremost corner: so far back, all of it is behind
    best, way = ahead, np.array([0.0, 0.0, -1.0])
    for direction in (*np.eye(3)[:2], *-np.eye(3)):
        steps = np.linspace(0, best, _STEPS + 1)
        clear = next((k for k in range(1, _STEPS) if not hidden_share(world, steps[k] * direction)), 0)
        if not clear:
            continue
        low, high = steps[clear - 1], steps[clear]
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            low, high = (middle, high) if hidden_share(world, middle * direction) else (low, middle)
        if high < best:
            best, way = high, direction
    return np.asarray(np.ceil(best * 1e4 - 0.02) / 1e4 * way)


def _hidden_by_the_wrist(world: World) -> float:
    """Share of the field of view, from source and sensor, that what carries the housing hides."""
    data = world.data()
    flange = data.site("flange")
    R = flange.xmat.reshape(3, 3) @ world.T_flange_scanner[:3, :3]
    origin = flange.xpos + flange.xmat.reshape(3, 3) @ world.T_flange_scanner[:3, 3]
    found = []
    for geom, name in enumerate(world.entities):
        if name in _BEHIND:
            vertices, faces = shape_triangles(world.model, data, geom)
            found.append(Occluder(name, (vertices - origin) @ R, faces))
    if not found or max(each.vertices[:, 2].max() for each in found) <= _SKIN:
        return 0.0  # all of it is behind source and sensor
    caster = caster_of(found)
    starts, ends = _sight(world)
    hidden: NDArray[np.bool_] = np.zeros(len(ends), dtype=bool)
    for start in starts:
        hidden |= caster.blocked(np.broadcast_to(start, ends.shape), ends)
    return float(hidden.mean())


def _moved(T: Floats, points: Floats) -> Floats:
    moved: Floats = points @ T[:3, :3].T + T[:3, 3]
    return moved


def _hits(start: Floats, ends: Floats, half: Floats) -> "np.ndarray[tuple[int], np.dtype[np.bool_]]":
    """(N,) whether the segments from start (1, 3) to ends (N, 3) pass through a box about the origin (slab test)."""
    along = ends - start
    with np.errstate(divide="ignore", invalid="ignore"):
        one, two = (-half - start) / along, (half - start) / along
    near, far = np.minimum(one, two), np.maximum(one, two)
    parallel = along == 0
    inside = np.abs(np.broadcast_to(start, along.shape)) <= half
    near = np.where(parallel, np.where(inside, -np.inf, np.inf), near).max(axis=1)
    far = np.where(parallel, np.where(inside, np.inf, -np.inf), far).min(axis=1)
    return np.asarray((near <= far) & (far >= 0) & (near <= 1))

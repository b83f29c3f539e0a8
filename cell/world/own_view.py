"""Does the scanner's housing stand in its own view? A mount or housing pose that is off by a sign does."""

import numpy as np

from cell.world.world import World
from planner.values import Floats

_GRID = 33  # rays per axis of the field of view, its edges included: 2 deg apart at 60 deg
_SKIN = 1e-6  # m; a housing whose front face lies in the source's plane is not in the way
_LEG_ENDS = 1.0  # m; where the sensor's lines of sight are taken to end: nearer ends lie inside the same fan


def hidden_share(world: World) -> float:
    """Share of the field of view, from source and sensor, that the housing hides.

    Args:
        world: the compiled scene.
    """
    half = np.tan(np.radians(world.scene.scanner.opening_deg) / 2)
    x, y = np.meshgrid(*(np.linspace(-side, side, _GRID) for side in half))
    ends = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3) * _LEG_ENDS
    T_housing_scanner = np.linalg.inv(world.T_flange_housing) @ world.T_flange_scanner
    box = np.array(world.scene.housing.size_mm) / 2000 - _SKIN
    hidden = np.zeros(len(ends), dtype=bool)
    for start in (np.zeros(3), np.array([world.baseline, 0.0, 0.0])):
        hidden |= _hits(_moved(T_housing_scanner, start[None]), _moved(T_housing_scanner, ends), box)
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

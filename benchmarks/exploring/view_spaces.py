"""View spaces of rivals, which use only the cylinder of the part; each rival is tuned over these four."""

from collections.abc import Callable

import numpy as np

from benchmarks.exploring.lab import CLEARANCE, Lab
from planner.values import Floats
from planner.viewpoints.viewpoints import aim_viewpoints

_GOLDEN = np.pi * (3 - np.sqrt(5))


def _sphere(lab: Lab, count: int, radius: float) -> Floats:
    """Return (count, 4, 4) poses on a sphere about the middle of the cylinder, facing it: a Fibonacci lattice."""
    z, turn = 1 - (2 * np.arange(count) + 1) / count, _GOLDEN * np.arange(count)
    level = np.sqrt(1 - z**2)
    out = np.column_stack([level * np.cos(turn), level * np.sin(turn), z])
    return _looking(np.zeros((count, 3)), out, radius)


def _cylinder(lab: Lab, count: int, standoff: float) -> Floats:
    """Return (count, 4, 4) poses at a standoff from the surface of the cylinder, facing it, evenly by area."""
    radius, height = lab.cylinder.radius, lab.cylinder.height
    side = round(count * height / (height + radius))
    top = (count - side + 1) // 2
    targets, outs = [], []
    for sign, n in ((1, top), (-1, count - side - top)):
        r, turn = radius * np.sqrt((np.arange(n) + 0.5) / max(n, 1)), _GOLDEN * np.arange(n)
        targets.append(np.column_stack([r * np.cos(turn), r * np.sin(turn), np.full(n, sign * height / 2)]))
        outs.append(np.tile([0.0, 0.0, sign], (n, 1)))
    turn, z = _GOLDEN * np.arange(side), height * ((np.arange(side) + 0.5) / max(side, 1) - 0.5)
    out = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(side)])
    return _looking(
        np.concatenate([*targets, radius * out + z[:, None] * [0, 0, 1]]), np.concatenate([*outs, out]), standoff
    )


def _looking(targets: Floats, outward: Floats, distance: float) -> Floats:
    return aim_viewpoints(targets, outward, np.full(len(targets), -1), [distance], [0.0]).T_object_scanner[:, 0]


def _enclosing(lab: Lab) -> float:
    return float(np.hypot(lab.cylinder.radius, lab.cylinder.height / 2))


VIEW_SPACES: dict[str, Callable[[Lab, int], Floats]] = {
    "sphere, far": lambda lab, n: _sphere(lab, n, _enclosing(lab) + lab.frustum.near),
    "sphere, middle": lambda lab, n: _sphere(lab, n, max(lab.middle_range, _enclosing(lab) + 2 * CLEARANCE)),
    "cylinder, middle": lambda lab, n: _cylinder(lab, n, lab.middle_range),
    "cylinder, near": lambda lab, n: _cylinder(lab, n, max(lab.frustum.near, 2 * CLEARANCE)),
}
"""Name -> (lab, count) -> (count, 4, 4) poses."""

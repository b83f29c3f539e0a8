"""A home for an arm whose file gives none: the flange down before it at half its reach, nothing near anything."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from cell.robot import model as robot
from cell.robot.arm import kinematics_of
from cell.world.own_pairs import OwnPairs
from planner.values import Floats

if TYPE_CHECKING:
    import mujoco

_TOOL = "tool of a home"
_TILTS = (0.0, 0.6, 1.2)  # of the way ahead for one down, where looking straight down is not free
_HEIGHTS, _SHARES = (0.65, 0.5, 0.35, 0.8, 0.2), (0.5, 0.6, 0.4)  # of the reach: where a home is looked for


def found_home(own: OwnPairs, keeps: Mapping[tuple[str, str], float], down: Floats) -> Floats | None:
    """(6,) joint angles at which the flange looks down before the arm at half its reach [rad]; None: none was found.

    Where the scanner would touch the arm then, it looks down and ahead.

    Of the solutions the one whose elbow is highest, then the one that turns least.

    Args:
        own: the arm.
        keeps: pairs that are nearer by their build, and what they keep [m].
        down: (3,) where the flange is to look, base frame.
    """
    kinematics = kinematics_of(own.model)
    limits = kinematics.limits
    reach = float(np.linalg.norm(kinematics.forward(own.q[:2000])[:, :3, 3], axis=1).max())
    level = down * (1.0, 1.0, 0.0)
    ahead = np.array([1.0, 0.0, 0.0]) if np.linalg.norm(level) < 0.5 else level / np.linalg.norm(level)
    for tilt, share, height in itertools.product(_TILTS, _SHARES, _HEIGHTS):
        looks = down + tilt * ahead
        poses = _looking(looks / np.linalg.norm(looks), reach * (share * ahead + np.array([0.0, 0.0, height])))
        q = kinematics.inverse(poses).reshape(-1, 6)
        q = q[((q >= limits.lower) & (q <= limits.upper)).all(axis=1)]  # NaN is neither
        free = [angles for angles in q if own.apart(angles, keeps)]
        if free:
            return min(free, key=lambda angles: (-round(own.elbow(angles, -down), 6), float(np.abs(angles).sum())))
    return None


def with_tool(spec: mujoco.MjSpec) -> OwnPairs:
    """The arm with the largest built-in scanner on its flange."""
    import mujoco

    copy = spec.copy()
    flange = spec.copy().compile().site(robot.FLANGE)
    tool = copy.body("link_6").add_body(name=_TOOL, pos=flange.pos, quat=flange.quat)
    tool.add_geom(type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[0.039, 0.03, 0.0], pos=[0.0, 0.0, 0.03])
    tool.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.08, 0.04, 0.03], pos=[0.0375, 0.0, 0.09])
    for link in ("link_5", "link_6"):
        copy.add_exclude(name=f"{_TOOL}_{link}", bodyname1=_TOOL, bodyname2=link)
    return OwnPairs(copy.compile())


def _looking(z: Floats, origin: Floats) -> Floats:
    """(4, 4, 4) poses at an origin [m] that look along z, turned about it by quarter turns."""
    x = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = x - z * (x @ z)
    x /= np.linalg.norm(x)
    poses = np.tile(np.eye(4), (4, 1, 1))
    for turn in range(4):
        poses[turn, :3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
        x = np.cross(z, x)
    poses[:, :3, 3] = origin
    return poses

"""The part turned about its centre: where a second set-up would hold it."""

from collections.abc import Iterator

import numpy as np

from cell.errors import SceneError
from cell.world.model import World
from planner.kinematics.frames import kuka_abc_from_pose, pose_from_kuka_abc
from planner.values import Floats

TURNS = ((2, 180.0), (2, 90.0), (2, -90.0), (0, 180.0))  # axis of the base frame, degrees


def turned(world: World) -> Iterator[tuple[str, float, Floats, World]]:
    """Each turn in words, its size [deg] (upside down is more than any other), the centre's pose (4, 4) [m], the cell.

    Left out is what a rotary table does itself, and what it cannot carry.
    """
    for axis, angle in TURNS:
        turn = np.zeros(3)
        turn[2 - axis] = np.radians(angle)  # KUKA's angles are about z, y, x
        T = np.array(world.T_base_object @ world.T_object_centre)
        T[:3, :3] = pose_from_kuka_abc(np.zeros(3), turn)[:3, :3] @ T[:3, :3]
        how = "turned upside down" if axis != 2 else f"turned by {angle:g} deg about the vertical"
        if axis == 2 and world.table is not None and world.table.upright:
            continue
        if (there := carried(world, T)) is not None:
            yield f"a second set-up with the part {how}", abs(angle) + 360 * (axis != 2), T, there


def carried(world: World, T_base_centre: Floats) -> World | None:
    """The cell with the part's centre at a pose (4, 4) [m]; None where a rotary table cannot carry it there."""
    try:
        return world.with_placement(T_base_centre)
    except SceneError:
        return None


def place_of(T_base_centre: Floats) -> str:
    """What `--place` takes for a pose (4, 4) of the part's centre [m]."""
    position, abc = kuka_abc_from_pose(T_base_centre)
    return ",".join(f"{value + 0.0:g}" for value in [*(position * 1000).round(3), *(np.degrees(abc).round(3))])

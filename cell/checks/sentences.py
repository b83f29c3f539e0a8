"""How a mistake of a scene is said: both partners, how deep, and the smallest move that cures it, ready to be typed."""

import numpy as np

from cell.checks.solid import Solid, way_out
from cell.checks.standing import OWN, arm
from cell.world.model import World
from cell.world.shapes import TABLE
from planner.values import Floats

_ROUNDING = 0.02  # of a tenth of a millimetre: what a sum of coordinates is off is no reason to go a tenth farther


def called(world: World, name: str) -> str:
    """A piece of the cell as a sentence names it."""
    if name in arm(world):
        return f"the {name}" if name in ("housing", "bracket") else f"the robot's {name}"
    return f"the {name}" if name in ("part", TABLE, *OWN) else f"the fixture '{name}'"


def move(world: World, name: str, way: Floats) -> str:
    """What to type so that part, post or a fixture goes a way (3,) [m], base frame."""
    length = float(np.linalg.norm(way))
    tenths = np.ceil(length * 1e4 - _ROUNDING) / 1e4
    way = way * (tenths / length) if length > 0 else way
    if name in ("part", "post"):
        return moved("placement.position_mm", (world.T_base_object @ world.T_object_centre)[:3, 3], way)
    if name == TABLE and world.table is not None:
        return moved("table.position_mm", world.table.T_base_table[:3, 3], way)
    fixtures = world.scene.fixtures
    index = [fixture.name for fixture in fixtures].index(name)
    if fixtures[index].attached_to == "object":
        way = world.T_base_object[:3, :3].T @ way
    return moved(f"fixtures[{index}].position_mm", fixtures[index].T[:3, 3], way)


def moved(key: str, now: Floats, way: Floats) -> str:
    """A key of the scene file that holds a position (3,) [m], and what it becomes."""
    step = np.round(1000 * way, 2) + 0.0  # + 0.0 turns -0 into 0
    return f"move {key} by {_triple(step)} mm, to {_triple(np.round(1000 * now, 3) + step)}"


def stands_inside(world: World, one: Solid, other: Solid, *, way: Floats | None = None, at_home: bool = False) -> str:
    """A sentence about something that can be moved and stands inside something else.

    Args:
        world: that both are of.
        one: part, post or a fixture.
        other: anything.
        way: (3,) the way out where it is not that out of `other` alone [m].
        at_home: whether the other is there because the robot is at home.
    """
    out = way_out(one, other)
    depth = 1000 * float(np.linalg.norm(out))
    cure = move(world, one.name, out if way is None else way)
    also, place = (" or change robot.home_deg", " at home") if at_home else ("", "")
    return (
        f"{called(world, one.name)} stands inside {called(world, other.name)}{place}, {depth:.1f} mm deep; {cure}{also}"
    )


def _triple(values: Floats) -> str:
    return f"({', '.join(f'{value:.7g}' for value in np.round(values, 3) + 0.0)})"

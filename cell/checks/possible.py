"""Scenes that cannot be: a part in a table or in the robot, a fixture in the arm's way at home, a blind scanner.

What is looked at here is what stands still (`cell.world.collision` guards what moves): the robot at its home pose, the
part at one placement, true triangles of both, and the scanner's own body. What stands less than
`cell.checks.solid.FLUSH` deep in each other touches.
"""

from typing import TYPE_CHECKING

import numpy as np

from cell.checks.own_view import own_view
from cell.checks.sentences import called, move, moved, stands_inside
from cell.checks.solid import Solid, inside, way_out
from cell.checks.standing import arm, robot, standing
from cell.errors import SceneError
from cell.robot.model import AXES
from cell.world import shapes as cell_shapes
from cell.world.collision import MujocoCollisionChecker
from cell.world.model import World
from planner.path import indexed
from planner.ports import ARM_AXES

if TYPE_CHECKING:
    import mujoco

_STILL = ("base", "pedestal")  # what part and post stand beside without moving


def require_possible(world: World) -> None:
    """Refuse a scene that cannot be.

    Raises:
        SceneError: with every problem on a line of its own.
    """
    problems = impossible(world)
    if problems:
        raise SceneError("\n  ".join([problems[0]] if len(problems) == 1 else ["the scene cannot be:", *problems]))


def impossible(world: World) -> list[str]:
    """What is wrong with a compiled scene, one sentence each; empty for a scene that can be."""
    solids = standing(world)
    return [
        *_home_outside_limits(world),
        *own_view(world),
        *_in_its_own_wrist(world, solids),
        *_part_out_of_room(world),
        *_in_what_stands(world, solids),
        *_in_the_robot(world, solids),
        *_robot_too_near(world),
        *_home_in_the_swing(world),
    ]


def _home_outside_limits(world: World) -> list[str]:
    lower, upper = np.rad2deg(world.limits.lower), np.rad2deg(world.limits.upper)
    return [
        f"robot.home_deg has {axis} at {angle:g} deg; it must be from {low:g} to {high:g}"
        for axis, angle, low, high in zip(
            AXES, world.scene.robot.settled_home_deg, lower.round(6), upper.round(6), strict=False
        )
        if not low - 1e-9 <= angle <= high + 1e-9
    ]


def _in_its_own_wrist(world: World, solids: dict[str, Solid]) -> list[str]:
    """The housing and the flange that it is bolted to are one rigid piece, which no motion guards."""
    flange, last = world.data().site("flange"), solids["link_6"]
    R = flange.xmat.reshape(3, 3)
    in_flange = (last.vertices - flange.xpos) @ R
    in_flange[:, 2] = np.minimum(in_flange[:, 2], 0.0)  # its enclosing shape stands a little above the face
    last = Solid(last.name, in_flange @ R.T + flange.xpos, last.faces, R.T)
    if not inside(solids["housing"], last):
        return []
    way = way_out(solids["housing"], last)
    return [
        f"the housing stands inside the robot's link_6, to which it is bolted, {1000 * np.linalg.norm(way):.1f} mm "
        f"deep; {moved('mount.position_mm', world.T_flange_scanner[:3, 3], R.T @ way)}"
    ]


def _part_out_of_room(world: World) -> list[str]:
    T, problems = world.T_base_object, []
    lowest = float((world.part_hull.vertices @ T[2, :3]).min() + T[2, 3])
    if (depth := world.floor - lowest) > 1e-6:
        problems.append(
            f"the part reaches {1000 * depth:.1f} mm below the floor, which is at z = {1000 * world.floor:g} mm; "
            f"{move(world, 'part', np.array([0.0, 0.0, depth]))}"
        )
    if world.table is None and world.scene.post.enabled and lowest - world.floor > cell_shapes.POST_LENGTH:
        problems.append(
            f"the part stands {lowest - world.floor:.1f} m above the floor; a post is at most "
            f"{cell_shapes.POST_LENGTH:g} m long: lower placement.position_mm, or set post.enabled = false"
        )
    return problems


def _in_what_stands(world: World, solids: dict[str, Solid]) -> list[str]:
    """The part in a fixture; part, post and fixtures in what does not move. A table may be bolted to the pedestal."""
    fixtures = [fixture.name for fixture in world.scene.fixtures]
    fixtures += [] if world.table is None else [cell_shapes.TABLE]
    pairs = [("part", name) for name in (*fixtures, *_STILL)]
    pairs += [("post", name) for name in _STILL] + [(name, "base") for name in fixtures]
    problems: list[str] = []
    on_part = {fixture.name for fixture in world.scene.fixtures if fixture.attached_to == "object"}
    held = set()  # what the part stands in: its post does too, and goes with it
    for one, other in pairs:
        if one == "post" and other in held:
            continue
        if one in solids and other in solids and inside(solids[one], solids[other]):
            held |= {other} if one == "part" else set()
            mover = other if one == "part" and other in on_part else one
            problems.append(stands_inside(world, solids[mover], solids[one if mover == other else other]))
    return problems


def _in_the_robot(world: World, solids: dict[str, Solid]) -> list[str]:
    """Part, post and fixtures nearer than the clearance to the arm and the scanner at home."""
    data, geoms = world.data(), _geoms(world)
    moving = [name for name in arm(world) if name in geoms and name != "base"]
    problems = []
    for name in ("part", "post", cell_shapes.TABLE, *(fixture.name for fixture in world.scene.fixtures)):
        gaps = {piece: _gap(world, data, geoms, piece, name) for piece in reversed(moving)} if name in solids else {}
        piece = min(gaps, key=lambda each: gaps[each], default="")
        if not piece or gaps[piece] >= world.clearance - 1e-9:
            continue
        whole = robot(world, solids)
        way = way_out(solids[name], whole, world.clearance)
        if gaps[piece] < 0 or inside(solids[name], solids[piece]):
            problems.append(stands_inside(world, solids[name], solids[piece], way=way, at_home=True))
        else:
            problems.append(
                f"{called(world, name)} is {1000 * gaps[piece]:.1f} mm from {called(world, piece)} at home, nearer "
                f"than the clearance of {1000 * world.clearance:g} mm; "
                f"{move(world, name, way)} or change robot.home_deg"
            )
    return problems


def _robot_too_near(world: World) -> list[str]:
    """The robot at home nearer than the clearance to itself, the pedestal or the floor."""
    data, geoms = world.data(), _geoms(world)
    own = {*arm(world), "pedestal", "floor"}
    guarded = {tuple(sorted((world.entities[a], world.entities[b]))) for a, b in world.pairs}
    problems = []
    for one, other in sorted(guarded):
        distance = _gap(world, data, geoms, one, other) if {one, other} <= own else np.inf
        if distance < world.clearance - 1e-9:
            name = world.pair_name(geoms[one][0], geoms[other][0])
            where = "the cell" if {one, other} & {"pedestal", "floor"} else "itself"
            apart = (
                f"{-1000 * distance:.1f} mm deep in each other" if distance < 0 else f"{1000 * distance:.1f} mm apart"
            )
            problems.append(
                f"at home the robot is too near to {where}: {name}, {apart}, clearance "
                f"{1000 * world.clearance:g} mm; change robot.home_deg, mount or housing"
            )
    return problems


def _home_in_the_swing(world: World) -> list[str]:
    """The arm at home in the way of what an indexed table turns, which waits for it there."""
    if world.limits.turns_at is None:
        return []
    checker, angles = MujocoCollisionChecker(world), np.repeat(world.home[None], 361, axis=0)
    angles[:, ARM_AXES] = np.linspace(world.limits.lower[ARM_AXES], world.limits.upper[ARM_AXES], 361)
    free = checker.free(angles)
    if not free[np.argmin(np.abs(angles[:, ARM_AXES]))] or indexed.clear(world.home, checker, world.limits)[0]:
        return []
    at = angles[int(np.argmin(free))]
    near = next(iter(checker.contacts(at)), "")
    return [
        f"an indexed table turns while the arm is at home, where {near or 'the arm'} comes nearer than the clearance"
        + ("" if free.all() else f" at {np.degrees(at[ARM_AXES]):.0f} deg")
        + '; change robot.home_deg, or set table.moves = "synchronised"'
    ]


def _geoms(world: World) -> dict[str, list[int]]:
    """Ids of the shapes of each piece of the cell."""
    found: dict[str, list[int]] = {}
    for geom, name in enumerate(world.entities):
        found.setdefault(name, []).append(geom)
    return found


def _gap(world: World, data: "mujoco.MjData", geoms: dict[str, list[int]], one: str, other: str) -> float:
    """Distance of two pieces as planning sees it [m], no more than a hair above the clearance."""
    reach = world.clearance + 1e-3
    return min(world.distance(data, a, b, reach) for a in geoms[one] for b in geoms[other])

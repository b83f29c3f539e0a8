"""Scenes that cannot be: a part inside the robot or the floor, a fixture in the arm's way at home, a blind scanner.

What is looked at here is what stands still (`cell.world.collision` guards what moves): the robot at its home pose, the
part at one placement, and the housing, which a mount that is off by a sign puts into the scanner's own view.
"""

import numpy as np

from cell.errors import SceneError
from cell.robot.model import AXES, LINKS
from cell.world import shapes as cell_shapes
from cell.world.model import World
from planner.values import Floats

_TOUCHING = 1e-6  # m; two shapes that share a face by construction are this deep in each other by rounding
_MOUNTED = ("base", "pedestal", "floor")
_GRID = 33  # rays per axis of the field of view, its edges included: 2 deg apart at 60 deg
_SKIN = 1e-6  # m; a housing whose front face lies in the source's plane is not in the way
_LEG_ENDS = 1.0  # m; where the sensor's lines of sight are taken to end: nearer ends lie inside the same fan


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
    problems = _home_outside_limits(world)
    if share := hidden_share(world):
        problems.append(
            f"the housing hides {100 * share:.0f} % of the scanner's own field of view; its front must lie behind "
            "source and sensor: change housing.position_mm, housing.size_mm or the mount"
        )
    return [*problems, *_part_out_of_room(world), *_in_each_other(world)]


def _home_outside_limits(world: World) -> list[str]:
    lower, upper = np.rad2deg(world.limits.lower), np.rad2deg(world.limits.upper)
    return [
        f"robot.home_deg has {axis} at {angle:g} deg; it must be from {low:g} to {high:g}"
        for axis, angle, low, high in zip(AXES, world.scene.robot.home_deg, lower.round(6), upper.round(6), strict=True)
        if not low - 1e-9 <= angle <= high + 1e-9
    ]


def _part_out_of_room(world: World) -> list[str]:
    top = world.post_top(world.T_base_object)
    centre_z = (world.T_base_object @ world.T_object_centre)[2, 3]
    problems = []
    if top[2] < world.floor - _TOUCHING:
        depth = 1000 * (world.floor - top[2])
        problems.append(
            f"the part reaches {depth:.0f} mm below the floor, which is at z = {1000 * world.floor:g} mm; "
            f"raise placement.position_mm (its centre is at z = {1000 * centre_z:g} mm)"
        )
    if world.scene.post.enabled and top[2] - world.floor > cell_shapes.POST_LENGTH:
        problems.append(
            f"the part stands {top[2] - world.floor:.1f} m above the floor; a post is at most "
            f"{cell_shapes.POST_LENGTH:g} m long: lower placement.position_mm, or set post.enabled = false"
        )
    return problems


def _in_each_other(world: World) -> list[str]:
    """Overlaps of what stands still, and the robot at home nearer to anything than the clearance."""
    data = world.data()
    movable = {"part", "post"} | {f.name for f in world.scene.fixtures if f.attached_to == "object"}
    obstacles = movable | {fixture.name for fixture in world.scene.fixtures}
    ids: dict[str, list[int]] = {}
    for geom, entity in enumerate(world.entities):
        ids.setdefault(entity, []).append(geom)

    def gap(one: str, other: str) -> float:
        reach = world.clearance + 1e-3
        return min(world.distance(data, a, b, reach) for a in ids[one] for b in ids.get(other, []))

    problems = []
    arm = [name for name in ("housing", "bracket", *reversed(LINKS)) if name in ids]
    for obstacle in [name for name in ids if name in obstacles]:
        # Only what is placed with the part must stay out of the pedestal: a table may be bolted to it.
        mounted = ["pedestal"] if obstacle in ("part", "post") and "pedestal" in ids else []
        hits = [(gap(piece, obstacle), piece) for piece in [*arm, *mounted]]
        hits = [(d, piece) for d, piece in hits if d < (-_TOUCHING if piece in _MOUNTED else world.clearance - 1e-9)]
        if hits:
            problems.append(_sentence(world, *min(hits), obstacle))
    standing = obstacles | set(_MOUNTED[1:])
    guarded = {tuple(sorted((world.entities[a], world.entities[b]))) for a, b in world.pairs}
    for one, other in sorted(guarded):
        if {one, other} & obstacles:
            continue
        distance = gap(one, other)
        if distance < world.clearance - 1e-9:
            name = world.pair_name(ids[one][0], ids[other][0])
            where = "the cell" if {one, other} & standing else "itself"
            problems.append(
                f"at home the robot is too near to {where}: {name}, {_apart(distance)}, clearance "
                f"{1000 * world.clearance:g} mm; change robot.home_deg, mount or housing"
            )
    return problems


def _sentence(world: World, distance: float, piece: str, obstacle: str) -> str:
    scene = world.scene
    robot_piece = piece if piece in ("pedestal", "housing", "bracket") else f"robot's {piece}"
    place = ", ".join(f"{1000 * v:g}" for v in (world.T_base_object @ world.T_object_centre)[:3, 3].round(6))
    if obstacle in ("part", "post"):
        cure = f"move placement.position_mm (now {place})"
    else:
        index = [fixture.name for fixture in scene.fixtures].index(obstacle)
        cure = f"move fixtures[{index}].position_mm"
        if scene.fixtures[index].attached_to == "object":
            cure += f" or placement.position_mm (now {place})"
    at_home = "" if piece in _MOUNTED else " at home"
    subject = f"the {obstacle}" if obstacle in ("part", "post") else f"the fixture '{obstacle}'"
    fact = (
        f"stands inside the {robot_piece}{at_home}"
        if distance < 0
        else f"is {_apart(distance)} the {robot_piece}{at_home}"
    )
    limit = "" if distance < 0 else f", nearer than the clearance of {1000 * world.clearance:g} mm"
    also = " or change robot.home_deg" if at_home else ""
    return f"{subject} {fact}{limit}; {cure}{also}"


def _apart(distance: float) -> str:
    return "in each other" if distance < 0 else f"{1000 * distance:.1f} mm from"


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

"""How a mistake of a scene is said: both partners, how deep, and the smallest move that cures it, ready to be typed.

What the scanner's own body hides of its field of view: a mount or housing that is off by a sign does.

Scenes that cannot be: a part in a table or in the robot, a fixture in the arm's way at home, a blind scanner.

What is looked at here is what stands still (`cell.world.collision` guards what moves): the robot at its home pose, the
part at one placement, true triangles of both, and the scanner's own body. What stands less than
`cell.world.solids.FLUSH` deep in each other touches.

Scenes that can be and are hardly meant: fixtures in each other, things in the air or about to tip, lost units.

Something is carried where a chain of things that touch leads to the floor or the pedestal; the part on its post is.
Something rests where all that carries it touches it from below; it then has to have its centre of mass (of even
density; of its surface where that is open) above what it rests on. Contact is looked for by vertical rays.

`cell check`: compile a scene and say what stands where, what touches at home, how far it reaches, what is wrong.
"""

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cell.errors import SceneError
from cell.part import workpiece
from cell.part.workpiece import size_findings
from cell.robot.arm import wrist_in_flange, wrist_positions
from cell.robot.model import AXES, model_warnings
from cell.scene.model import MeshFixture, Scene
from cell.scene.regions import region_areas, with_regions
from cell.scene.settle import SettledScene, settle
from cell.words import listed
from cell.world import shapes as cell_shapes
from cell.world.collision import DISTANCE_CAP, MujocoCollisionChecker
from cell.world.embree import EmbreeRayCaster
from cell.world.model import World, compile_settled
from cell.world.occluders import Occluder, floor_triangles, geom_triangles, make_caster
from cell.world.shapes import TABLE
from cell.world.solids import (
    BUILT_IN_OBSTACLES,
    Solid,
    cell_solids,
    minimum_translation,
    penetrates,
    robot_bodies,
    robot_solid,
    touches,
)
from planner.geometry.mesh import concatenate_meshes
from planner.path import indexed
from planner.ports import ARM_AXES
from planner.values import Floats

if TYPE_CHECKING:
    import mujoco


_ROUNDING = 0.02  # of a tenth of a millimetre: what a sum of coordinates is off is no reason to go a tenth farther


def named(world: World, name: str) -> str:
    """A piece of the cell as a sentence names it."""
    if name in robot_bodies(world):
        return f"the {name}" if name in ("housing", "bracket") else f"the robot's {name}"
    return f"the {name}" if name in ("part", TABLE, *BUILT_IN_OBSTACLES) else f"the fixture '{name}'"


def move_object(world: World, name: str, way: Floats) -> str:
    """What to type so that part, post or a fixture goes a way (3,) [m], base frame."""
    length = float(np.linalg.norm(way))
    tenths = np.ceil(length * 1e4 - _ROUNDING) / 1e4
    way = way * (tenths / length) if length > 0 else way
    if name in ("part", "post"):
        return move_key("placement.position_mm", (world.T_base_object @ world.T_object_centre)[:3, 3], way)
    if name == TABLE and world.table is not None:
        return move_key("table.position_mm", world.table.T_base_table[:3, 3], way)
    fixtures = world.scene.fixtures
    index = [fixture.name for fixture in fixtures].index(name)
    if fixtures[index].attached_to == "object":
        way = world.T_base_object[:3, :3].T @ way
    return move_key(f"fixtures[{index}].position_mm", fixtures[index].T[:3, 3], way)


def move_key(key: str, now: Floats, way: Floats) -> str:
    """A key of the scene file that holds a position (3,) [m], and what it becomes."""
    step = np.round(1000 * way, 2) + 0.0  # + 0.0 turns -0 into 0
    return f"move {key} by {_triple(step)} mm, to {_triple(np.round(1000 * now, 3) + step)}"


def penetration_message(
    world: World, one: Solid, other: Solid, *, way: Floats | None = None, at_home: bool = False
) -> str:
    """A sentence about something that can be moved and stands inside something else.

    Args:
        world: that both are of.
        one: part, post or a fixture.
        other: anything.
        way: (3,) the way out where it is not that out of `other` alone [m].
        at_home: whether the other is there because the robot is at home.
    """
    out = minimum_translation(one, other)
    depth = 1000 * float(np.linalg.norm(out))
    cure = move_object(world, one.name, out if way is None else way)
    also, place = (" or change robot.home_deg", " at home") if at_home else ("", "")
    return (
        f"{named(world, one.name)} stands inside {named(world, other.name)}{place}, {depth:.1f} mm deep; {cure}{also}"
    )


def _triple(values: Floats) -> str:
    return f"({', '.join(f'{value:.7g}' for value in np.round(values, 3) + 0.0)})"


_FIELD_GRID = 33  # rays per axis of the field of view, its edges included: 2 deg apart at 60 deg
_SKIN = 1e-6  # m; a housing whose front face lies in the source's plane is not in the way
_LEG_ENDS = 1.0  # m; where the sensor's lines of sight are taken to end: nearer ends lie inside the same fan
_BEHIND = ("link_6", "bracket")  # what the housing is bolted to
_STEPS, _HALVINGS = 24, 12


def field_of_view_problems(world: World) -> list[str]:
    """What hides a part of the scanner's own field of view, one sentence each."""
    problems = []
    if share := hidden_share(world):
        problems.append(
            f"the housing hides {100 * share:.0f} % of the scanner's own field of view; its front must lie behind "
            f"source and sensor: {move_key('housing.position_mm', _housing(world)[:3, 3], _way_out(world))}, or "
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
    x, y = np.meshgrid(*(np.linspace(-side, side, _FIELD_GRID) for side in half))
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
            vertices, faces = geom_triangles(world.model, data, geom)
            found.append(Occluder(name, (vertices - origin) @ R, faces))
    if not found or max(each.vertices[:, 2].max() for each in found) <= _SKIN:
        return 0.0  # all of it is behind source and sensor
    caster = make_caster(found)
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


_STILL = ("base", "pedestal")  # what part and post stand beside without moving


def require_feasible(world: World) -> None:
    """Refuse a scene that cannot be.

    Raises:
        SceneError: with every problem on a line of its own.
    """
    problems = find_problems(world)
    if problems:
        raise SceneError("\n  ".join([problems[0]] if len(problems) == 1 else ["the scene cannot be:", *problems]))


def find_problems(world: World) -> list[str]:
    """What is wrong with a compiled scene, one sentence each; empty for a scene that can be."""
    solids = cell_solids(world)
    return [
        *_home_outside_limits(world),
        *field_of_view_problems(world),
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
    if not penetrates(solids["housing"], last):
        return []
    way = minimum_translation(solids["housing"], last)
    return [
        f"the housing stands inside the robot's link_6, to which it is bolted, {1000 * np.linalg.norm(way):.1f} mm "
        f"deep; {move_key('mount.position_mm', world.T_flange_scanner[:3, 3], R.T @ way)}"
    ]


def _part_out_of_room(world: World) -> list[str]:
    T, problems = world.T_base_object, []
    lowest = float((world.part_hull.vertices @ T[2, :3]).min() + T[2, 3])
    if (depth := world.floor - lowest) > 1e-6:
        problems.append(
            f"the part reaches {1000 * depth:.1f} mm below the floor, which is at z = {1000 * world.floor:g} mm; "
            f"{move_object(world, 'part', np.array([0.0, 0.0, depth]))}"
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
        if one in solids and other in solids and penetrates(solids[one], solids[other]):
            held |= {other} if one == "part" else set()
            mover = other if one == "part" and other in on_part else one
            problems.append(penetration_message(world, solids[mover], solids[one if mover == other else other]))
    return problems


def _in_the_robot(world: World, solids: dict[str, Solid]) -> list[str]:
    """Part, post and fixtures nearer than the clearance to the arm and the scanner at home."""
    data, geoms = world.data(), _geoms(world)
    moving = [name for name in robot_bodies(world) if name in geoms and name != "base"]
    problems = []
    for name in ("part", "post", cell_shapes.TABLE, *(fixture.name for fixture in world.scene.fixtures)):
        gaps = {piece: _gap(world, data, geoms, piece, name) for piece in reversed(moving)} if name in solids else {}
        piece = min(gaps, key=lambda each: gaps[each], default="")
        if not piece or gaps[piece] >= world.clearance - 1e-9:
            continue
        whole = robot_solid(world, solids)
        way = minimum_translation(solids[name], whole, world.clearance)
        if gaps[piece] < 0 or penetrates(solids[name], solids[piece]):
            problems.append(penetration_message(world, solids[name], solids[piece], way=way, at_home=True))
        else:
            problems.append(
                f"{named(world, name)} is {1000 * gaps[piece]:.1f} mm from {named(world, piece)} at home, nearer "
                f"than the clearance of {1000 * world.clearance:g} mm; "
                f"{move_object(world, name, way)} or change robot.home_deg"
            )
    return problems


def _robot_too_near(world: World) -> list[str]:
    """The robot at home nearer than the clearance to itself, the pedestal or the floor."""
    data, geoms = world.data(), _geoms(world)
    own = {*robot_bodies(world), "pedestal", "floor"}
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
    if world.limits.table_turn_q is None:
        return []
    checker, angles = MujocoCollisionChecker(world), np.repeat(world.home[None], 361, axis=0)
    angles[:, ARM_AXES] = np.linspace(world.limits.lower[ARM_AXES], world.limits.upper[ARM_AXES], 361)
    free = checker.free(angles)
    if not free[np.argmin(np.abs(angles[:, ARM_AXES]))] or indexed.may_turn(world.home, checker, world.limits)[0]:
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


CONTACT_DISTANCE = 1e-3
"""What comes nearer than this stands on each other [m]: a plan of a cell is hardly more precise."""

_GRID = 64  # vertical rays across the longer side of something ...
_FINE = 512  # ... where a length is told


def find_warnings(world: World) -> list[str]:
    """What is hardly meant in a compiled scene, one sentence each."""
    fixtures, of_arm = world.scene.fixtures, model_warnings(world.spec)
    of_arm += _stopped_table(world)
    if not fixtures and world.scene.post.enabled:
        return of_arm
    solids = {name: solid for name, solid in cell_solids(world).items() if name not in robot_bodies(world)}
    said = [
        finding.sentence
        for fixture in fixtures
        if isinstance(fixture, MeshFixture)
        for finding in size_findings(np.ptp(world.fixture_meshes[fixture.name].vertices, axis=0), fixture.units,
                                     named(world, fixture.name))
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
            if other in solids and penetrates(solids[name], solids[other]):
                said.append(penetration_message(world, solids[name], solids[other]))
        if "post" in solids and penetrates(solids["post"], solids[name]):
            said.append(
                f"the post goes through {named(world, name)}; set post.enabled = false where that carries the part"
            )
        if (depth := world.floor - float(solids[name].low[2])) > CONTACT_DISTANCE:
            said.append(
                f"{named(world, name)} reaches {1000 * depth:.1f} mm below the floor; "
                f"{move_object(world, name, np.array([0.0, 0.0, depth]))}"
            )
    return said


def _standing_badly(world: World, solids: dict[str, Solid]) -> list[str]:
    """What nothing carries, and what tips."""
    beside = {
        name: {other for other in solids if other != name and touches(solids[name], solids[other], CONTACT_DISTANCE)}
        for name in solids
    }
    if "post" in solids:  # it holds the part, wherever that touches it
        beside["part"].add("post")
        beside["post"].add("part")
    ground = [name for name in solids if solids[name].low[2] <= world.floor + CONTACT_DISTANCE or name == "pedestal"]
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
                    f"the centre of mass of {named(world, name)} is {1000 * float(np.linalg.norm(way)):.1f} mm beside "
                    f"what it rests on ({', '.join(named(world, each) for each in sorted(rests.on)) or 'the floor'}); "
                    f"it tips unless it is fastened: {move_object(world, name, way)}"
                )
    return said


def _in_the_air(world: World, solids: dict[str, Solid], together: set[str]) -> str:
    """A sentence about things that touch each other and that nothing carries."""
    others = [solid for name, solid in solids.items() if name not in together]
    gaps = {name: _Rests(solids[name], others, world.floor, _FINE).gap() for name in solids if name in together}
    name = min(gaps, key=lambda each: gaps[each][0])
    gap, below = gaps[name]
    rest = [named(world, each) for each in solids if each in together and each != name]
    with_it = f" (with {', '.join(rest)})" if rest else ""
    return (
        f"nothing carries {named(world, name)}{with_it}: it hangs {1000 * gap:.1f} mm above {named(world, below)}; "
        f"{move_object(world, name, np.array([0.0, 0.0, -gap]))}"
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
        ground = Solid("floor", *floor_triangles(floor))
        vertices, faces, self._of_face = concatenate_meshes((each.vertices, each.faces) for each in (*others, ground))
        below = EmbreeRayCaster(vertices, faces)
        size = solid.high - solid.low
        self._step = float(max(size[:2].max(), 1e-6)) / grid
        sides = [np.arange(solid.low[axis] + self._step / 2, solid.high[axis], self._step) for axis in range(2)]
        x, y = np.meshgrid(*sides)
        under = _down(solid.caster, x.ravel(), y.ravel(), float(solid.low[2]) - self._step, up=True)[0]
        points = np.column_stack([x.ravel(), y.ravel(), under])
        feet = solid.vertices[np.unique(solid.faces)]
        points = np.concatenate([points[np.isfinite(under)], feet[feet[:, 2] <= solid.low[2] + CONTACT_DISTANCE]])
        start = points[:, 2] + CONTACT_DISTANCE
        height, face = _down(below, points[:, 0], points[:, 1], start)
        self._points, self._gaps = points, points[:, 2] - height
        self._below = np.where(face >= 0, self._of_face[face], len(self._names) - 1)

    @property
    def on(self) -> set[str]:
        """What it touches from above; the floor is not named."""
        return {self._names[k] for k in np.unique(self._below[self._gaps <= CONTACT_DISTANCE])} - {"floor"}

    def gap(self) -> tuple[float, str]:
        """How far it hangs above what is below it [m], and the name of that."""
        nearest = int(np.argmin(self._gaps))
        return float(self._gaps[nearest]), self._names[self._below[nearest]]

    def tips(self) -> Floats | None:
        """(3,) the shortest way [m] that brings the centre of mass above what it rests on; None where it is."""
        points = self._points[self._gaps <= CONTACT_DISTANCE][:, :2]
        if not len(points):
            return None
        way = _towards_hull(points, centre_of_mass(self._solid)[:2])
        return None if np.linalg.norm(way) <= self._step + CONTACT_DISTANCE else np.array([*way, 0.0])


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


Triple = tuple[float, float, float]

_FIDELITY = {"hull": "its convex hull (hull)", "exact": "its triangles (exact)"}

_GRID_DEG = 0.5  # of A2 and A3 in the envelope: the wrist's outline is then exact to 0.1 mm


@dataclass(frozen=True, slots=True)
class Envelope:
    """Where the wrist centre gets within the limits of A2 and A3, and how far the laser source stands from it [mm].

    Attributes:
        wrist_reach_mm: farthest from the A1 axis.
        wrist_lowest_mm: lowest height, base frame.
        wrist_highest_mm: greatest height, base frame.
        wrist_to_source_mm: from wrist centre to laser source, for every joint angle.
    """

    wrist_reach_mm: float
    wrist_lowest_mm: float
    wrist_highest_mm: float
    wrist_to_source_mm: float


@dataclass(frozen=True, slots=True)
class CheckResult:
    """What `cell check` found.

    Attributes:
        problems: what is wrong, one sentence each; empty for a scene that can be planned.
        warnings: what is hardly meant, one sentence each.
        findings: what the part's checks noted.
        part: its name.
        part_size_mm: sides of its bounding box.
        regions_mm2: area of each region that somebody cares for; none of a part without.
        placement_mm: its centre in the base frame.
        home_deg: A1..A6.
        contacts_at_home: pairs nearer than the clearance and their distance [mm], negative in contact, nearest first.
        nearest_at_home: the nearest guarded pair, "" beyond 300 mm.
        nearest_at_home_mm: its distance.
        joint_limits_deg: lowest and highest angle of each axis.
        envelope: how far the arm reaches.
        mount_mm: laser source in the flange frame.
        housing_size_mm: the scanner's box.
        housing_mm: its middle in the flange frame.
        bracket_length_mm: from flange to housing; 0: none.
        baseline_mm: from source to sensor.
        sensor: name of the device that the scanner is, None for a law of its own.
        range_mm: of a point's distance; None: the scanner has none.
        obstacles: names of everything that arm and tool keep clear of.
        clearance_mm: by how much.
        collision: what stands for the part: hull or exact.
        guarded_pairs: pairs of shapes that are looked at.
    """

    problems: tuple[str, ...]
    warnings: tuple[str, ...]
    findings: tuple[str, ...]
    part: str
    part_size_mm: Triple
    regions_mm2: dict[str, float]
    placement_mm: Triple
    home_deg: tuple[float, ...]
    contacts_at_home: tuple[tuple[str, float], ...]
    nearest_at_home: str
    nearest_at_home_mm: float
    joint_limits_deg: dict[str, tuple[float, float]]
    envelope: Envelope
    mount_mm: Triple
    housing_size_mm: Triple
    housing_mm: Triple
    bracket_length_mm: float
    baseline_mm: float
    sensor: str | None
    range_mm: tuple[float, float] | None
    obstacles: tuple[str, ...]
    clearance_mm: float
    collision: str
    guarded_pairs: int

    @property
    def exit_code(self) -> int:
        """0, or 2 where something is wrong with the scene."""
        return 2 if self.problems else 0

    def summary(self) -> dict[str, object]:
        """The result as JSON values."""
        contacts = [{"pair": pair, "distance_mm": distance} for pair, distance in self.contacts_at_home]
        return {"schema": 1, "ok": not self.problems, **asdict(self), "contacts_at_home": contacts}

    def rows(self) -> list[tuple[str, str]]:
        """The result as a table of two columns."""
        contacts = "; ".join(f"{pair} ({distance:.1f} mm)" for pair, distance in self.contacts_at_home)
        nearest = f"{self.nearest_at_home}, {self.nearest_at_home_mm:.1f} mm" if self.nearest_at_home else "none"
        limits = ", ".join(f"{axis} {low:g}..{high:g}" for axis, (low, high) in self.joint_limits_deg.items())
        reach = self.envelope
        bracket = f", bracket {self.bracket_length_mm:g} mm" if self.bracket_length_mm else ", no bracket"
        span = f", range {self.range_mm[0]:g} to {self.range_mm[1]:g} mm" if self.range_mm is not None else ""
        return [
            ("part", f"{self.part}, {_by(self.part_size_mm)} mm"),
            *[(f"region {name}", f"{area:,.1f} mm²") for name, area in self.regions_mm2.items()],
            ("part's centre", f"{listed(self.placement_mm)} mm in base"),
            ("home", f"{listed(self.home_deg)} deg"),
            ("contacts at home", contacts or "none"),
            ("nearest at home", nearest if nearest != "none" else f"nothing within {1000 * DISTANCE_CAP:g} mm"),
            ("joint limits", f"{limits} deg"),
            (
                "reach",
                f"wrist to {reach.wrist_reach_mm:.1f} mm from the A1 axis, z {reach.wrist_lowest_mm:.1f} to "
                f"{reach.wrist_highest_mm:.1f} mm; the source {reach.wrist_to_source_mm:.1f} mm from the wrist",
            ),
            ("scanner", f"{self.sensor or 'of its own'}{span}"),
            ("laser source", f"{listed(self.mount_mm)} mm in flange; baseline {self.baseline_mm:g} mm"),
            ("housing", f"{_by(self.housing_size_mm)} mm, middle at {listed(self.housing_mm)} mm in flange{bracket}"),
            ("keeps clear of", f"{', '.join(self.obstacles)} by {self.clearance_mm:g} mm"),
            ("part in collisions", _FIDELITY[self.collision]),
            ("guarded pairs", f"{self.guarded_pairs} pairs of shapes"),
            *[("warning", warning) for warning in self.warnings],
            *[("note", finding) for finding in self.findings],
        ]


def settle_and_compile(scene: Scene) -> tuple[SettledScene, World]:
    """Load the part of a scene, settle the scene for it and compile the cell.

    Raises:
        FileError: if the part or a fixture cannot be read.
        SceneError: if the scene cannot be compiled.
    """
    settled = settle(scene, with_regions(workpiece.load(scene.part.source, scene.part.units), scene))
    return settled, compile_settled(settled)


def check_scene(scene: Scene) -> CheckResult:
    """Load the part, compile the scene and check it; see `settle_and_compile`."""
    return check_cell(*settle_and_compile(scene))


def check_cell(settled: SettledScene, world: World) -> CheckResult:
    """Check a compiled scene; `problems` holds what makes it impossible."""
    scene, part, settings = settled.scene, settled.part, settled.settings
    checker = MujocoCollisionChecker(world)
    contacts = tuple((pair, _mm(distance)) for pair, distance in checker.pairs_within_clearance(world.home))
    distance, nearest = checker.distance(world.home[None])
    envelope = _envelope(world)
    problems = find_problems(world)
    if beyond := _beyond_reach(world, envelope, max(settings.standoffs)):
        problems.append(beyond)
    lower, upper = (np.rad2deg(ends).round(6).tolist() for ends in (world.limits.lower, world.limits.upper))
    standing = {"part", "post", TABLE, "pedestal", "floor", *(fixture.name for fixture in scene.fixtures)}
    return CheckResult(
        problems=tuple(problems),
        warnings=tuple(find_warnings(world)),
        findings=tuple(finding.sentence for finding in part.findings),
        part=part.name,
        part_size_mm=_rounded_mm(part.size),
        regions_mm2=region_areas(part, scene),
        placement_mm=_rounded_mm((world.T_base_object @ world.T_object_centre)[:3, 3]),
        home_deg=world.scene.robot.settled_home_deg,
        contacts_at_home=contacts,
        nearest_at_home=nearest[0],
        nearest_at_home_mm=_mm(distance[0]),
        joint_limits_deg={axis: (low, high) for axis, low, high in zip((*AXES, "E1"), lower, upper, strict=False)},
        envelope=envelope,
        mount_mm=_rounded_mm(world.T_flange_scanner[:3, 3]),
        housing_size_mm=scene.housing.sides_mm,
        housing_mm=_rounded_mm(world.T_flange_housing[:3, 3]),
        bracket_length_mm=_mm(2 * world.model.geom("bracket").size[1]) if "bracket" in world.entities else 0.0,
        baseline_mm=settled.baseline_mm,
        sensor=scene.scanner.sensor,
        range_mm=settings.scanner.get("range_mm"),
        obstacles=tuple(name for name in dict.fromkeys(world.entities) if name in standing),
        clearance_mm=scene.clearance_mm,
        collision=world.collision,
        guarded_pairs=len(world.pairs),
    )


def _envelope(world: World) -> Envelope:
    """The wrist over the whole range of A2 and A3."""
    out, up = wrist_positions(world.model, world.scene.robot.T_base, float(np.radians(_GRID_DEG)))
    source = world.T_flange_scanner[:3, 3] - wrist_in_flange(world.model)
    return Envelope(
        _mm(np.abs(out).max(), 1), _mm(up.min(), 1), _mm(up.max(), 1), _mm(float(np.linalg.norm(source)), 1)
    )


def _beyond_reach(world: World, envelope: Envelope, standoff: float) -> str:
    """A sentence where not even the nearest point of the part comes within the standoff; a necessary condition only."""
    T_base_centre = world.T_base_object @ world.T_object_centre
    centre = (np.linalg.inv(world.scene.robot.T_base) @ T_base_centre)[:3, 3]
    radius = float(np.linalg.norm(world.part_hull.vertices - world.T_object_centre[:3, 3], axis=1).max())
    farthest = (envelope.wrist_reach_mm + envelope.wrist_to_source_mm) / 1000 + standoff
    if world.table is not None:  # half a turn may bring it nearer
        farthest += 2 * float(np.linalg.norm(world.table.seen(T_base_centre[:3, 3])[:2]))
    gap = float(np.hypot(centre[0], centre[1])) - radius - farthest
    if gap <= 0:
        return ""
    return (
        f"the part is out of reach: it stands {1000 * gap:.0f} mm beyond what the laser sees from the arm's farthest "
        f"reach; its centre must be within {1000 * (farthest + radius):.0f} mm of the A1 axis"
    )


def _mm(metres: float, digits: int = 3) -> float:
    return round(1000 * float(metres), digits)


def _rounded_mm(metres: np.ndarray) -> Triple:
    x, y, z = (_mm(value) + 0.0 for value in metres)  # + 0.0 turns -0 into 0
    return x, y, z


def _by(values: tuple[float, ...]) -> str:
    return " x ".join(f"{value:.4g}" for value in values)

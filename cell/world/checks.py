"""Checks of a scene before anything moves: errors and probable mistakes.

**Problems** (`find_problems`) make a scene impossible: a part inside a table or the robot, a fixture inside the arm at
home, a scanner that sees its own housing. They are checked for everything stationary (`cell.world.collision` checks
motions): the robot at home, the part at its placement, true triangles of both. Objects less than
`cell.world.solids.FLUSH` deep in each other touch.

**Warnings** (`find_warnings`) are possible but probably not meant: fixtures inside each other, unsupported or tipping
objects, wrong units. An object is supported if a chain of objects in contact leads to floor or pedestal; the part on
its post is. An object rests if all its supports touch it from below; then its centre of mass (of uniform density, or of
an open surface) has to be above them (`cell.world.balance`).

Messages name both objects, the depth, and the smallest move that removes the problem, ready to be typed.
`cell check` (`check_scene`) reports all of this with the numbers of the cell.
"""

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cell.errors import SceneError
from cell.formatting import comma_list
from cell.part import workpiece
from cell.part.formats import own_units
from cell.part.workpiece import size_findings
from cell.robot.arm import wrist_in_flange, wrist_positions
from cell.robot.model import AXES, model_warnings
from cell.robot.model import limits as robot_limits
from cell.scene.model import MeshFixture, Scene
from cell.scene.regions import region_areas, with_regions
from cell.scene.settle import Settings, SettledScene, settle
from cell.world import shapes as cell_shapes
from cell.world.balance import CONTACT_DISTANCE, FINE_GRID, Rest
from cell.world.collision import DISTANCE_CAP, MujocoCollisionChecker
from cell.world.model import World, compile_settled
from cell.world.occluders import Occluder, box_triangles, geom_triangles, make_caster
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
from planner.ports import ARM_AXES, axis_name
from planner.timing.limits import scale_limits
from planner.timing.move_time import move_time
from planner.values import Floats

if TYPE_CHECKING:
    import mujoco


_ROUNDING = 0.02  # of a tenth of a millimetre: rounding of coordinates does not enlarge a move by a tenth

_FIELD_GRID = 33  # rays per axis of the field of view, edges included: 2 deg apart at 60 deg
_SKIN = 1e-6  # m; a housing with its front face in the source's plane does not occlude
_LONGEST_RADIAN = 1000.0  # s; a tour of slower moves has more samples than fit into memory
_SIGHT_LENGTH = 1.0  # m; depth at which the sensor's lines of sight end: nearer ends are inside the same fan
_WRIST_SHAPES = ("link_6", "bracket")  # the shapes that carry the housing
_STEPS, _HALVINGS = 24, 12
_DETOURS = 4  # objects, one after the other, that a move out of another object avoids

_STATIONARY = ("base", "pedestal")

_ENVELOPE_STEP_DEG = 0.5  # of A2 and A3: the outline of the wrist positions is then exact to 0.1 mm
_FIDELITY = {"hull": "its convex hull (hull)", "exact": "its triangles (exact)"}

Triple = tuple[float, float, float]


def require_feasible(world: World) -> None:
    """Refuse an impossible scene.

    Raises:
        SceneError: with every problem on a line of its own.
    """
    problems = find_problems(world)
    if problems:
        raise SceneError("\n  ".join(problems if len(problems) == 1 else ["the scene is not feasible:", *problems]))


def find_problems(world: World) -> list[str]:
    """Find the problems of a compiled scene, one sentence each; none for a feasible scene."""
    solids = cell_solids(world)
    return [
        *_home_outside_limits(world),
        *_unusable_speeds(world),
        *_occluded_field_of_view(world),
        *_housing_in_wrist(world, solids),
        *_part_outside_room(world, solids),
        *_stationary_penetrations(world, solids),
        *_objects_near_arm(world, solids),
        *_arm_near_cell(world),
        *_home_in_table_swing(world),
    ]


def _unusable_speeds(world: World) -> list[str]:
    """Check that no axis exceeds the speed of its file, which no controller accepts, or moves for hours."""
    own, file, settings = world.limits, np.degrees(robot_limits(world.model).velocity), world.scene.robot
    problems = [
        f"robot.velocity_deg_s has {speed:.6g} for {axis}, above the {most:.6g} deg/s of the robot's file; lower it "
        "or correct the file"
        for axis, speed, most in zip(AXES, np.degrees(own.velocity[:ARM_AXES]), file, strict=True)
        if speed > most + 1e-6
    ]
    limits = scale_limits(own, settings.speed_scaling, settings.acceleration_scaling)
    seconds = move_time(np.zeros(len(own.lower)), np.eye(len(own.lower)), limits)
    if seconds.max() > _LONGEST_RADIAN:
        problems.append(
            f"{axis_name(int(seconds.argmax()))} takes {seconds.max():.3g} s for 1 rad, and the limit is "
            f"{_LONGEST_RADIAN:g} s; raise robot.speed_scaling, robot.acceleration_scaling, or the limits of this axis"
        )
    return problems


def find_warnings(world: World) -> list[str]:
    """Find probable mistakes in a compiled scene, one sentence each."""
    fixtures, warnings = world.scene.fixtures, [*model_warnings(world.spec), *_limited_table(world)]
    if not fixtures and world.scene.post.enabled:
        return warnings
    solids = cell_solids(world)
    for fixture in fixtures:
        if isinstance(fixture, MeshFixture):
            size = np.ptp(world.fixture_meshes[fixture.name].vertices, axis=0)
            units = None if fixture.units == own_units(fixture.path) else fixture.units
            findings = size_findings(size, units, _object_name(world, fixture.name))
            warnings += [finding.sentence for finding in findings]
    return warnings + _fixture_penetrations(world, solids) + _unsupported_objects(world, solids)


def _object_name(world: World, name: str) -> str:
    """Return the name of an object as a sentence has it."""
    if name in robot_bodies(world):
        return f"the {name}" if name in ("housing", "bracket") else f"the robot's {name}"
    return f"the {name}" if name in ("part", TABLE, *BUILT_IN_OBSTACLES) else f"the fixture '{name}'"


def _move_object(world: World, solids: dict[str, Solid], name: str, move: Floats) -> str:
    """Return the instruction that moves part, post, table or a fixture by (3,) [m], base frame."""
    length = float(np.linalg.norm(move))
    tenths = np.ceil(length * 1e4 - _ROUNDING) / 1e4
    move = move * (tenths / length) if length > 0 else move
    if name in ("part", "post"):
        key, position, step = "placement.position_mm", (world.T_base_object @ world.T_object_centre)[:3, 3], move
    elif name == TABLE and world.table is not None:
        key, position, step = "table.position_mm", world.table.T_base_table[:3, 3], move
    else:
        fixtures = world.scene.fixtures
        index = [fixture.name for fixture in fixtures].index(name)
        key, position, step = f"fixtures[{index}].position_mm", fixtures[index].T[:3, 3], move
        if fixtures[index].attached_to == "object":
            step = world.T_base_object[:3, :3].T @ move
    if hit := _hit_by_move(world, solids, name, move):
        return f"change {key}: the shortest move would bring it into {_object_name(world, hit[0])}"
    return _move_key(key, position, step)


def _hit_by_move(world: World, solids: dict[str, Solid], name: str, move: Floats) -> list[str]:
    """Return the objects that part, post or a fixture, moved by (3,) [m], newly penetrates, or the arm that it nears.

    Post and fixtures of the part move with it. Where a table moves, everything on it is placed again.
    """
    if name == TABLE:
        return []
    with_part = {"part", "post", *(each.name for each in world.scene.fixtures if each.attached_to == "object")}
    moving = with_part if name in ("part", "post") else {name}
    arm, hit = [each for each in robot_bodies(world) if each not in _STATIONARY], dict[str, None]()
    for mover in sorted(moving & solids.keys()):
        there, here = solids[mover].with_vertices(solids[mover].vertices + move), solids[mover]
        for other in solids.keys() - moving:
            if other in arm:
                is_new = touches(there, solids[other], world.clearance) and not touches(
                    here, solids[other], world.clearance
                )
            else:
                is_new = penetrates(there, solids[other]) and not penetrates(here, solids[other])
            if is_new and not (mover == "post" and other not in _STATIONARY):
                hit[other] = None
        if mover != "post" and there.low[2] < world.floor - CONTACT_DISTANCE and there.low[2] < here.low[2]:
            hit["floor"] = None
    return sorted(hit)


def _move_key(key: str, position: Floats, move: Floats) -> str:
    """Return the instruction that changes a key with a position (3,) by a move (3,) [m]."""
    step = np.round(1000 * move, 2) + 0.0  # + 0.0 turns -0 into 0
    return f"move {key} by {_triple(step)} mm, to {_triple(np.round(1000 * position, 3) + step)}"


def _triple(values: Floats) -> str:
    return f"({', '.join(f'{value:.7g}' for value in np.round(values, 3) + 0.0)})"


def _penetration(
    world: World, solids: dict[str, Solid], one: Solid, other: Solid, *, move: Floats | None = None,
    at_home: bool = False,
) -> str:  # fmt: skip
    """Describe a movable object inside another one.

    Args:
        world: the cell of both.
        solids: its objects.
        one: part, post, table or a fixture.
        other: any object.
        move: (3,) of `one` that separates it from more than `other` [m].
        at_home: whether the other is a part of the robot at home.
    """
    out = minimum_translation(one, other)
    cure = _move_object(
        world, solids, one.name, _clear_move(world, solids, one, other, shortest=out) if move is None else move
    )
    also, where = (" or change robot.home_deg", " at home") if at_home else ("", "")
    depth = f"{1000 * float(np.linalg.norm(out)):.1f} mm deep"
    return f"{_object_name(world, one.name)} intersects {_object_name(world, other.name)}{where}, {depth}; {cure}{also}"


def _clear_move(
    world: World, solids: dict[str, Solid], one: Solid, other: Solid, gap: float = 0.0, shortest: Floats | None = None
) -> Floats:
    """Return the shortest move (3,) [m] found that separates one from other and from what it would hit on the way out.

    The part is also separated from all other objects that it is inside of. The move is the shortest separation alone if
    no move without a new contact is found.

    Args:
        world: the cell of both.
        solids: its objects.
        one: part, post, table or a fixture.
        other: an object, or the robot.
        gap: distance to the other afterwards [m].
        shortest: (3,) the shortest separation of the two, if known [m].
    """
    around = set[str]()

    def separation() -> Floats:
        around_one = (other, *(solids[name] for name in sorted(around)))
        pieces = [(each.vertices, each.faces) for each in around_one]
        return minimum_translation(one, Solid("obstacles", *concatenate_meshes(pieces)[:2], other.axes), gap)

    if one.name == "part":
        fixtures = (each.name for each in world.scene.fixtures if each.attached_to == "base")
        beside = ({*_STATIONARY, TABLE, *fixtures} & solids.keys()) - {other.name}
        around |= {name for name in beside if penetrates(one, solids[name])}
    if around or shortest is None:
        shortest = separation()
    move = shortest
    for _ in range(_DETOURS):
        hit = [name for name in _hit_by_move(world, solids, one.name, move) if name in solids]
        if not hit:
            return move
        around |= set(hit)
        move = separation()
    return move if not _hit_by_move(world, solids, one.name, move) else shortest


def _home_outside_limits(world: World) -> list[str]:
    lower, upper = np.rad2deg(world.limits.lower).round(6), np.rad2deg(world.limits.upper).round(6)
    return [
        f"robot.home_deg has {axis} at {angle:g} deg; it must be from {low:g} to {high:g}"
        for axis, angle, low, high in zip(AXES, world.scene.robot.settled_home_deg, lower, upper, strict=False)
        if not low - 1e-9 <= angle <= high + 1e-9
    ]


def _occluded_field_of_view(world: World) -> list[str]:
    """Describe occlusion of the field of view by housing or wrist, which a wrong sign of a position causes."""
    problems = []
    if share := housing_occlusion(world):
        move = _move_key("housing.position_mm", _T_scanner_housing(world)[:3, 3], _clearing_move(world))
        problems.append(
            f"the housing hides {100 * share:.0f} % of the scanner's own field of view; its front must lie behind "
            f"source and sensor: {move}, or change housing.size_mm or the mount"
        )
    if share := _wrist_occlusion(world):
        problems.append(
            f"the robot's flange and bracket hide {100 * share:.0f} % of the scanner's own field of view; turn the "
            "scanner away from them: change mount.abc_deg or mount.position_mm"
        )
    return problems


def housing_occlusion(world: World, move: Floats | None = None) -> float:
    """Return the share of the field of view, from source and sensor, that the housing hides.

    Args:
        world: the compiled scene.
        move: (3,) of the housing, scanner frame [m]; None: not moved.
    """
    T = _T_scanner_housing(world)
    vertices, faces = box_triangles(np.array(world.scene.housing.sides_mm) / 2000 - _SKIN)
    origin = T[:3, 3] + (np.zeros(3) if move is None else move)
    return _occlusion(world, [Occluder("housing", vertices @ T[:3, :3].T + origin, faces)])


def _occlusion(world: World, pieces: list[Occluder]) -> float:
    """Return the share of the lines of sight of source and sensor that pieces in the scanner frame hide."""
    if not pieces or max(each.vertices[:, 2].max() for each in pieces) <= _SKIN:
        return 0.0  # all of it is behind source and sensor
    caster = make_caster(pieces)
    starts, ends = _lines_of_sight(world)
    hidden: NDArray[np.bool_] = np.zeros(len(ends), dtype=bool)
    for start in starts:
        hidden |= caster.blocked(np.broadcast_to(start, ends.shape), ends)
    return float(hidden.mean())


def _T_scanner_housing(world: World) -> Floats:
    return world.scene.housing.T_scanner_housing(1000 * world.baseline)


def _lines_of_sight(world: World) -> tuple[Floats, Floats]:
    """Return source and sensor (2, 3), and the ends (n, 3) of their lines of sight [m], scanner frame."""
    half = np.tan(np.radians(world.scene.scanner.opening_deg) / 2)
    x, y = np.meshgrid(*(np.linspace(-side, side, _FIELD_GRID) for side in half))
    ends = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3) * _SIGHT_LENGTH
    return np.array([[0.0, 0.0, 0.0], [world.baseline, 0.0, 0.0]]), ends


def _clearing_move(world: World) -> Floats:
    """Return the shortest move (3,) of the housing along an axis of the scanner frame after which it hides nothing."""
    half = np.array(world.scene.housing.sides_mm) / 2000
    T = _T_scanner_housing(world)
    ahead = float(T[2, 3] + np.abs(T[2, :3]) @ half)  # foremost corner: moved back by this, all of it is behind
    shortest, best = ahead, np.array([0.0, 0.0, -1.0])
    for direction in (*np.eye(3)[:2], *-np.eye(3)):
        steps = np.linspace(0, shortest, _STEPS + 1)
        clear = next((k for k in range(1, _STEPS) if not housing_occlusion(world, steps[k] * direction)), 0)
        if not clear:
            continue
        low, high = steps[clear - 1], steps[clear]
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            low, high = (middle, high) if housing_occlusion(world, middle * direction) else (low, middle)
        if high < shortest:
            shortest, best = high, direction
    return np.asarray(np.ceil(shortest * 1e4 - _ROUNDING) / 1e4 * best)


def _wrist_occlusion(world: World) -> float:
    """Return the share of the field of view, from source and sensor, that flange and bracket hide."""
    data = world.data()
    flange = data.site("flange")
    R = flange.xmat.reshape(3, 3) @ world.T_flange_scanner[:3, :3]
    origin = flange.xpos + flange.xmat.reshape(3, 3) @ world.T_flange_scanner[:3, 3]
    pieces = []
    for geom, name in enumerate(world.entities):
        if name in _WRIST_SHAPES:
            vertices, faces = geom_triangles(world.model, data, geom)
            pieces.append(Occluder(name, (vertices - origin) @ R, faces))
    return _occlusion(world, pieces)


def _housing_in_wrist(world: World, solids: dict[str, Solid]) -> list[str]:
    """Check the housing with the flange: one rigid body, whose shapes no motion check compares."""
    if "link_6" not in solids:  # of an arm from a file, without shape
        return []
    flange, last = world.data().site("flange"), solids["link_6"]
    R = flange.xmat.reshape(3, 3)
    in_flange = (last.vertices - flange.xpos) @ R
    in_flange[:, 2] = np.minimum(in_flange[:, 2], 0.0)  # its enclosing shape exceeds the face a little
    last = Solid(last.name, in_flange @ R.T + flange.xpos, last.faces, R.T)
    if not penetrates(solids["housing"], last):
        return []
    out = minimum_translation(solids["housing"], last)
    return [
        f"the housing intersects the robot's link_6, on which it is mounted, {1000 * np.linalg.norm(out):.1f} mm "
        f"deep; {_move_key('mount.position_mm', world.T_flange_scanner[:3, 3], R.T @ out)}"
    ]


def _part_outside_room(world: World, solids: dict[str, Solid]) -> list[str]:
    T, problems = world.T_base_object, []
    lowest = float((world.part_hull.vertices @ T[2, :3]).min() + T[2, 3])
    if (depth := world.floor - lowest) > 1e-6:
        problems.append(
            f"the part reaches {1000 * depth:.1f} mm below the floor, which is at z = {1000 * world.floor + 0.0:g} mm; "
            f"{_move_object(world, solids, 'part', np.array([0.0, 0.0, depth]))}"
        )
    if world.table is None and world.scene.post.enabled and lowest - world.floor > cell_shapes.POST_LENGTH:
        problems.append(
            f"the part is {lowest - world.floor:.1f} m above the floor; a post is at most "
            f"{cell_shapes.POST_LENGTH:g} m long: lower placement.position_mm, or set post.enabled = false"
        )
    return problems


def _stationary_penetrations(world: World, solids: dict[str, Solid]) -> list[str]:
    """Check part, post and fixtures with stationary objects. A table may be bolted to the pedestal."""
    fixtures = [fixture.name for fixture in world.scene.fixtures]
    fixtures += [] if world.table is None else [TABLE]
    pairs = [("part", name) for name in (*fixtures, *_STATIONARY)]
    pairs += [("post", name) for name in _STATIONARY] + [(name, "base") for name in fixtures]
    problems: list[str] = []
    on_part = {fixture.name for fixture in world.scene.fixtures if fixture.attached_to == "object"}
    around_part = set()  # objects that the part is inside of: its post is too, and moves with it
    move_of_part = None
    for one, other in pairs:
        if one == "post" and other in around_part:
            continue
        if one in solids and other in solids and penetrates(solids[one], solids[other]):
            around_part |= {other} if one == "part" else set()
            mover, fixed = (other, one) if one == "part" and other in on_part else (one, other)
            if mover == "part" and move_of_part is None:
                move_of_part = _clear_move(world, solids, solids[mover], solids[fixed])
            move = move_of_part if mover == "part" else None
            problems.append(_penetration(world, solids, solids[mover], solids[fixed], move=move))
    return problems


def _objects_near_arm(world: World, solids: dict[str, Solid]) -> list[str]:
    """Check part, post, table and fixtures with arm and scanner at home, with the clearance."""
    data, geoms = world.data(), _geoms(world)
    moving = [name for name in robot_bodies(world) if name in geoms and name != "base"]
    problems = []
    for name in ("part", "post", TABLE, *(fixture.name for fixture in world.scene.fixtures)):
        distances = (
            {piece: _distance(world, data, geoms, piece, name) for piece in reversed(moving)} if name in solids else {}
        )
        piece = min(distances, key=lambda each: distances[each], default="")
        if not piece or distances[piece] >= world.clearance - 1e-9:
            continue
        move = _clear_move(world, solids, solids[name], robot_solid(world, solids), world.clearance)
        if distances[piece] < 0 or penetrates(solids[name], solids[piece]):
            problems.append(_penetration(world, solids, solids[name], solids[piece], move=move, at_home=True))
        else:
            problems.append(
                f"{_object_name(world, name)} is {1000 * distances[piece]:.1f} mm from {_object_name(world, piece)} at "
                f"home, nearer than the clearance of {1000 * world.clearance:g} mm; "
                f"{_move_object(world, solids, name, move)} or change robot.home_deg"
            )
    return problems


def _arm_near_cell(world: World) -> list[str]:
    """Check the robot at home with itself, the pedestal and the floor, with the clearance."""
    data, geoms = world.data(), _geoms(world)
    robot_pieces = {*robot_bodies(world), "pedestal", "floor"}
    checked = {tuple(sorted((world.entities[a], world.entities[b]))) for a, b in world.pairs}
    problems = []
    for one, other in sorted(checked):
        distance = _distance(world, data, geoms, one, other) if {one, other} <= robot_pieces else np.inf
        if distance < world.clearance - 1e-9:
            name = world.pair_name(geoms[one][0], geoms[other][0])
            partner = "the cell" if {one, other} & {"pedestal", "floor"} else "itself"
            apart = f"{-1000 * distance:.1f} mm deep" if distance < 0 else f"{1000 * distance:.1f} mm apart"
            problems.append(
                f"at home the robot is too near to {partner}: {name}, {apart}, clearance "
                f"{1000 * world.clearance:g} mm; change robot.home_deg, mount or housing"
            )
    return problems


def _home_in_table_swing(world: World) -> list[str]:
    """Check the arm at home against the objects that an indexed table turns."""
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
    """Return the geoms of each object."""
    geoms: dict[str, list[int]] = {}
    for geom, name in enumerate(world.entities):
        geoms.setdefault(name, []).append(geom)
    return geoms


def _distance(world: World, data: "mujoco.MjData", geoms: dict[str, list[int]], one: str, other: str) -> float:
    """Return the distance of two objects as the collision check measures it [m], at most 1 mm above the clearance."""
    reach = world.clearance + 1e-3
    return min(world.distance(data, a, b, reach) for a in geoms[one] for b in geoms[other])


def _limited_table(world: World) -> list[str]:
    """Describe a rotary table that cannot turn its part all the way."""
    if world.table is None:
        return []
    lower, upper = np.degrees([world.table.lower, world.table.upper]).round(4)
    low, high = world.scene.table.limits_deg or (-180.0, 180.0)
    if (lower, upper) == (low, high) or upper - lower >= 359:
        return []
    return [
        f"the rotary table turns its part from {lower:g} to {upper:g} deg only: beyond these angles the part is "
        "nearer than the clearance to an object beside it"
    ]


def _fixture_penetrations(world: World, solids: dict[str, Solid]) -> list[str]:
    """Check fixtures with fixtures, pedestal and floor; the post with fixtures."""
    names = [fixture.name for fixture in world.scene.fixtures]
    warnings = []
    for number, name in enumerate(names):
        for other in (*names[:number], "pedestal"):
            if other in solids and penetrates(solids[name], solids[other]):
                warnings.append(_penetration(world, solids, solids[name], solids[other]))
        if "post" in solids and penetrates(solids["post"], solids[name]):
            warnings.append(
                f"the post goes through {_object_name(world, name)}; set post.enabled = false if that object carries "
                "the part"
            )
        if (depth := world.floor - float(solids[name].low[2])) > CONTACT_DISTANCE:
            warnings.append(
                f"{_object_name(world, name)} reaches {1000 * depth:.1f} mm below the floor; "
                f"{_move_object(world, solids, name, np.array([0.0, 0.0, depth]))}"
            )
    return warnings


def _unsupported_objects(world: World, solids: dict[str, Solid]) -> list[str]:
    """Describe objects that nothing supports, and objects that tip."""
    robot = robot_bodies(world)
    standing = {name: solid for name, solid in solids.items() if name not in robot}
    contacts = {
        name: {
            other for other in standing
            if other != name and touches(standing[name], standing[other], CONTACT_DISTANCE)
        }
        for name in standing
    }  # fmt: skip
    if "post" in standing:  # it holds the part wherever it touches it
        contacts["part"].add("post")
        contacts["post"].add("part")
    on_floor = world.floor + CONTACT_DISTANCE
    grounded = [name for name, solid in standing.items() if solid.low[2] <= on_floor or name == "pedestal"]
    supported = _connected(contacts, grounded)
    warnings, left = [], [name for name in standing if name not in supported]
    while left:
        group = _connected(contacts, left[:1])
        left = [name for name in left if name not in group]
        warnings.append(_unsupported_group(world, solids, standing, group))
    for name, solid in standing.items():
        supports = contacts[name] & _connected(contacts, grounded, without=name)
        if name in ("post", "pedestal") or name not in supported or "post" in supports:
            continue
        below = [standing[each] for each in sorted(supports)]
        rest = Rest(solid, below, world.floor)
        if rest.on >= supports and rest.move_to_balance() is not None:
            move = Rest(solid, below, world.floor, FINE_GRID).move_to_balance()
            if move is not None:
                on = ", ".join(_object_name(world, each) for each in sorted(rest.on)) or "the floor"
                offset = 1000 * float(np.linalg.norm(move))
                warnings.append(
                    f"the centre of mass of {_object_name(world, name)} is {offset:.1f} mm outside its "
                    f"support ({on}); it tips unless it is fastened: {_move_object(world, solids, name, move)}"
                )
    return warnings


def _unsupported_group(world: World, solids: dict[str, Solid], standing: dict[str, Solid], group: set[str]) -> str:
    """Describe objects in contact with each other that nothing supports.

    Args:
        world: the cell.
        solids: its objects.
        standing: the objects without the robot.
        group: names of the objects in contact.
    """
    others = [solid for name, solid in standing.items() if name not in group]
    gaps = {name: Rest(standing[name], others, world.floor, FINE_GRID).gap() for name in standing if name in group}
    name = min(gaps, key=lambda each: gaps[each][0])
    gap, below = gaps[name]
    other_names = [_object_name(world, each) for each in standing if each in group and each != name]
    with_others = f" (with {', '.join(other_names)})" if other_names else ""
    return (
        f"{_object_name(world, name)}{with_others} has no support: it is {1000 * gap:.1f} mm above "
        f"{_object_name(world, below)}; {_move_object(world, solids, name, np.array([0.0, 0.0, -gap]))}"
    )


def _connected(contacts: dict[str, set[str]], start: list[str], without: str = "") -> set[str]:
    """Return the objects that a chain of contacts connects with some objects, ignoring one object."""
    names = {name for name in start if name != without}
    ends = list(names)
    while ends:
        for name in contacts[ends.pop()] - names - {without}:
            names.add(name)
            ends.append(name)
    return names


@dataclass(frozen=True, slots=True)
class Envelope:
    """Positions of the wrist centre within the limits of A2 and A3 [mm].

    Attributes:
        wrist_reach_mm: largest distance from the A1 axis.
        wrist_lowest_mm: smallest height, base frame.
        wrist_highest_mm: largest height, base frame.
        wrist_to_source_mm: distance from wrist centre to laser source, equal at all joint angles.
    """

    wrist_reach_mm: float
    wrist_lowest_mm: float
    wrist_highest_mm: float
    wrist_to_source_mm: float


@dataclass(frozen=True, slots=True)
class CheckResult:
    """Result of `cell check`.

    Attributes:
        problems: what makes the scene impossible, one sentence each; empty for a scene that can be planned.
        warnings: probable mistakes, one sentence each.
        findings: notes of the checks of the part.
        part: name of the part.
        part_size_mm: sides of its bounding box.
        regions_mm2: area of each measured region; empty for a part without regions.
        placement_mm: centre of the part in the base frame.
        home_deg: A1..A6.
        contacts_at_home: pairs nearer than the clearance and their distance [mm], negative in contact, nearest first.
        nearest_at_home: the nearest checked pair, "" beyond 300 mm.
        nearest_at_home_mm: its distance.
        joint_limits_deg: lowest and highest angle of each axis.
        envelope: reach of the arm.
        mount_mm: laser source in the flange frame.
        housing_size_mm: sides of the scanner's box.
        housing_mm: its middle in the flange frame.
        bracket_length_mm: from flange to housing; 0: none.
        baseline_mm: from source to sensor.
        sensor: name of the device, None for a scanner without one.
        range_mm: of the distance of a point; None: the scanner has none.
        obstacles: names of everything that arm and tool keep clear of.
        clearance_mm: distance that they keep.
        collision: shape of the part in collision checks: hull or exact.
        guarded_pairs: number of checked pairs of shapes.
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
        """Exit code of the command: 0, or 2 with problems."""
        return 2 if self.problems else 0

    def summary(self) -> dict[str, object]:
        """Return the result as JSON values."""
        contacts = [{"pair": pair, "distance_mm": distance} for pair, distance in self.contacts_at_home]
        return {"schema": 1, "ok": not self.problems, **asdict(self), "contacts_at_home": contacts}

    def rows(self) -> list[tuple[str, str]]:
        """Return the result as a table of two columns."""
        contacts = "; ".join(f"{pair} ({distance:.1f} mm)" for pair, distance in self.contacts_at_home)
        nearest = f"{self.nearest_at_home}, {self.nearest_at_home_mm:.1f} mm"
        limits = ", ".join(f"{axis} {low:g}..{high:g}" for axis, (low, high) in self.joint_limits_deg.items())
        reach = self.envelope
        bracket = f", bracket {self.bracket_length_mm:g} mm" if self.bracket_length_mm else ", no bracket"
        span = f", range {self.range_mm[0]:g} to {self.range_mm[1]:g} mm" if self.range_mm is not None else ""
        return [
            ("part", f"{self.part}, {_by(self.part_size_mm)} mm"),
            *[(f"region {name}", f"{area:,.1f} mm²") for name, area in self.regions_mm2.items()],
            ("part's centre", f"{comma_list(self.placement_mm)} mm in base"),
            ("home", f"{comma_list(self.home_deg)} deg"),
            ("contacts at home", contacts or "none"),
            ("nearest at home", nearest if self.nearest_at_home else f"nothing within {1000 * DISTANCE_CAP:g} mm"),
            ("joint limits", f"{limits} deg"),
            (
                "reach",
                f"wrist to {reach.wrist_reach_mm:.1f} mm from the A1 axis, z {reach.wrist_lowest_mm:.1f} to "
                f"{reach.wrist_highest_mm:.1f} mm; the source {reach.wrist_to_source_mm:.1f} mm from the wrist",
            ),
            ("scanner", f"{self.sensor or 'defined in the scene'}{span}"),
            ("laser source", f"{comma_list(self.mount_mm)} mm in flange; baseline {self.baseline_mm:g} mm"),
            (
                "housing",
                f"{_by(self.housing_size_mm)} mm, middle at {comma_list(self.housing_mm)} mm in flange{bracket}",
            ),
            ("keeps clear of", f"{', '.join(self.obstacles)} by {self.clearance_mm:g} mm"),
            ("part in collisions", _FIDELITY[self.collision]),
            ("checked pairs", f"{self.guarded_pairs} pairs of shapes"),
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
    if problem := _beyond_reach(world, envelope, _farthest_point(settings)):
        problems.append(problem)
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
    """Compute the positions of the wrist over the whole range of A2 and A3."""
    out, up = wrist_positions(world.model, world.scene.robot.T_base, float(np.radians(_ENVELOPE_STEP_DEG)))
    source = world.T_flange_scanner[:3, 3] - wrist_in_flange(world.model)
    return Envelope(
        _mm(np.abs(out).max(), 1), _mm(up.min(), 1), _mm(up.max(), 1), _mm(float(np.linalg.norm(source)), 1)
    )


def _farthest_point(settings: Settings) -> float:
    """Return the largest distance of a point from the source [m]: candidates grow over the whole range.

    The range of a line sensor is a depth, and its ends are farther away than its middle.
    """
    far = settings.scanner.get("range_mm", (0.0, 1000 * max(settings.standoffs)))[1] / 1000
    return float(far / np.cos(np.radians(settings.scanner.get("fan_deg", 0.0)) / 2))


def _beyond_reach(world: World, envelope: Envelope, farthest_point: float) -> str:
    """Describe a part whose nearest point no reachable source is near enough to: a necessary condition only.

    Args:
        world: the cell.
        envelope: reach of the arm.
        farthest_point: largest distance of a point from the source [m].
    """
    T_base_centre = world.T_base_object @ world.T_object_centre
    centre = (np.linalg.inv(world.scene.robot.T_base) @ T_base_centre)[:3, 3]
    radius = float(np.linalg.norm(world.part_hull.vertices - world.T_object_centre[:3, 3], axis=1).max())
    farthest = (envelope.wrist_reach_mm + envelope.wrist_to_source_mm) / 1000 + farthest_point
    if world.table is not None:  # half a turn may bring the part nearer
        farthest += 2 * float(np.linalg.norm(world.table.to_table_frame(T_base_centre[:3, 3])[:2]))
    gap = float(np.hypot(centre[0], centre[1])) - radius - farthest
    if gap <= 0:
        return ""
    return (
        f"the part is out of reach: it is {1000 * gap:.0f} mm beyond the laser's range at the arm's farthest "
        f"reach; its centre must be within {1000 * (farthest + radius):.0f} mm of the A1 axis"
    )


def _mm(metres: float, digits: int = 3) -> float:
    return round(1000 * float(metres), digits)


def _rounded_mm(metres: np.ndarray) -> Triple:
    x, y, z = (_mm(value) + 0.0 for value in metres)  # + 0.0 turns -0 into 0
    return x, y, z


def _by(values: tuple[float, ...]) -> str:
    return " x ".join(f"{value:.4g}" for value in values)

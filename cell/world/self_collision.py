"""Allowed collision matrix of an arm: pairs of links, bracket and housing that need no check or a smaller distance.

**Separation proof** (`prove_separation`): branch and bound over the angles of the axes between two bodies. Between
bodies A and B are the joints J_1 .. J_n, the first carried by A, the last carrying B. From the middle of a box of
angles to any point of the box joint i turns by at most h_i, and every point beyond it moves by at most h_i times its
distance from the axis. Any body between A and B may be taken as the stationary one. If it is the one behind joint s,
A's points move by the joints up to s, and B's by those after it, so that the distance of A and B changes by at most

    sum over i <= s of h_i R_Ai + sum over i > s of h_i R_Bi,

for every s. R_Ai is the largest distance of a point of A from axis i at any angles: for the joint that A carries it is
that of its points; for another the length from anchor to anchor, and from the last to the farthest point. A box is
settled if the distance at its middle exceeds this change plus the required distance; any other box is halved, the one
nearest to contact first.

**Links of an arm from a file** (`LinkPairs`): two links that touch at every one of `N_POSES` seeded poses are joined by
something that the chain does not show (a closed bearing, a parallelogram). Two that come near each other and are proven
separate need no check. Every other pair is checked, with less than the cell's clearance if the arm's build never allows
that.

**Bracket and housing** (`exclude_tool_pairs`): the same for the tool with link_4 and link_5, by the wrist's build.

Metres, radians.
"""

from __future__ import annotations

import contextlib
import hashlib
import heapq
import itertools
import json
import logging
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cell.files import atomic_write, cache_folder
from cell.robot import model as robot
from cell.robot.model import AXES, MimicJoints, mesh_of
from cell.world.shapes import ShapeDistances, enclosing_points, meshes_of
from cell.world.travel import farthest
from planner.geometry.hull import is_convex
from planner.values import Floats

if TYPE_CHECKING:
    import mujoco

log = logging.getLogger(__name__)
log.addHandler(logging.NullHandler())  # without a handler, Python would print the warning on stderr

MAX_CONFIGURATIONS = 200_000
"""Configurations after which a separation proof gives up."""

MAX_AXES = 3
"""Largest number of axes between two bodies for which a proof is tried: the number of boxes is exponential in it."""

N_POSES = 10_000
"""Number of seeded poses at which a pair must touch to be allowed."""

HOME_DISTANCE = 0.02
"""Distance [m] between links at a home that is searched for, unless the build of the arm allows less."""

_LEAST = 1e-5  # m; smaller distances count as contact
_NEAR = 0.02  # m; pairs that never come nearer are checked as usual, without a proof
_TOOL_DISTANCE = 0.01  # m; separation that is enough for bracket and housing
_TOOL_CONFIGURATIONS = 20_000  # of a proof for bracket or housing, which is repeated for each cell: half a second
_WRIST_STEP = np.deg2rad(6.0)


def prove_separation(
    model: mujoco.MjModel,
    shapes: ShapeDistances,
    one: int,
    other: int,
    distance: float,
    max_configurations: int = MAX_CONFIGURATIONS,
) -> bool:
    """Return whether two bodies are proven to be a distance apart at all angles of the axes between them.

    Args:
        model: the arm, alone or in its cell.
        shapes: measures the bodies.
        one: a body.
        other: another body.
        distance: required distance [m], above 0.
        max_configurations: number of configurations after which the proof fails.
    """
    import mujoco

    axes, moved = axes_between(model, one, other)
    if len(axes) > MAX_AXES or not len(axes):
        return False
    low, high = _ranges(model, axes)
    geoms = [np.flatnonzero(model.geom_bodyid == body).tolist() for body in (one, other)]
    pairs = [(a, b) for a in geoms[0] for b in geoms[1]]
    data, mimic_joints, q = mujoco.MjData(model), MimicJoints.from_model(model), np.zeros(len(AXES))
    boxes = [(0.0, 0, (low + high) / 2, (high - low) / 2)]
    for count in range(max_configurations):
        if not boxes:
            return True
        _, _, middle, half = heapq.heappop(boxes)
        changes = moved @ half
        stationary = int(np.argmin(changes))
        q[axes] = middle
        data.qpos[:] = mimic_joints.qpos(q)
        mujoco.mj_kinematics(model, data)
        measured = reach = distance + float(changes[stationary])
        for a, b in pairs:
            measured = min(measured, shapes.distance(data, a, b, measured, any_nearer=True))
        if measured < distance:
            return False
        if measured < reach:
            along = int(np.argmax(moved[stationary] * half))
            half = np.where(np.arange(len(half)) == along, half / 2, half)
            for sign in (-1, 1):
                centre = middle.copy()
                centre[along] += sign * half[along]
                heapq.heappush(boxes, (measured - reach, 2 * count + (sign > 0), centre, half))
    return not boxes


def _ranges(model: mujoco.MjModel, axes: list[int]) -> tuple[Floats, Floats]:
    """Return lowest and highest angles (k,) to be checked [rad]: one turn of a range of more than a turn."""
    low, high = np.array([model.joint(AXES[axis]).range for axis in axes]).T.copy()
    mimic_joints = MimicJoints.from_model(model)
    for k, axis in enumerate(axes):
        if all(float(ratio).is_integer() for ratio in mimic_joints.ratio[mimic_joints.axis == axis]):
            high[k] = min(high[k], low[k] + 2 * np.pi)
    return low, high


def axes_between(model: mujoco.MjModel, one: int, other: int) -> tuple[list[int], Floats]:
    """Return the axes between two bodies, and (n + 1, k) bounds on their relative motion by each axis [m/rad].

    Row s takes the body behind joint s as the stationary one.
    """
    import mujoco

    data = mujoco.MjData(model)
    data.qpos[:] = 0.0
    mujoco.mj_kinematics(model, data)
    joints = _joints_between(model, one, other)
    if not joints:
        return [], np.zeros((1, 0))
    anchors, lines = data.xanchor[joints], data.xaxis[joints]
    by_other = farthest(anchors, lines, _points(model, data, other))
    by_one = farthest(anchors[::-1], lines[::-1], _points(model, data, one))[::-1]
    mimic_joints, count = MimicJoints.from_model(model), len(joints)
    driven = [
        (j, 1.0) if j < len(AXES) else (int(mimic_joints.axis[j - 6]), float(mimic_joints.ratio[j - 6])) for j in joints
    ]
    axes = sorted({axis for axis, _ in driven})
    moved = np.zeros((count + 1, len(axes)))
    for number, (axis, ratio) in enumerate(driven):
        is_before = np.arange(count + 1) > number
        moved[:, axes.index(axis)] += abs(ratio) * np.where(is_before, by_one[number], by_other[number])
    return axes, moved


def _joints_between(model: mujoco.MjModel, one: int, other: int) -> list[int]:
    """Return the joints from the first body to the second, in order."""
    up, down = (_joints_above(model, body) for body in (one, other))
    while up and down and up[-1] == down[-1]:
        up.pop()
        down.pop()
    return up + down[::-1]


def _joints_above(model: mujoco.MjModel, body: int) -> list[int]:
    """Return the joints between a body and the world, nearest first."""
    joints: list[int] = []
    while body > 0:
        at = int(model.body_jntadr[body])
        joints += range(at, at + int(model.body_jntnum[body])) if at >= 0 else ()
        body = int(model.body_parentid[body])
    return joints


def _points(model: mujoco.MjModel, data: mujoco.MjData, body: int) -> tuple[Floats, Floats]:
    """Return centres (P, 3) and radii (P,) of balls whose hull contains a body [m]."""
    import mujoco

    points, radii = [], []
    for geom in np.flatnonzero(model.geom_bodyid == body).tolist():
        at, radius = enclosing_points(model, data, geom)
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
            at = data.xpos[body] + mesh_of(model, geom).vertices @ data.xmat[body].reshape(3, 3).T
        points.append(at)
        radii.append(np.full(len(at), radius))
    return np.concatenate(points), np.concatenate(radii)


@dataclass(frozen=True, slots=True)
class PairClasses:
    """Classes of the pairs of links of an arm.

    Attributes:
        joined: pairs that touch at every seeded pose.
        separate: pairs that come nearer than `_NEAR` and never touch, with the proven distance [m] at all angles of the
            axes between them: half of the smallest measured distance.
        reduced: other pairs that are never farther apart than `_NEAR`, with the distance that is checked [m]: half of
            the largest measured distance.
    """

    joined: list[tuple[str, str]]
    separate: list[tuple[str, str, float]]
    reduced: list[tuple[str, str, float]]


class LinkPairs:
    """The pairs of links of an arm that may touch each other.

    Attributes:
        pairs: geoms of each pair of links.
        q: seeded joint angles (N_POSES, 6) [rad].
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        """Collect the pairs of the compiled model of the robot alone."""
        import mujoco

        self.model, self._data, self._mimic_joints = model, mujoco.MjData(model), MimicJoints.from_model(model)
        meshes = meshes_of(model)
        self.shapes = ShapeDistances(model, meshes, [name for name, mesh in meshes.items() if not is_convex(mesh)])
        self._triangles = ShapeDistances(model, meshes, list(meshes))
        self.pairs: dict[tuple[str, str], list[tuple[int, int]]] = {}
        excluded = _excluded(model)
        for a, b in itertools.combinations(range(model.ngeom), 2):
            bodies = int(model.geom_bodyid[a]), int(model.geom_bodyid[b])
            if bodies[0] != bodies[1] and frozenset(bodies) not in excluded:
                self.pairs.setdefault((model.body(bodies[0]).name, model.body(bodies[1]).name), []).append((a, b))
        limits = robot.limits(model)
        self.q = np.random.default_rng(0).uniform(limits.lower, limits.upper, (N_POSES, 6))

    def set_configuration(self, q: Floats) -> None:
        """Move the arm to joint angles (6,) [rad]."""
        import mujoco

        self._data.qpos[:] = self._mimic_joints.qpos(q)
        mujoco.mj_kinematics(self.model, self._data)

    def distance(self, pair: tuple[str, str], reach: float) -> float:
        """Measure two links in the present configuration [m], at most `reach`."""
        return min(self.shapes.distance(self._data, a, b, reach) for a, b in self.pairs[pair])

    def is_nearer(self, pair: tuple[str, str], reach: float) -> bool:
        """Return whether two links are nearer than `reach` [m] in the present configuration."""
        measure = self.shapes.distance
        return any(measure(self._data, a, b, reach, any_nearer=True) < reach for a, b in self.pairs[pair])

    def in_contact(self, pair: tuple[str, str]) -> bool:
        """Return whether the triangles of two links touch in the present configuration."""
        measure = self._triangles.distance
        return any(measure(self._data, a, b, 1e-9, any_nearer=True) <= 0 for a, b in self.pairs[pair])

    def elbow_height(self, q: Floats, up: Floats) -> float:
        """Return the height of the third axis along `up` at joint angles (6,) [m]."""
        self.set_configuration(q)
        return float(self._data.joint("A3").xanchor @ up)

    def is_free(self, q: Floats, reduced: Mapping[tuple[str, str], float]) -> bool:
        """Return whether all links are `HOME_DISTANCE` or their reduced clearance [m] apart at joint angles (6,)."""
        self.set_configuration(q)
        required = {pair: min(HOME_DISTANCE, reduced.get(pair, HOME_DISTANCE)) for pair in self.pairs}
        return all(self.distance(pair, HOME_DISTANCE) >= required[pair] for pair in self.pairs)

    def classify(self) -> PairClasses:
        """Classify the pairs by the seeded poses. The result is cached: it takes seconds."""
        file = cache_folder("robots") / f"{self._digest()}.json"
        with contextlib.suppress(OSError, ValueError, TypeError):
            return PairClasses(**json.loads(file.read_text(encoding="utf-8")))
        log.warning("comparing the links of the robot, once for all later runs: this takes seconds to minutes")
        joined, lowest, widest = list(self.pairs), dict.fromkeys(self.pairs, np.inf), dict.fromkeys(self.pairs, 0.0)
        for q in self.q:
            self.set_configuration(q)
            joined = [pair for pair in joined if self.in_contact(pair)]
            lowest |= dict.fromkeys(joined, 0.0)
            for pair in self.pairs:
                if pair in joined:
                    continue
                # A distance between the smallest and the largest one so far changes neither.
                if widest[pair] < _NEAR and not self.is_nearer(pair, widest[pair]):
                    distance = self.distance(pair, _NEAR)
                    lowest[pair], widest[pair] = min(lowest[pair], distance), max(widest[pair], distance)
                elif lowest[pair] > 0:
                    lowest[pair] = min(lowest[pair], self.distance(pair, min(lowest[pair], _NEAR)))
        separate = {
            pair: distance / 2
            for pair, distance in lowest.items()
            if 2 * _LEAST < distance < _NEAR and self._is_separate(pair, distance / 2)
        }
        classes = PairClasses(
            joined=joined,
            separate=[(*pair, distance) for pair, distance in separate.items()],
            reduced=[
                (*pair, distance / 2)
                for pair, distance in widest.items()
                if pair not in joined and pair not in separate and distance < _NEAR
            ],
        )
        with contextlib.suppress(OSError), atomic_write(file) as temporary:
            temporary.write_text(json.dumps(asdict(classes)), encoding="utf-8")
        return classes

    def _is_separate(self, pair: tuple[str, str], distance: float) -> bool:
        one, other = (self.model.body(name).id for name in pair)
        return prove_separation(self.model, self.shapes, one, other, distance)

    def _digest(self) -> str:
        """Hash everything that decides which links touch (SHA-256)."""
        model = self.model
        shapes = (model.mesh_vert, model.mesh_face, model.geom_pos, model.geom_quat, model.geom_size, model.geom_type)
        chain = (model.body_pos, model.body_parentid, model.jnt_axis, model.jnt_range, model.numeric_data)
        arrays = (*shapes, *chain, model.geom_bodyid)
        rule = N_POSES, _NEAR, MAX_CONFIGURATIONS, MAX_AXES, PairClasses.__annotations__
        text = repr((robot.bodies(model), rule)).encode()
        return hashlib.sha256(text + b"".join(np.ascontiguousarray(each).tobytes() for each in arrays)).hexdigest()


_proven: dict[tuple[bytes, tuple[int, int], float], bool] = {}
"""Proofs of this process by arm, pair and distance: the cells of a study, and of a verification, share them."""


def exclude_tool_pairs(
    spec: mujoco.MjSpec, model: mujoco.MjModel, shapes: ShapeDistances, clearance: float, *, by_hand: bool
) -> None:
    """Exclude pairs of bracket and housing with link_4 and link_5 in a specification, or reduce their clearance.

    Excluded is a pair that is proven to be apart at all wrist angles by the clearance [m] or, if that is larger, by
    `_TOOL_DISTANCE`: the mount decides this distance, and a large clearance of the cell must not make every
    configuration a collision. For an arm from a file, two more are excluded: a pair that is proven to keep half of the
    smallest distance on a grid of wrist angles, and the bracket with link_5 if they touch at every angle, because it is
    bolted to the flange. Pairs that are always nearer than the clearance keep half of their largest distance.

    Args:
        spec: arm and tool.
        model: compiled from it.
        shapes: measures the bodies.
        clearance: of the cell [m].
        by_hand: whether the pairs of the arm's links were chosen by hand; then bracket and link_5 are excluded.
    """
    import mujoco

    bodies = [body.name for body in spec.bodies]
    pieces = [name for name in ("housing", "bracket") if name in bodies]
    if by_hand and "bracket" in pieces:
        _exclude(spec, "bolted", "bracket", "link_5")
    content = np.empty(mujoco.mj_sizeModel(model), dtype=np.uint8)
    mujoco.mj_saveModel(model, None, content)
    arm = hashlib.sha256(content.tobytes()).digest()

    def is_separate(pair: tuple[int, int], distance: float) -> bool:
        key = arm, pair, distance
        if key not in _proven:
            _proven[key] = prove_separation(model, shapes, *pair, distance, _TOOL_CONFIGURATIONS)
        return _proven[key]

    for piece, link in itertools.product(pieces, ("link_5", "link_4")):
        pair, bolted = (model.body(piece).id, model.body(link).id), (piece, link) == ("bracket", "link_5")
        if not model.body(link).geomnum[0] or (by_hand and bolted):
            continue
        if is_separate(pair, min(clearance, _TOOL_DISTANCE)):
            _exclude(spec, "apart", piece, link)
        elif not by_hand:
            lowest, widest = _distances_on_wrist_grid(model, shapes, pair, 2 * clearance)
            if bolted and widest <= 0:
                _exclude(spec, "bolted", piece, link)
            elif lowest > 2 * _LEAST and is_separate(pair, lowest / 2):
                _exclude(spec, "apart", piece, link)
            elif widest < 2 * clearance:
                spec.add_numeric(name=robot.clearance_name(model, piece, link), data=[max(widest, 0.0) / 2], size=1)


def _exclude(spec: mujoco.MjSpec, reason: str, piece: str, link: str) -> None:
    spec.add_exclude(name=f"{reason}_{piece}_{link}", bodyname1=piece, bodyname2=link)


def _distances_on_wrist_grid(
    model: mujoco.MjModel, shapes: ShapeDistances, pair: tuple[int, int], reach: float
) -> tuple[float, float]:
    """Return smallest and largest distance of two bodies on a grid of wrist angles [m], at most `reach`."""
    import mujoco

    data, lowest, widest = mujoco.MjData(model), reach, -np.inf
    joints = [model.joint(axis) for axis in ("A5", "A6")]
    grids = [np.arange(max(low, -np.pi), min(high, np.pi), _WRIST_STEP) for low, high in (j.range for j in joints)]
    geoms = [np.flatnonzero(model.geom_bodyid == body).tolist() for body in pair]
    for angles in itertools.product(*grids):
        data.qpos[[int(joint.qposadr[0]) for joint in joints]] = angles
        mujoco.mj_kinematics(model, data)
        distance = min(shapes.distance(data, a, b, reach) for a in geoms[0] for b in geoms[1])
        lowest, widest = min(lowest, distance), max(widest, distance)
    return lowest, widest


def _excluded(model: mujoco.MjModel) -> set[frozenset[int]]:
    """Return the pairs of bodies that a model excludes."""
    return {frozenset((int(signature) >> 16, int(signature) & 0xFFFF)) for signature in model.exclude_signature}


def checked_pairs(model: mujoco.MjModel) -> NDArray[np.int32]:
    """Return the pairs (P, 2) of geoms that `mj_collision` checks: matching classes, not rigid, not excluded."""
    excluded = _excluded(model)
    pairs = []
    for a, b in itertools.combinations(range(model.ngeom), 2):
        match = model.geom_contype[a] & model.geom_conaffinity[b] | model.geom_contype[b] & model.geom_conaffinity[a]
        bodies = int(model.geom_bodyid[a]), int(model.geom_bodyid[b])
        rigid = model.body_weldid[bodies[0]] == model.body_weldid[bodies[1]]
        if match and not rigid and frozenset(bodies) not in excluded:
            pairs.append((a, b))
    return np.array(pairs, dtype=np.int32).reshape(-1, 2)


def motion_refinement(model: mujoco.MjModel, clearance: float, reduced: Mapping[tuple[int, int], float]) -> float:
    """Return by which factor a motion is checked more densely for pairs with a reduced clearance [m].

    Between two checks (`planner.path.certified_edge`) a pair with one moving body comes nearer by less than half the
    clearance, one with two moving bodies by less than the clearance: neither may exceed the pair's own clearance.
    """
    factor = 1.0
    for pair, pair_clearance in reduced.items():
        both_move = (model.body_weldid[model.geom_bodyid[list(pair)]] > 0).all()
        if pair_clearance > 0:  # links that always touch are never free
            factor = max(factor, clearance * (1.0 if both_move else 0.5) / pair_clearance)
    return factor

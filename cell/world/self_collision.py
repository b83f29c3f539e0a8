"""Whether two bodies of an arm keep apart at all angles of the axes between them: proven by branch and bound.

Between the two stand the joints J_1 .. J_n, the first carried by body A, the last carrying body B. From the middle of a
box of angles to anywhere in it joint i turns by at most h_i, and every point beyond it moves by at most h_i times its
distance from the axis. Any of the bodies between may be looked at as the one that stands: where it is the one behind
joint s, A's points move by the joints up to s, B's by those after it, so that the distance of the two changes by at
most

    sum over i <= s of h_i R_Ai + sum over i > s of h_i R_Bi,

for every s. R_Ai is the largest distance of a point of A from axis i at any angles: for the joint that A carries that
of its points; for another what is between the anchors and from the last to the farthest point. A box whose middle is
farther apart than this and what is asked for is settled; another is halved, the one that may come nearest first.
Metres, radians.

What an arm's own triangles say of the pairs of its links: joined, proven apart, or guarded.

Two that touch at every one of `POSES` seeded poses are joined by something that the chain does not show (a closed
bearing, a parallelogram). Two that come near each other and are proven never to touch (`keeps_apart`) need no
guard. Every other pair is guarded, by less than the cell's clearance where the arm's build never lets it have that.

Which pairs of bracket and housing with link_4 and link_5 are guarded, and by how much, by the wrist's build.

Which pairs of shapes of a compiled cell are guarded, and how closely a motion has to be looked at for them.
"""

from __future__ import annotations

import contextlib
import hashlib
import heapq
import itertools
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cell import caches
from cell.robot import model as robot
from cell.robot.model import AXES, MimicJoints, mesh_of
from cell.world.shapes import ShapeDistances, enclosing_points, meshes_of
from planner.geometry.hull import is_convex
from planner.values import Floats

if TYPE_CHECKING:
    import mujoco

    from cell.world.shapes import ShapeDistances


MAX_CONFIGURATIONS = 200_000
"""Configurations looked at before a pair is said not to be proven apart."""

MAX_AXES = 3
"""Axes between two bodies above which a proof is not tried: the boxes that it needs grow with their power."""


def prove_separation(
    model: mujoco.MjModel,
    shapes: ShapeDistances,
    one: int,
    other: int,
    least: float,
    most_looks: int = MAX_CONFIGURATIONS,
) -> bool:
    """Whether two bodies are proven to be at least so far apart at all angles of the axes between them.

    Args:
        model: the arm, alone or in its cell.
        shapes: who measures.
        one: a body.
        other: another.
        least: distance [m], above 0.
        most_looks: after so many configurations it is not proven.
    """
    import mujoco

    axes, moved = axes_between(model, one, other)
    if len(axes) > MAX_AXES or not len(axes):
        return False
    low, high = _ranges(model, axes)
    geoms = [np.flatnonzero(model.geom_bodyid == body).tolist() for body in (one, other)]
    pairs = [(a, b) for a in geoms[0] for b in geoms[1]]
    data, followers, q = mujoco.MjData(model), MimicJoints.from_model(model), np.zeros(len(AXES))
    boxes = [(0.0, 0, (low + high) / 2, (high - low) / 2)]
    for look in range(most_looks):
        if not boxes:
            return True
        _, _, middle, half = heapq.heappop(boxes)
        moves = moved @ half
        way = int(np.argmin(moves))
        q[axes] = middle
        data.qpos[:] = followers.qpos(q)
        mujoco.mj_kinematics(model, data)
        distance = reach = least + float(moves[way])
        for a, b in pairs:
            distance = min(distance, shapes.distance(data, a, b, distance))
        if distance < least:
            return False
        if distance < reach:
            along = int(np.argmax(moved[way] * half))
            half = np.where(np.arange(len(half)) == along, half / 2, half)
            for sign in (-1, 1):
                centre = middle.copy()
                centre[along] += sign * half[along]
                heapq.heappush(boxes, (distance - reach, 2 * look + (sign > 0), centre, half))
    return not boxes


def _ranges(model: mujoco.MjModel, axes: list[int]) -> tuple[Floats, Floats]:
    """Lowest and highest angles (k,) that have to be looked at [rad]: of a range of more than a turn one turn."""
    low, high = np.array([model.joint(AXES[axis]).range for axis in axes]).T.copy()
    followers = MimicJoints.from_model(model)
    for k, axis in enumerate(axes):
        if all(float(ratio).is_integer() for ratio in followers.ratio[followers.axis == axis]):
            high[k] = min(high[k], low[k] + 2 * np.pi)
    return low, high


def axes_between(model: mujoco.MjModel, one: int, other: int) -> tuple[list[int], Floats]:
    """The axes between two bodies, and (n + 1, k) how far one moves against the other for each of them [m/rad].

    A row for each body between the two that may be looked at as the one that stands.
    """
    import mujoco

    data = mujoco.MjData(model)
    data.qpos[:] = 0.0
    mujoco.mj_kinematics(model, data)
    joints = _joints_between(model, one, other)
    if not joints:
        return [], np.zeros((1, 0))
    anchors, lines = data.xanchor[joints], data.xaxis[joints]
    by_other = _farthest(anchors, lines, _points(model, data, other))
    by_one = _farthest(anchors[::-1], lines[::-1], _points(model, data, one))[::-1]
    followers, count = MimicJoints.from_model(model), len(joints)
    driven = [
        (j, 1.0) if j < len(AXES) else (int(followers.axis[j - 6]), float(followers.ratio[j - 6])) for j in joints
    ]
    axes = sorted({axis for axis, _ in driven})
    moved = np.zeros((count + 1, len(axes)))
    for number, (axis, ratio) in enumerate(driven):
        stands_behind = np.arange(count + 1) > number
        moved[:, axes.index(axis)] += abs(ratio) * np.where(stands_behind, by_one[number], by_other[number])
    return axes, moved


def _joints_between(model: mujoco.MjModel, one: int, other: int) -> list[int]:
    """Joints from the first body to the second, in order."""
    up, down = (_joints_above(model, body) for body in (one, other))
    while up and down and up[-1] == down[-1]:
        up.pop()
        down.pop()
    return up + down[::-1]


def _joints_above(model: mujoco.MjModel, body: int) -> list[int]:
    """Joints between a body and the world, nearest first."""
    found: list[int] = []
    while body > 0:
        at = int(model.body_jntadr[body])
        found += range(at, at + int(model.body_jntnum[body])) if at >= 0 else ()
        body = int(model.body_parentid[body])
    return found


def _farthest(anchors: Floats, lines: Floats, points: tuple[Floats, Floats]) -> Floats:
    """(n,) largest distance from each axis of points behind the last of them, at any angles [m].

    Args:
        anchors: (n, 3) of the joints [m].
        lines: (n, 3) their axes.
        points: (P, 3) and how much is about each (P,) [m].
    """
    offset, radius = points[0] - anchors[-1], points[1]
    beyond = float((np.linalg.norm(offset, axis=1) + radius).max())
    found = np.empty(len(anchors))
    found[-1] = (np.linalg.norm(np.cross(offset, lines[-1]), axis=1) + radius).max()
    for i in range(len(anchors) - 2, -1, -1):
        step = anchors[i + 1] - anchors[i]
        found[i] = np.linalg.norm(np.cross(step, lines[i])) + beyond
        beyond += float(np.linalg.norm(step))
    return found


def _points(model: mujoco.MjModel, data: mujoco.MjData, body: int) -> tuple[Floats, Floats]:
    """(P, 3) points of a body where it stands, and how much is about each (P,) [m]."""
    import mujoco

    points, radii = [], []
    for geom in np.flatnonzero(model.geom_bodyid == body).tolist():
        at, radius = enclosing_points(model, data, geom)
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
            at = data.xpos[body] + mesh_of(model, geom).vertices @ data.xmat[body].reshape(3, 3).T
        points.append(at)
        radii.append(np.full(len(at), radius))
    return np.concatenate(points), np.concatenate(radii)


N_POSES = 10_000
"""Seeded poses at which a pair must touch to be excused."""

HOME_DISTANCE = 0.02
"""Distance [m] that a home found for an arm keeps between links at least, as far as they can be."""

_LEAST = 1e-5  # m; a smaller distance is none
_NEAR = 0.02  # m; of two links that come no nearer, or get farther apart, nothing more is asked


@dataclass(frozen=True, slots=True)
class PairClasses:
    """What an arm's own triangles say of its pairs of links.

    Attributes:
        joined: pairs that touch at every seeded pose.
        apart: pairs that come nearer than `_NEAR` and never touch, and how far apart [m] they are proven to be at all
            angles of the axes between them: half of the smallest distance seen.
        keeps: other pairs that are never farther apart than `_NEAR`, and what is guarded between them: half of the
            largest distance seen [m].
    """

    joined: list[tuple[str, str]]
    apart: list[tuple[str, str, float]]
    keeps: list[tuple[str, str, float]]


class LinkPairs:
    """The pairs of links of an arm that can touch each other, and how far they are apart.

    Args:
        model: the robot alone, compiled.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        import mujoco

        self.model, self._data, self._followers = model, mujoco.MjData(model), robot.MimicJoints.from_model(model)
        meshes = meshes_of(model)
        self.shapes = ShapeDistances(model, meshes, [name for name, mesh in meshes.items() if not is_convex(mesh)])
        self._as_triangles = ShapeDistances(model, meshes, list(meshes))
        self.pairs: dict[tuple[str, str], list[tuple[int, int]]] = {}
        excluded = {(int(signature) >> 16, int(signature) & 0xFFFF) for signature in model.exclude_signature}
        for a, b in itertools.combinations(range(model.ngeom), 2):
            bodies = int(model.geom_bodyid[a]), int(model.geom_bodyid[b])
            if bodies[0] != bodies[1] and bodies not in excluded and bodies[::-1] not in excluded:
                self.pairs.setdefault((model.body(bodies[0]).name, model.body(bodies[1]).name), []).append((a, b))
        limits = robot.limits(model)
        self.q = np.random.default_rng(0).uniform(limits.lower, limits.upper, (N_POSES, 6))

    def gap(self, pair: tuple[str, str], reach: float) -> float:
        """Distance of two links where the arm stands [m], `reach` where it is more."""
        return min(self.shapes.distance(self._data, a, b, reach) for a, b in self.pairs[pair])

    def touch(self, pair: tuple[str, str]) -> bool:
        """Whether true triangles of two links touch where the arm stands, whatever their hulls are."""
        apart = self._as_triangles.distance
        return any(apart(self._data, a, b, 1e-9, any_nearer=True) <= 0 for a, b in self.pairs[pair])

    def stand(self, q: Floats) -> None:
        """Put the arm at (6,) joint angles [rad]."""
        import mujoco

        self._data.qpos[:] = self._followers.qpos(q)
        mujoco.mj_kinematics(self.model, self._data)

    def relations(self) -> PairClasses:
        """What the seeded poses say of each pair; looked at once for an arm, which takes seconds."""
        known = caches.folder("robots") / f"{self._digest()}.json"
        with contextlib.suppress(OSError, ValueError, TypeError):
            return PairClasses(**json.loads(known.read_text(encoding="utf-8")))
        joined, lowest, widest = list(self.pairs), dict.fromkeys(self.pairs, np.inf), dict.fromkeys(self.pairs, 0.0)
        for q in self.q:
            self.stand(q)
            joined = [pair for pair in joined if self.touch(pair)]
            lowest |= dict.fromkeys(joined, 0.0)
            for pair in self.pairs:
                if pair not in joined and (lowest[pair] > 0 or widest[pair] < _NEAR):
                    distance = self.gap(pair, _NEAR)
                    lowest[pair], widest[pair] = min(lowest[pair], distance), max(widest[pair], distance)
        apart = {
            pair: least / 2
            for pair, least in lowest.items()
            if 2 * _LEAST < least < _NEAR and self._proven_apart(pair, least / 2)
        }
        found = PairClasses(
            joined=joined,
            apart=[(*pair, least) for pair, least in apart.items()],
            keeps=[
                (*pair, most / 2)
                for pair, most in widest.items()
                if pair not in joined and pair not in apart and most < _NEAR
            ],
        )
        with contextlib.suppress(OSError), caches.whole(known) as place:
            place.write_text(json.dumps(asdict(found)), encoding="utf-8")
        return found

    def _proven_apart(self, pair: tuple[str, str], least: float) -> bool:
        """Whether two links are at least so far apart [m] at all angles of the axes between them."""
        one, other = (self.model.body(name).id for name in pair)
        return prove_separation(self.model, self.shapes, one, other, least)

    def _digest(self) -> str:
        """sha256 of all that says which links touch."""
        model = self.model
        shapes = (model.mesh_vert, model.mesh_face, model.geom_pos, model.geom_quat, model.geom_size, model.geom_type)
        chain = (model.body_pos, model.body_parentid, model.jnt_axis, model.jnt_range, model.numeric_data)
        arrays = (*shapes, *chain, model.geom_bodyid)
        rule = N_POSES, _NEAR, MAX_CONFIGURATIONS, MAX_AXES, PairClasses.__annotations__
        text = repr((robot.bodies(model), rule)).encode()
        return hashlib.sha256(text + b"".join(np.ascontiguousarray(each).tobytes() for each in arrays)).hexdigest()

    def elbow(self, q: Floats, up: Floats) -> float:
        """How high the third axis stands at (6,) joint angles [m], along `up`."""
        self.stand(q)
        return float(self._data.joint("A3").xanchor @ up)

    def apart(self, q: Floats, keeps: Mapping[tuple[str, str], float]) -> bool:
        """Whether no two links are nearer than `OWN`, or than what they keep [m], at (6,) joint angles."""
        self.stand(q)
        return all(
            self.gap(pair, HOME_DISTANCE) >= min(HOME_DISTANCE, keeps.get(pair, HOME_DISTANCE)) for pair in self.pairs
        )


_STEP = np.deg2rad(6.0)
_APART = 0.01  # m
_LOOKS = 20_000  # for a proof, which is made anew for each cell: half a second

_proven: dict[tuple[bytes, tuple[int, int], float], bool] = {}
"""What was proven in this process, by arm, pair and distance: the cells of a study, and of a plan's proof, have one."""


def exclude_tool_pairs(
    spec: mujoco.MjSpec, model: mujoco.MjModel, shapes: ShapeDistances, clearance: float, *, by_hand: bool
) -> None:
    """Enter in a specification which of these pairs are not guarded, and which by less than the clearance.

    Not guarded is a pair that is proven to keep apart at all wrist angles, by the clearance [m] or, where that is
    larger, by `_APART`: what the mount fixes is no collision, and a large clearance to the cell must not make every
    configuration one. Of an arm whose pairs are not chosen by hand neither is one that is proven to keep half of the
    smallest distance seen on a grid of wrist angles, nor the bracket with link_5 where they touch at each: its end on
    the flange. Two that are nearer than the clearance at all of them are guarded by half of the largest distance.

    Args:
        spec: arm and tool.
        model: compiled from it.
        shapes: who measures.
        clearance: of the cell [m].
        by_hand: the arm's file says that the bracket, which turns about its own end, is not guarded against link_5.
    """
    bodies = [body.name for body in spec.bodies]
    pieces = [name for name in ("housing", "bracket") if name in bodies]
    if by_hand and "bracket" in pieces:
        _exclude(spec, "bolted", "bracket", "link_5")
    arm = _digest(model)

    def apart(pair: tuple[int, int], least: float) -> bool:
        key = arm, pair, least
        if key not in _proven:
            _proven[key] = prove_separation(model, shapes, *pair, least, _LOOKS)
        return _proven[key]

    for piece, link in itertools.product(pieces, ("link_5", "link_4")):
        pair, bolted = (model.body(piece).id, model.body(link).id), (piece, link) == ("bracket", "link_5")
        if not model.body(link).geomnum[0] or (by_hand and bolted):
            continue
        if apart(pair, min(clearance, _APART)):
            _exclude(spec, "apart", piece, link)
        elif not by_hand:
            lowest, widest = _seen(model, shapes, pair, 2 * clearance)
            if bolted and widest <= 0:
                _exclude(spec, "bolted", piece, link)
            elif lowest > 2 * _LEAST and apart(pair, lowest / 2):
                _exclude(spec, "apart", piece, link)
            elif widest < 2 * clearance:
                spec.add_numeric(name=robot.clearance_name(model, piece, link), data=[max(widest, 0.0) / 2], size=1)


def _digest(model: mujoco.MjModel) -> bytes:
    """SHA-256 of all that a model holds."""
    import mujoco

    content = np.empty(mujoco.mj_sizeModel(model), dtype=np.uint8)
    mujoco.mj_saveModel(model, None, content)
    return hashlib.sha256(content.tobytes()).digest()


def _exclude(spec: mujoco.MjSpec, why: str, piece: str, link: str) -> None:
    spec.add_exclude(name=f"{why}_{piece}_{link}", bodyname1=piece, bodyname2=link)


def _seen(model: mujoco.MjModel, shapes: ShapeDistances, pair: tuple[int, int], reach: float) -> tuple[float, float]:
    """Smallest and largest distance of two bodies on a grid of wrist angles [m], at most `reach`."""
    import mujoco

    data, lowest, widest = mujoco.MjData(model), reach, -np.inf
    joints = [model.joint(axis) for axis in ("A5", "A6")]
    grids = [np.arange(max(low, -np.pi), min(high, np.pi), _STEP) for low, high in (j.range for j in joints)]
    geoms = [np.flatnonzero(model.geom_bodyid == body).tolist() for body in pair]
    for angles in itertools.product(*grids):
        data.qpos[[int(joint.qposadr[0]) for joint in joints]] = angles
        mujoco.mj_kinematics(model, data)
        apart = min(shapes.distance(data, a, b, reach) for a in geoms[0] for b in geoms[1])
        lowest, widest = min(lowest, apart), max(widest, apart)
    return lowest, widest


def checked_pairs(model: mujoco.MjModel) -> NDArray[np.int32]:
    """(P, 2) the pairs that `mj_collision` looks at: classes meet, not one rigid piece, not excluded."""
    excluded = {(int(signature) >> 16, int(signature) & 0xFFFF) for signature in model.exclude_signature}
    found = []
    for a in range(model.ngeom):
        for b in range(a + 1, model.ngeom):
            meet = model.geom_contype[a] & model.geom_conaffinity[b] | model.geom_contype[b] & model.geom_conaffinity[a]
            bodies = int(model.geom_bodyid[a]), int(model.geom_bodyid[b])
            rigid = model.body_weldid[bodies[0]] == model.body_weldid[bodies[1]]
            if meet and not rigid and bodies not in excluded and bodies[::-1] not in excluded:
                found.append((a, b))
    return np.array(found, dtype=np.int32).reshape(-1, 2)


def motion_refinement(model: mujoco.MjModel, clearance: float, near: Mapping[tuple[int, int], float]) -> float:
    """How many times closer than by the clearance [m] a motion is looked at (`planner.path.certified_edge`).

    There a pair of which one stands may come nearer by less than half the clearance between two looks, one of which
    both move by less than the whole: neither may be more than the pair keeps.
    """
    most = 1.0
    for pair, keep in near.items():
        both = (model.body_weldid[model.geom_bodyid[list(pair)]] > 0).all()
        if keep > 0:  # two that are never apart are never free
            most = max(most, clearance * (1.0 if both else 0.5) / keep)
    return most

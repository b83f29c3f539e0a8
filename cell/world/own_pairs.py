"""What an arm's own triangles say of the pairs of its links: joined, proven apart, or guarded.

Two that touch at every one of `POSES` seeded poses are joined by something that the chain does not show (a closed
bearing, a parallelogram). Two that come near each other and are proven never to touch (`cell.world.apart`) need no
guard. Every other pair is guarded, by less than the cell's clearance where the arm's build never lets it have that.
"""

from __future__ import annotations

import contextlib
import hashlib
import itertools
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np

from cell import caches
from cell.robot import model as robot
from cell.world.apart import LOOKS, MOST_AXES, keeps_apart
from cell.world.gap import Shapes, is_convex, meshes_of
from planner.values import Floats

if TYPE_CHECKING:
    import mujoco

POSES = 10_000
"""Seeded poses at which a pair must touch to be excused."""

OWN = 0.02
"""Distance [m] that a home found for an arm keeps between links at least, as far as they can be."""

_LEAST = 1e-5  # m; a smaller distance is none
_NEAR = 0.02  # m; of two links that come no nearer, or get farther apart, nothing more is asked


@dataclass(frozen=True, slots=True)
class Relations:
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


class OwnPairs:
    """The pairs of links of an arm that can touch each other, and how far they are apart.

    Args:
        model: the robot alone, compiled.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        import mujoco

        self.model, self._data, self._followers = model, mujoco.MjData(model), robot.Followers.of(model)
        meshes = meshes_of(model)
        self.shapes = Shapes(model, meshes, [name for name, mesh in meshes.items() if not is_convex(mesh)])
        self._as_triangles = Shapes(model, meshes, list(meshes))
        self.pairs: dict[tuple[str, str], list[tuple[int, int]]] = {}
        excluded = {(int(signature) >> 16, int(signature) & 0xFFFF) for signature in model.exclude_signature}
        for a, b in itertools.combinations(range(model.ngeom), 2):
            bodies = int(model.geom_bodyid[a]), int(model.geom_bodyid[b])
            if bodies[0] != bodies[1] and bodies not in excluded and bodies[::-1] not in excluded:
                self.pairs.setdefault((model.body(bodies[0]).name, model.body(bodies[1]).name), []).append((a, b))
        limits = robot.limits(model)
        self.q = np.random.default_rng(0).uniform(limits.lower, limits.upper, (POSES, 6))

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

    def relations(self) -> Relations:
        """What the seeded poses say of each pair; looked at once for an arm, which takes seconds."""
        known = caches.folder("robots") / f"{self._digest()}.json"
        with contextlib.suppress(OSError, ValueError, TypeError):
            return Relations(**json.loads(known.read_text(encoding="utf-8")))
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
        found = Relations(
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
        return keeps_apart(self.model, self.shapes, one, other, least)

    def _digest(self) -> str:
        """sha256 of all that says which links touch."""
        model = self.model
        shapes = (model.mesh_vert, model.mesh_face, model.geom_pos, model.geom_quat, model.geom_size, model.geom_type)
        chain = (model.body_pos, model.body_parentid, model.jnt_axis, model.jnt_range, model.numeric_data)
        arrays = (*shapes, *chain, model.geom_bodyid)
        rule = POSES, _NEAR, LOOKS, MOST_AXES, Relations.__annotations__
        text = repr((robot.bodies(model), rule)).encode()
        return hashlib.sha256(text + b"".join(np.ascontiguousarray(each).tobytes() for each in arrays)).hexdigest()

    def elbow(self, q: Floats, up: Floats) -> float:
        """How high the third axis stands at (6,) joint angles [m], along `up`."""
        self.stand(q)
        return float(self._data.joint("A3").xanchor @ up)

    def apart(self, q: Floats, keeps: Mapping[tuple[str, str], float]) -> bool:
        """Whether no two links are nearer than `OWN`, or than what they keep [m], at (6,) joint angles."""
        self.stand(q)
        return all(self.gap(pair, OWN) >= min(OWN, keeps.get(pair, OWN)) for pair in self.pairs)

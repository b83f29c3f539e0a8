"""Collision of arm and scanner with the cell, the part and themselves, on MuJoCo's narrow phase.

Free means: every guarded pair of shapes is at least the clearance apart. Two models of one cell decide it. In the
*grown* one every box is larger by half the clearance and every other shape carries that half as its margin, so whatever
is nearer than the clearance is in contact there: `mj_collision` finds these pairs fast, in one call of C. For each of
them the exact distance (`mj_geomDistance`, GJK) between the true shapes decides. Margins on boxes would not do:
MuJoCo's box-box routine finds every overlap, but overlooks 1 in 200 pairs that are apart by less than a margin, edge to
edge.

Where the part is to be taken as its triangles (`plan.collision = "exact"`), its hull is in both models and only finds
the pairs to look at; the distance from the triangles decides (`planner.geometry.distance`).

What a rotary table turns and what stands have no joint, and `mj_collision` leaves such pairs out: they are looked at
one by one, once for each angle (`cell.world.table`).

So `free`, `contacts` and `distance` agree, and depend on the configuration alone.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cell.world.model import World
from cell.world.table import TableCollision, TablePoses
from cell.world.travel import TravelBound, table_radius
from planner.errors import PlannerError
from planner.ports import ARM_AXES
from planner.values import Floats, Ints

if TYPE_CHECKING:
    import mujoco

DISTANCE_CAP = 0.3
"""Distances are measured up to here [m]; `distance` gives this value, and no name, where everything is farther."""


class MujocoCollisionChecker:
    """A `planner.ports.CollisionChecker` for one placement; it holds an MjData, so use one per thread.

    Args:
        world: the compiled scene; shared, never changed.
        T_base_object: (4, 4) placement [m]; None is the scene's.
    """

    def __init__(self, world: World, T_base_object: ArrayLike | None = None) -> None:
        self._world = world
        self._data: mujoco.MjData = world.data(T_base_object)
        self._grown: mujoco.MjData = world.data(T_base_object, world.inflated)
        model = world.model
        self._travel = TravelBound(model, table_radius(model, self._data, world.table))
        self._turner = TablePoses(self._data, world.table)
        self._pairs = world.pairs
        self._radius = model.geom_rbound[self._pairs].sum(axis=1)
        moves = model.body_weldid[model.geom_bodyid] > 0
        mocap = model.body_mocapid[model.body_rootid[model.geom_bodyid]] >= 0
        self._both_move = (moves & ~mocap)[self._pairs].all(axis=1)
        still = world.data(T_base_object)
        self._turn = TableCollision(model, still, world.table, self._pairs, world.clearance, world.distance)
        self._on_floor = np.flatnonzero(self._pairs[:, 0] == model.geom("floor").id)  # the only shape without a sphere

    @property
    def clearance(self) -> float:
        """Distance [m] that a free configuration keeps from everything it must not touch."""
        return self._world.clearance

    def free(self, q: Floats) -> NDArray[np.bool_]:
        """Whether every guarded pair is at least the clearance apart.

        Args:
            q: (N, axes) joint angles [rad], KUKA signs.

        Returns:
            (N,) True where the configuration is free.
        """
        import mujoco

        q = self._configurations(q)
        angles = self._world.mimic_joints.qpos(q[:, :ARM_AXES])
        model, data = self._world.inflated, self._grown
        kinematics, collision, qpos = mujoco.mj_kinematics, mujoco.mj_collision, data.qpos
        free, put, turned = np.ones(len(angles), dtype=np.bool_), self._turner.put, self._turner.poses(q)
        for i, configuration in enumerate(angles):
            qpos[:] = configuration
            put(data, turned[i])
            kinematics(model, data)
            collision(model, data)
            if data.ncon:
                free[i] = self._clear_after_all()
            free[i] = free[i] and self._turn.clear(q[i])
        return free

    def contacts(self, q: Floats) -> tuple[str, ...]:
        """Names of what is nearer than the clearance at one configuration, nearest first ("housing with part").

        Args:
            q: (axes,) joint angles [rad], KUKA signs.
        """
        return tuple(name for name, _ in self.pairs_within_clearance(q))

    def pairs_within_clearance(self, q: Floats) -> list[tuple[str, float]]:
        """What is nearer than the clearance at one configuration, with its distance, nearest first.

        Args:
            q: (axes,) joint angles [rad], KUKA signs.

        Returns:
            Name of the pair and distance [m], negative in contact; the nearest shapes of each pair.
        """
        self._set(self._configurations(np.asarray(q, dtype=np.float64)[None])[0])
        nearest: dict[str, float] = {}
        for pair in self._candidates(self.clearance)[1]:
            distance = self._gap(pair, self.clearance)
            if distance < self.clearance:
                name = self._world.pair_name(*self._pairs[pair])
                nearest[name] = min(nearest.get(name, np.inf), distance)
        return sorted(nearest.items(), key=lambda item: (item[1], item[0]))

    def distance(self, q: Floats) -> tuple[Floats, tuple[str, ...]]:
        """Smallest distance of any guarded pair, and which pair.

        Args:
            q: (N, axes) joint angles [rad], KUKA signs.

        Returns:
            (N,) distance [m], negative in contact, at most `DISTANCE_CAP`; N names such as "housing with part", empty
            where nothing is nearer than the cap.
        """
        angles = self._configurations(q)
        distances = np.full(len(angles), DISTANCE_CAP)
        names = []
        for i, configuration in enumerate(angles):
            best, distances[i] = self.nearest(configuration, DISTANCE_CAP)
            names.append(self.pair_name(best) if best >= 0 else "")
        return distances, tuple(names)

    def nearest(self, q: Floats, reach: float) -> tuple[int, float]:
        """The nearest guarded pair at one configuration.

        Args:
            q: (axes,) joint angles [rad], KUKA signs.
            reach: nothing beyond is looked for [m].

        Returns:
            Number of the pair and its distance [m]; -1 and `reach` where everything is farther.
        """
        self._set(self._configurations(np.asarray(q, dtype=np.float64)[None])[0])
        best, distance = -1, reach
        for bound, pair in zip(*self._candidates(reach), strict=True):
            if bound >= distance:
                break
            measured = self._gap(pair, distance)
            if measured < distance:
                best, distance = int(pair), measured
        return best, distance

    def nearest_by_kind(self, q: Floats, reach: float) -> tuple[tuple[int, float], tuple[int, float]]:
        """The same for the pairs of a moving and a standing body, and for those of two moving ones.

        Args:
            q: (axes,) joint angles [rad], KUKA signs.
            reach: nothing beyond is looked for [m].
        """
        self._set(self._configurations(np.asarray(q, dtype=np.float64)[None])[0])
        best, distance = [-1, -1], [reach, reach]
        for bound, pair in zip(*self._candidates(reach), strict=True):
            kind = int(self._both_move[pair])
            if bound < distance[kind]:
                measured = self._gap(pair, distance[kind])
                if measured < distance[kind]:
                    best[kind], distance[kind] = int(pair), measured
            elif bound >= distance[1 - kind]:
                break
        return (best[0], distance[0]), (best[1], distance[1])

    def pair_name(self, pair: int) -> str:
        """What a reader calls a guarded pair: "housing with part"."""
        return self._world.pair_name(*self._pairs[pair])

    def nearest_points(self, q: Floats, pair: int) -> Floats:
        """(2, 3) the nearest points of a guarded pair at one configuration (axes,), as `pair_name` orders them [m]."""
        self._set(self._configurations(np.asarray(q, dtype=np.float64)[None])[0])
        a, b = (int(geom) for geom in self._pairs[pair])
        points = np.zeros((2, 3))
        self._world.distance(self._data, a, b, 10.0, points=points)
        return points if self._world.pair_name(a, b).startswith(self._world.entities[a] + " with ") else points[::-1]

    def travel(self, q_from: Floats, q_to: Floats) -> Floats:
        """An upper bound on how far any point of arm or tool moves along the straight joint segment, beside the part.

        Where a table turns the part, what the arm and what the part move in base are added: no distance between the
        two, and none from what stands, changes by more.

        Args:
            q_from: (N, axes) [rad].
            q_to: (N, axes) [rad].

        Returns:
            (N,) length [m], never smaller than the true displacement; see `cell.world.travel`. Longer where two links
            that can touch are guarded by less than the clearance, so that what is certified by it is so for them too.
        """
        return self._world.refinement * self._travel(self._configurations(q_from), self._configurations(q_to))

    def _configurations(self, q: ArrayLike) -> Floats:
        angles, axes = np.asarray(q, dtype=np.float64), len(self._world.home)
        if angles.ndim != 2 or angles.shape[1] != axes:
            raise PlannerError(f"q has shape {angles.shape}; it must be (N, {axes}) joint angles in rad")
        if not np.isfinite(angles).all():
            raise PlannerError("q holds a value that is not finite; every joint angle must be a number in rad")
        return angles

    def _set(self, configuration: Floats) -> None:
        """The state at (axes,) joint angles."""
        import mujoco

        self._data.qpos[:] = self._world.mimic_joints.qpos(configuration[:ARM_AXES])
        self._turner(self._data, configuration)
        mujoco.mj_kinematics(self._world.model, self._data)

    def _set_as_grown(self) -> None:
        """The state as that of the grown model."""
        import mujoco

        data, grown = self._data, self._grown
        data.qpos[:], data.mocap_pos[:], data.mocap_quat[:] = grown.qpos, grown.mocap_pos, grown.mocap_quat
        mujoco.mj_kinematics(self._world.model, data)

    def _gap(self, pair: int, reach: float) -> float:
        """Distance of a guarded pair at the present configuration [m], `reach` where it is more."""
        a, b = self._pairs[pair]
        return self._world.distance(self._data, int(a), int(b), reach)

    def _clear_after_all(self) -> bool:
        """Whether all pairs that touch in the grown model are at least the clearance apart in the true one."""
        self._set_as_grown()
        touching = dict.fromkeys(map(tuple, self._grown.contact.geom.tolist()))
        world, data, least = self._world, self._data, self.clearance
        return all(world.distance(data, a, b, least, any_nearer=True) >= least for a, b in touching)

    def _candidates(self, reach: float) -> tuple[Floats, Ints]:
        """Guarded pairs whose bounding spheres are nearer than `reach`, nearest first, and those lower bounds [m]."""
        position = self._data.geom_xpos
        first, second = position[self._pairs[:, 0]], position[self._pairs[:, 1]]
        lower = np.linalg.norm(first - second, axis=1) - self._radius
        floor = self._on_floor
        lower[floor] = (second - first)[floor, 2] - self._radius[floor]
        near = np.flatnonzero(lower < reach)
        order = near[np.argsort(lower[near], kind="stable")]
        return lower[order], order

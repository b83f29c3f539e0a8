"""Collision of arm and scanner with the cell, the part and themselves, with MuJoCo's narrow phase.

A configuration is free if every checked pair of shapes is at least the clearance apart. Two models of one cell decide
it. In the *inflated* model every box is larger by half the clearance and every other shape has that half as its margin,
so that any pair nearer than the clearance is in contact: one call of `mj_collision` finds these pairs. For each of them
the exact distance (`mj_geomDistance`, GJK) of the true shapes decides. Margins on boxes are no alternative: MuJoCo's
box-box routine finds every overlap, but misses 1 in 200 pairs that are nearer than their margin, edge to edge.

With `plan.collision = "exact"` both models hold the hulls of part and mesh fixtures only to find candidate pairs; the
distance from the triangles decides (`planner.geometry.distance`).

`mj_collision` skips pairs of bodies without joints. For such pairs, of the turned part and its surroundings, each table
angle is checked once (`cell.world.table`).

So `free`, `contacts` and `distance` agree, and depend on the configuration alone.
"""

from __future__ import annotations

from functools import cached_property
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
"""Largest distance that is measured [m]; `distance` returns it, without a name, where everything is farther."""


class MujocoCollisionChecker:
    """A `planner.ports.CollisionChecker` for one placement. It holds an MjData: use one instance per thread.

    Args:
        world: the compiled scene; shared, never changed.
        T_base_object: (4, 4) placement [m]; None is the scene's.
    """

    def __init__(self, world: World, T_base_object: ArrayLike | None = None) -> None:
        self._world = world
        self._data: mujoco.MjData = world.data(T_base_object)
        self._inflated: mujoco.MjData = world.data(T_base_object, world.inflated)
        model = world.model
        self._turned = TablePoses(self._data, world.table)
        self._pairs = world.pairs
        self._radius = model.geom_rbound[self._pairs].sum(axis=1)
        moves = model.body_weldid[model.geom_bodyid] > 0
        mocap = model.body_mocapid[model.body_rootid[model.geom_bodyid]] >= 0
        self._both_move = (moves & ~mocap)[self._pairs].all(axis=1)
        at_zero = self._data if world.table is None else world.data(T_base_object)
        self._table = TableCollision(model, at_zero, world.table, self._pairs, world.clearance, world.distance)
        self._table_radius = table_radius(model, at_zero, world.table)
        self._on_floor = np.flatnonzero(self._pairs[:, 0] == model.geom("floor").id)  # the only shape without a sphere

    @cached_property
    def _travel(self) -> TravelBound:
        return TravelBound(self._world.model, self._table_radius)

    @property
    def clearance(self) -> float:
        """Distance [m] that a free configuration keeps."""
        return self._world.clearance

    def free(self, q: Floats) -> NDArray[np.bool_]:
        """Return whether every checked pair is at least the clearance apart.

        Args:
            q: (N, axes) joint angles [rad], KUKA signs.

        Returns:
            (N,) True where the configuration is free.
        """
        import mujoco

        q = self._configurations(q)
        angles = self._world.mimic_joints.qpos(q[:, :ARM_AXES])
        model, data = self._world.inflated, self._inflated
        kinematics, collision, qpos = mujoco.mj_kinematics, mujoco.mj_collision, data.qpos
        free, set_poses, poses = np.ones(len(angles), dtype=np.bool_), self._turned.set_poses, self._turned.poses(q)
        for i, configuration in enumerate(angles):
            qpos[:] = configuration
            set_poses(data, poses[i])
            kinematics(model, data)
            collision(model, data)
            if data.ncon:
                free[i] = self._contacts_are_clear()
            free[i] = free[i] and self._table.is_clear(q[i])
        return free

    def contacts(self, q: Floats) -> tuple[str, ...]:
        """Return the names of the pairs nearer than the clearance at joint angles (axes,) [rad], nearest first."""
        return tuple(name for name, _ in self.pairs_within_clearance(q))

    def pairs_within_clearance(self, q: Floats) -> list[tuple[str, float]]:
        """Return name and distance [m] of the pairs nearer than the clearance, nearest first; negative in contact.

        Args:
            q: (axes,) joint angles [rad], KUKA signs.
        """
        self._set(self._configurations(np.asarray(q, dtype=np.float64)[None])[0])
        nearest: dict[str, float] = {}
        for pair in self._candidates(self.clearance)[1]:
            distance = self._distance(pair, self.clearance)
            if distance < self.clearance:
                name = self._world.pair_name(*self._pairs[pair])
                nearest[name] = min(nearest.get(name, np.inf), distance)
        return sorted(nearest.items(), key=lambda item: (item[1], item[0]))

    def distance(self, q: Floats) -> tuple[Floats, tuple[str, ...]]:
        """Return the smallest distance of any checked pair, and the pair.

        Args:
            q: (N, axes) joint angles [rad], KUKA signs.

        Returns:
            (N,) distance [m], negative in contact, at most `DISTANCE_CAP`; N names such as "housing with part", ""
            where nothing is nearer.
        """
        angles = self._configurations(q)
        distances = np.full(len(angles), DISTANCE_CAP)
        names = []
        for i, configuration in enumerate(angles):
            best, distances[i] = self.nearest(configuration, DISTANCE_CAP)
            names.append(self.pair_name(best) if best >= 0 else "")
        return distances, tuple(names)

    def nearest(self, q: Floats, reach: float) -> tuple[int, float]:
        """Find the nearest checked pair at joint angles (axes,) [rad].

        Returns:
            Number of the pair and its distance [m]; -1 and `reach` where every pair is farther than `reach` [m].
        """
        self._set(self._configurations(np.asarray(q, dtype=np.float64)[None])[0])
        best, distance = -1, reach
        for bound, pair in zip(*self._candidates(reach), strict=True):
            if bound >= distance:
                break
            measured = self._distance(pair, distance)
            if measured < distance:
                best, distance = int(pair), measured
        return best, distance

    def nearest_by_kind(self, q: Floats, reach: float) -> tuple[tuple[int, float], tuple[int, float]]:
        """Find the nearest pair of a moving and a stationary body, and that of two moving bodies, each as `nearest`."""
        self._set(self._configurations(np.asarray(q, dtype=np.float64)[None])[0])
        best, distance = [-1, -1], [reach, reach]
        for bound, pair in zip(*self._candidates(reach), strict=True):
            kind = int(self._both_move[pair])
            if bound < distance[kind]:
                measured = self._distance(pair, distance[kind])
                if measured < distance[kind]:
                    best[kind], distance[kind] = int(pair), measured
            elif bound >= distance[1 - kind]:
                break
        return (best[0], distance[0]), (best[1], distance[1])

    def pair_name(self, pair: int) -> str:
        """Return the name of a checked pair in reports: "housing with part"."""
        return self._world.pair_name(*self._pairs[pair])

    def nearest_points(self, q: Floats, pair: int) -> Floats:
        """Return the nearest points (2, 3) of a checked pair at joint angles (axes,), ordered as `pair_name` [m]."""
        self._set(self._configurations(np.asarray(q, dtype=np.float64)[None])[0])
        a, b = (int(geom) for geom in self._pairs[pair])
        points = np.zeros((2, 3))
        self._world.distance(self._data, a, b, 10.0, points=points)
        return points if self._world.pair_name(a, b).startswith(self._world.entities[a] + " with ") else points[::-1]

    def travel(self, q_from: Floats, q_to: Floats) -> Floats:
        """Bound the displacement of any point of arm or tool along straight joint segments, relative to the part.

        With a rotary table the displacements of arm and part are added: no distance between the two, and none to the
        surroundings, changes by more.

        Args:
            q_from: (N, axes) [rad].
            q_to: (N, axes) [rad].

        Returns:
            (N,) upper bounds [m] (`cell.world.travel`), enlarged if links have a reduced clearance: a segment that is
            certified by them is then certified for these links too.
        """
        return self._world.refinement * self._travel(self._configurations(q_from), self._configurations(q_to))

    def _configurations(self, q: ArrayLike) -> Floats:
        angles, axes = np.asarray(q, dtype=np.float64), len(self._world.home)
        if angles.ndim != 2 or angles.shape[1] != axes:
            raise PlannerError(f"q has shape {angles.shape}; it must be (N, {axes}) joint angles in rad")
        if not np.isfinite(angles).all():
            raise PlannerError("q has a value that is not finite; every joint angle must be a number in rad")
        return angles

    def _set(self, configuration: Floats) -> None:
        """Set the state to joint angles (axes,)."""
        import mujoco

        self._data.qpos[:] = self._world.mimic_joints.qpos(configuration[:ARM_AXES])
        self._turned.set_configuration(self._data, configuration)
        mujoco.mj_kinematics(self._world.model, self._data)

    def _distance(self, pair: int, reach: float) -> float:
        """Measure a checked pair in the present state [m], at most `reach`."""
        a, b = self._pairs[pair]
        return self._world.distance(self._data, int(a), int(b), reach)

    def _contacts_are_clear(self) -> bool:
        """Return whether all pairs in contact in the inflated model are clear in the true one."""
        import mujoco

        world, data, inflated, clearance = self._world, self._data, self._inflated, self.clearance
        data.qpos[:], data.mocap_pos[:], data.mocap_quat[:] = inflated.qpos, inflated.mocap_pos, inflated.mocap_quat
        mujoco.mj_kinematics(world.model, data)
        touching = dict.fromkeys(map(tuple, inflated.contact.geom.tolist()))
        return all(world.distance(data, a, b, clearance, any_nearer=True) >= clearance for a, b in touching)

    def _candidates(self, reach: float) -> tuple[Floats, Ints]:
        """Return lower bounds [m] and numbers of the pairs whose bounding spheres are nearer than `reach`, sorted."""
        position = self._data.geom_xpos
        first, second = position[self._pairs[:, 0]], position[self._pairs[:, 1]]
        lower = np.linalg.norm(first - second, axis=1) - self._radius
        floor = self._on_floor
        lower[floor] = (second - first)[floor, 2] - self._radius[floor]
        near = np.flatnonzero(lower < reach)
        order = near[np.argsort(lower[near], kind="stable")]
        return lower[order], order

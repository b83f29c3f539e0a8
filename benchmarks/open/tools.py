"""Instances in the terms of the planner: scanner, casters, candidates, allowed poses. Lengths in metres here."""

import json
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.open import check
from benchmarks.open.check import Array, Instance
from cell.scanners.laser_area import LaserArea
from cell.world.embree import EmbreeRayCaster
from planner.geometry.decimation import decimate
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples, draw_samples
from planner.kinematics.fit import ArmKinematics, Chain
from planner.measurability.visibility import find_measured
from planner.ports import JointLimits
from planner.viewpoints import growth
from planner.viewpoints.lines_of_sight import RayTargets
from planner.viewpoints.viewpoints import aim_viewpoints

HERE = check.HERE
N_PLANNING_FACES = 150
N_THINNED = 4000  # samples on which candidates are thinned out


def scanner_of(sensor: dict[str, Any]) -> LaserArea:
    """Return a sensor model of the benchmark as the planner's scanner."""
    fov = sensor["sensor_fov_deg"]
    return LaserArea(
        fov_deg=tuple(sensor["fov_deg"]), range_mm=tuple(sensor["range_mm"]), baseline_mm=sensor["baseline_mm"],
        grazing_max_deg=sensor["incidence_max_deg"], sensor_grazing_max_deg=sensor["sensor_incidence_max_deg"],
        sensor_fov_deg=None if fov is None else tuple(fov),
        sensor_tilt_deg=None if fov is None else sensor["sensor_tilt_deg"],
        depth_of_field_mm=None if sensor["depth_mm"] is None else tuple(sensor["depth_mm"]),
        resolution_deg=(1.0, 1.0),
    )  # fmt: skip


def in_metres(poses: Array) -> Array:
    """Return poses (n, 3, 4) [mm] as (n, 4, 4) [m]."""
    T = np.tile(np.eye(4), (len(poses), 1, 1))
    T[:, :3] = poses
    T[:, :3, 3] /= 1000
    return T


def in_millimetres(T: Array) -> Array:
    """Return poses (n, 4, 4) [m] as (n, 3, 4) [mm] with exactly rigid rotations."""
    poses = np.array(T[:, :3])
    u, _, v = np.linalg.svd(poses[:, :, :3])
    poses[:, :, :3] = u @ v
    poses[:, :, 3] *= 1000
    return np.round(poses, 9)


class Bench:
    """An instance with the planner's objects: part, planning faces, scanner, casters, allowed poses."""

    def __init__(self, instance: Instance) -> None:
        self.instance, self.scanner = instance, scanner_of(instance.sensor)
        triangles = instance.surface.triangles / 1000
        vertices, faces = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
        self.part = TriangleMesh(vertices, faces.reshape(-1, 3).astype(np.int32))
        self.planning = decimate(self.part, N_PLANNING_FACES)
        self.casters = [EmbreeRayCaster(vertices, self.part.faces)]
        hidden_by = instance.surface.all[len(triangles) :]
        if len(hidden_by):
            corners = hidden_by.reshape(-1, 3) / 1000
            self.casters.append(EmbreeRayCaster(corners, np.arange(len(corners)).reshape(-1, 3)))
        self.kinematics = arm_kinematics(instance.arm) if "arm" in instance.data else None

    def samples(self, count: int, seed: int) -> SurfaceSamples:
        """Draw samples of the part."""
        return draw_samples(self.part, self.planning, count, np.random.default_rng([seed, 17]))

    def is_allowed(self, T: Array) -> Array:
        """Return (n,) whether poses (n, 4, 4) keep the clearance and, in tier B, are reached."""
        surface, margin = self.instance.surface, self.instance.data["clearance_mm"] + 1e-3
        found = np.ones(len(T), dtype=bool)
        for at in (T[:, :3, 3], T[:, :3, 3] + self.scanner.baseline_mm / 1000 * T[:, :3, 0]):
            found &= ((1000 * at < surface.low - margin) | (1000 * at > surface.high + margin)).any(axis=1)
        if self.kinematics is not None:
            pose, _ = self.configurations(T[found])
            found[np.flatnonzero(found)[np.setdiff1d(np.arange(int(found.sum())), pose)]] = False
        return found

    def configurations(self, T: Array) -> tuple[Array, Array]:
        """Return all allowed configurations (m, 6) of poses (n, 4, 4), with the (m,) number of the pose of each."""
        assert self.kinematics is not None
        T_base_part = in_metres(np.asarray(self.instance.data["T_base_part"])[None])[0]
        q = self.kinematics.inverse(T_base_part @ T)
        pose, q = np.repeat(np.arange(len(T)), q.shape[1]), q.reshape(-1, q.shape[2])
        arm = self.instance.arm
        with np.errstate(invalid="ignore"):
            good = np.flatnonzero(((q > arm.limits[:, 0] + 1e-6) & (q < arm.limits[:, 1] - 1e-6)).all(axis=1))
        good = good[arm.clearance(q[good], self.instance.keep_out) > 1e-3]
        return pose[good], q[good]

    def configure(self, poses: Array) -> Array:
        """Return an allowed configuration (n, 6) of each of poses (n, 3, 4) [mm], the one nearest to home."""
        pose, q = self.configurations(in_metres(poses))
        order = np.lexsort([np.abs(q - np.asarray(self.instance.data["home"])).max(axis=1), pose])
        first = order[np.unique(pose[order], return_index=True)[1]]
        if len(first) < len(poses):
            raise check.CheckError("a pose is not reached")
        return q[first]

    def evaluator(self) -> growth.ViewEvaluator:
        """Return the evaluator of views at all allowed poses."""
        return growth.ViewEvaluator(self.scanner, self.casters, lambda T: self.is_allowed(T[:, 0]), np.eye(4)[None])

    def measured(self, T: Array, samples: SurfaceSamples) -> Array:
        """Return (n, S) whether each pose measures each sample, by the planner."""
        return find_measured(T[:, None], samples, self.scanner, self.casters, each=True).T

    def candidates(self, seed: int, limit: int = 1000) -> Array:
        """Return candidates (n, 4, 4): over planning faces, tilted, and grown for all that these do not measure."""
        rng = np.random.default_rng([seed, 3])
        sensor = self.instance.sensor
        near, far = (value / 1000 for value in (sensor["depth_mm"] or sensor["range_mm"]))
        standoffs = [near + share * (far - near) for share in (0.35, 0.65)]
        centres, normals = self.planning.centres, self.planning.normals
        views = [aim_viewpoints(centres, normals, np.arange(len(centres)), standoffs, [0.0, np.pi / 2])]
        for _ in range(3):
            tilted = normals + 0.6 * rng.standard_normal(normals.shape)
            tilted /= np.linalg.norm(tilted, axis=1, keepdims=True)
            rolls = [rng.uniform(0, 2 * np.pi)]
            views.append(aim_viewpoints(centres, tilted, np.arange(len(centres)), standoffs, rolls))
        T = np.concatenate([view.T_object_scanner[:, 0] for view in views])
        T = T[self.is_allowed(T)]
        scouts = self.samples(growth.N_SCOUTS, seed)
        T = T[_thinned(self.measured(T, self.samples(N_THINNED, seed + 1)), limit, rng)]
        measured = find_measured(T[:, None], scouts, self.scanner, self.casters)
        grown = growth.grow(RayTargets.of(scouts.points, scouts.normals), measured, self.evaluator())
        return np.concatenate([T, grown.T_object_scanner])


def arm_kinematics(arm: check.Arm) -> ArmKinematics:
    """Return the planner's kinematics of an arm; its flange is the frame of the sensor."""
    frames = [T[0] for T in arm.frames(np.zeros((1, len(arm.limits))))[1:]]
    moving = [
        (T[:3, :3] @ axis, T[:3, 3] / 1000) for T, (_, axis) in zip(frames, arm.joints, strict=True) if axis is not None
    ]
    chain = Chain(
        np.array([d for d, _ in moving]), np.array([p for _, p in moving]), in_metres(frames[-1][None, :3])[0]
    )
    none = np.full(len(arm.limits), np.inf)
    return ArmKinematics(chain, JointLimits(arm.limits[:, 0], arm.limits[:, 1], arm.speed, none))


def _thinned(measured: Array, limit: int, rng: np.random.Generator) -> Array:
    """Return at most `limit` candidates: repeated greedy covers first, random ones after them."""
    left, chosen = np.arange(len(measured)), []
    while len(chosen) < limit // 2 and len(left):
        open_rows = measured[left].any(axis=0)
        cover = []
        while open_rows.any():
            gains = measured[left][:, open_rows].sum(axis=1)
            best = int(gains.argmax())
            if gains[best] == 0:
                break
            cover.append(left[best])
            open_rows &= ~measured[left[best]]
        if not cover:
            break
        chosen += cover
        left = np.setdiff1d(left, cover)
    chosen += rng.permutation(left)[: max(0, limit - len(chosen))].tolist()
    return np.sort(np.array(chosen[:limit]))


@lru_cache(maxsize=2)
def bench_of(name: str) -> Bench:
    """Return the bench of an instance by name."""
    return Bench(check.load(name))


def matrix_of(instance: Instance) -> Array:
    """Return (S, V) the matrix of an instance from its file."""
    shape = len(instance.arrays["points"]), len(instance.arrays["poses"])
    bits = instance.arrays["matrix"]
    return np.unpackbits(bits, axis=1, count=shape[1]).astype(bool)


def write_json(path: Path, content: Any) -> None:
    """Write JSON with a line for each top-level entry."""
    path.write_text(json.dumps(content, indent=1) + "\n")

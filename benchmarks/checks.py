"""Visible coverage of a run folder, measured again from its files with other samples, rays and conditions."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import trimesh

_SAMPLES = 100_000


def independent_visible(run: Path, seed: int) -> float:
    """Return the share of 10^5 independent samples of `reference.ply` that the views of `plan.json` measure.

    Args:
        run: a finished run folder.
        seed: seed of the samples.
    """
    part = trimesh.load(run / "reference.ply", process=False)
    points, face = trimesh.sample.sample_surface(part, _SAMPLES, seed=seed)
    views = json.loads((run / "plan.json").read_text())["views"]
    poses, law = np.array([view["T_object_scanner"] for view in views]), _law(run)
    seen = np.zeros(len(points), dtype=bool)
    for T in poses:
        rows = np.flatnonzero(~seen)
        seen[rows] = law(T, points[rows] / 1000, part.face_normals[face[rows]])
    return float(seen.mean())


def independently_measured(run: Path, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Return (S, n): sample measured by view of `plan.json`; points [m] and outward normals (S, 3), object frame."""
    views, law = json.loads((run / "plan.json").read_text())["views"], _law(run)
    return np.stack([law(np.array(view["T_object_scanner"]), points, normals) for view in views], axis=1)


def _law(run: Path) -> Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
    """Return a function of pose (4, 4), samples [m] and outward normals: which samples are measured, object frame.

    Only the files are read. Rays are cast with trimesh's Embree interface; fixtures, post, pedestal and floor are
    rebuilt from `scene.resolved.json`.
    """
    scene = json.loads((run / "scene.resolved.json").read_text())
    part = trimesh.load(run / "reference.ply", process=False)
    part.apply_scale(1e-3)
    T_object_base = np.linalg.inv(np.array(scene["T_base_object"]))
    blockers = [part, *(mesh for entry in scene["fixtures"] if (mesh := _mesh(entry, T_object_base)) is not None)]
    everything = trimesh.util.concatenate(blockers)
    scanner = scene["scanner"]
    half = np.radians(scanner["fov_deg"]) / 2
    near, far = np.array(scanner["range_mm"]) / 1000
    gap = 5e-6 * float(np.linalg.norm(part.extents)) + 2e-6

    def measured(T: np.ndarray, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        local = (points - T[:3, 3]) @ T[:3, :3]
        distance = np.linalg.norm(local, axis=1)
        fits = (local[:, 2] > 0) & (distance >= near) & (distance <= far)
        fits &= (np.abs(np.arctan2(local[:, :2], local[:, 2:])) <= half).all(axis=1)
        sensor = (T @ [scanner["baseline_mm"] / 1000, 0, 0, 1])[:3]
        for origin, limit in ((T[:3, 3], scanner["grazing_max_deg"]), (sensor, scanner["sensor_grazing_max_deg"])):
            towards = origin - points
            cosine = np.einsum("ij,ij->i", towards, normals) / np.linalg.norm(towards, axis=1)
            fits &= cosine >= np.cos(np.radians(limit))
        rows = np.flatnonzero(fits)
        for origin in (T[:3, 3], sensor):
            rows = rows[_free(everything, origin, points[rows], gap)]
        found = np.zeros(len(points), dtype=bool)
        found[rows] = True
        return found

    return measured


def _free(mesh: trimesh.Trimesh, origin: np.ndarray, targets: np.ndarray, gap: float) -> np.ndarray:
    if not len(targets):
        return np.zeros(0, dtype=bool)
    towards = targets - origin
    distance = np.linalg.norm(towards, axis=1)
    hits, ray, _ = mesh.ray.intersects_location(
        np.broadcast_to(origin, towards.shape), towards / distance[:, None], multiple_hits=False
    )
    first = np.full(len(targets), np.inf)
    first[ray] = np.linalg.norm(hits - origin, axis=1)
    return first >= distance - gap


def _mesh(entry: dict, T_object_base: np.ndarray) -> trimesh.Trimesh | None:
    if not entry["occludes"] or entry["shape"] == "mesh":
        return None
    size = np.array(entry["size_mm"]) / 1000
    if entry["shape"] == "box":
        mesh = trimesh.creation.box(size)
    elif entry["shape"] == "cylinder":
        mesh = trimesh.creation.cylinder(size[0] / 2, size[1], sections=64)
    else:
        mesh = trimesh.creation.box([20.0, 20.0, 1e-3])
    T = np.array(entry["pose"])
    mesh.apply_transform(T if entry["attached_to"] == "object" else T_object_base @ T)
    return mesh

"""Visible coverage of a run folder measured again from its files: other samples, trimesh's rays, own conditions."""

import json
from pathlib import Path

import numpy as np
import trimesh

_SAMPLES = 100_000


def independent_visible(run: Path, seed: int) -> float:
    """Share of 10^5 independent area-weighted samples of `reference.ply` that the views of `plan.json` measure.

    Only the files are read. Rays go through trimesh's Embree interface; fixtures, post, pedestal and floor are rebuilt
    from `scene.resolved.json`.

    Args:
        run: a finished run folder.
        seed: of the samples.
    """
    scene = json.loads((run / "scene.resolved.json").read_text())
    views = json.loads((run / "plan.json").read_text())["views"]
    part = trimesh.load(run / "reference.ply", process=False)
    part.apply_scale(1e-3)
    points, face = trimesh.sample.sample_surface(part, _SAMPLES, seed=seed)
    normals = part.face_normals[face]
    T_object_base = np.linalg.inv(np.array(scene["T_base_object"]))
    blockers = [part, *(mesh for entry in scene["fixtures"] if (mesh := _mesh(entry, T_object_base)) is not None)]
    everything = trimesh.util.concatenate(blockers)
    scanner = scene["scanner"]
    half = np.radians(scanner["fov_deg"]) / 2
    near, far = np.array(scanner["range_mm"]) / 1000
    gap = 5e-6 * float(np.linalg.norm(part.extents)) + 2e-6
    seen = np.zeros(len(points), dtype=bool)
    for view in views:
        T = np.array(view["T_object_scanner"])
        local = (points - T[:3, 3]) @ T[:3, :3]
        distance = np.linalg.norm(local, axis=1)
        fits = (local[:, 2] > 0) & (distance >= near) & (distance <= far) & ~seen
        fits &= (np.abs(np.arctan2(local[:, :2], local[:, 2:])) <= half).all(axis=1)
        sensor = (T @ [scanner["baseline_mm"] / 1000, 0, 0, 1])[:3]
        for origin, limit in ((T[:3, 3], scanner["grazing_max_deg"]), (sensor, scanner["sensor_grazing_max_deg"])):
            towards = origin - points
            cosine = np.einsum("ij,ij->i", towards, normals) / np.linalg.norm(towards, axis=1)
            fits &= cosine >= np.cos(np.radians(limit))
        rows = np.flatnonzero(fits)
        for origin in (T[:3, 3], sensor):
            rows = rows[_free(everything, origin, points[rows], gap)]
        seen[rows] = True
    return float(seen.mean())


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

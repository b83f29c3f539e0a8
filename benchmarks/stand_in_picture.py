"""The picture of the six built-in parts, ray traced."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from benchmarks.part_models.build import PART_MODELS
from cell.part import builtin
from cell.world.embree import EmbreeRayCaster

# Direction to the viewer (object frame), up direction, and size of a pixel as a share of the diagonal.
VIEWS = {
    "mseke": ((-0.55, -1.0, 0.25), (0, 0, 1)),
    "mug": ((0.6, -1.0, 0.75), (0, 0, 1)),
    "robinet": ((0.55, 1.0, 0.55), (0, 0, 1)),
    "petanque": ((0.25, 0.2, 1.0), (0, 1, 0)),
    "humerus": ((0.3, -0.3, 1.0), (0, 1, 0)),
    "st-jean": ((-0.35, 0.15, 1.0), (0, 1, 0)),
}
PIXELS = 520
Floats = NDArray[np.float64]


def shade(name: str) -> Floats:
    """Return a (PIXELS, PIXELS, 3) picture of a part: parallel view, one light with shadows, weak frontal light."""
    mesh = builtin.load(name)
    caster = EmbreeRayCaster(mesh.vertices, mesh.faces)
    towards, up = (np.array(v, float) for v in VIEWS[name])
    towards /= np.linalg.norm(towards)
    right = np.cross(up, towards)
    right /= np.linalg.norm(right)
    up = np.cross(towards, right)
    centre = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
    flat = (mesh.vertices - centre) @ np.stack([right, up]).T
    middle, half = (flat.min(axis=0) + flat.max(axis=0)) / 2, np.ptp(flat, axis=0).max() * 0.53
    size = 2 * float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))

    n = 2 * PIXELS  # four rays per pixel
    grid = (np.arange(n) + 0.5) / n * 2 - 1
    u, v = (axis.ravel() * half for axis in np.meshgrid(grid, -grid))
    origins = centre + (middle[0] + u)[:, None] * right + (middle[1] + v)[:, None] * up + size * towards
    hits = caster.first_hit(origins, np.broadcast_to(-towards, origins.shape).copy())
    seen = hits.face >= 0
    normals = mesh.normals[hits.face[seen]]
    points = origins[seen] - hits.distance[seen, None] * towards + normals * size * 1e-5
    light = towards + 0.9 * up - 0.7 * right
    light /= np.linalg.norm(light)
    lit = ~caster.blocked(points + size * light, points)
    brightness = 0.12 + 0.33 * np.clip(normals @ towards, 0, 1) + 0.55 * lit * np.clip(normals @ light, 0, 1)
    picture = np.ones((n * n, 3))
    picture[seen] = brightness[:, None] * np.array([1.0, 0.95, 0.86])
    return picture.reshape(PIXELS, 2, PIXELS, 2, 3).mean(axis=(1, 3)).clip(0, 1)


def draw(path: Path) -> None:
    """Write the panel of two rows and three columns."""
    figure = Figure(figsize=(10.2, 7.2), dpi=110)
    for i, name in enumerate(PART_MODELS):
        axes = figure.add_axes(((i % 3) / 3, 0.5 - (i // 3) / 2 + 0.035, 1 / 3, 0.455))
        axes.imshow(shade(name), interpolation="nearest")
        x, y, z = PART_MODELS[name].size_mm
        axes.set_title(f"{name}: {x:g} x {y:g} x {z:g} mm, {PART_MODELS[name].faces:,} faces", fontsize=9, y=-0.06)
        axes.set_axis_off()
    figure.savefig(path, metadata={"Software": None})

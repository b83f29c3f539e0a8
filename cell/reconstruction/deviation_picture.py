"""The picture of the mesh's deviation: seen from two sides, coloured by signed distance, and its histogram.

Drawn by casting one ray per pixel on the mesh, so that a mesh of half a million faces takes no longer than a small one.
"""

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from cell.rays.embree import EmbreeRayCaster
from cell.reconstruction.deviation import Deviation
from planner.surface.mesh import TriangleMesh, face_normals
from planner.values import Floats

_PIXELS = 560  # along the longer side
_COLOURS = "RdBu_r"  # red stands proud, blue lacks material
_INSIDE = (0.35, 0.35, 0.38, 1.0)  # the surface seen from behind, through a hole
_SIDES = ((-60.0, "from the front right"), (120.0, "from the back left"))


def draw(path: Path, mesh: TriangleMesh, deviation: Deviation) -> None:
    """Write the picture.

    Args:
        path: PNG to write.
        mesh: the surface, object frame [m].
        deviation: of the same mesh.
    """
    figure = Figure(figsize=(14.0, 4.9), dpi=110, layout="constrained")
    panels = figure.subplots(1, 3, width_ratios=(1.0, 1.0, 0.8))
    limit = max(deviation.quantile_95 * 1000.0, 1e-6) * 1.5
    scale = ScalarMappable(Normalize(-limit, limit), _COLOURS)
    caster = EmbreeRayCaster(mesh.vertices, mesh.faces)
    normals = face_normals(mesh)
    of_face = deviation.at_vertices[mesh.faces].mean(axis=1) * 1000.0
    for axes, (azimuth, title) in zip(panels, _SIDES, strict=False):
        face, toward, width, height = _look(mesh, caster, azimuth)
        picture = np.ones((*face.shape, 4))
        seen = face >= 0
        colour = scale.to_rgba(of_face[face[seen]])
        # Shaded by how steep the surface stands: the shape is seen although colour means something else.
        steep = normals[face[seen]] @ toward
        colour[steep < 0] = _INSIDE
        colour[:, :3] *= (0.45 + 0.55 * np.abs(steep))[:, None]
        picture[seen] = colour
        axes.imshow(picture, extent=(0, width * 1000, 0, height * 1000), interpolation="antialiased")
        axes.set_title(title, fontsize=10)
        axes.set_xlabel("mm", fontsize=8)
        axes.tick_params(labelsize=7)
    figure.colorbar(scale, ax=panels[:2], shrink=0.8, extend="both", label="deviation [mm], positive outside")
    edges = deviation.bin_edges * 1000.0
    middle = (edges[1:] + edges[:-1]) / 2
    panels[2].bar(
        middle, 100.0 * deviation.histogram, width=np.diff(edges), color=scale.to_rgba(middle), ec="#888888", lw=0.3
    )
    panels[2].set(xlabel="deviation [mm]", ylabel="share of the mesh's area [%]")
    panels[2].set_title(
        f"rms {deviation.rms * 1000:.3f}, 95 % {deviation.quantile_95 * 1000:.3f}, "
        f"largest {deviation.largest * 1000:.3f} mm", fontsize=9,
    )  # fmt: skip
    panels[2].grid(alpha=0.25)
    FigureCanvasAgg(figure)
    figure.savefig(path, format="png", metadata={"Software": "scan-cell"})


def _look(mesh: TriangleMesh, caster: EmbreeRayCaster, azimuth_deg: float) -> tuple[np.ndarray, Floats, float, float]:
    """Face that each pixel of a parallel view shows (rows, columns), -1 for none; direction to the eye; size [m]."""
    azimuth, elevation = np.radians(azimuth_deg), np.radians(22.0)
    toward = np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    up = np.cross(toward, right)
    across, upward, depth = mesh.vertices @ right, mesh.vertices @ up, mesh.vertices @ toward
    width, height = float(np.ptp(across)), float(np.ptp(upward))
    pixel = max(width, height, 1e-9) / _PIXELS
    columns, rows = max(1, round(width / pixel)), max(1, round(height / pixel))
    x = across.min() + (np.arange(columns) + 0.5) * width / columns
    y = upward.max() - (np.arange(rows) + 0.5) * height / rows
    far = depth.max() + 0.1 * max(width, height, 1e-9)
    origins = (x[None, :, None] * right + y[:, None, None] * up + far * toward).reshape(-1, 3)
    face = caster.first_hit(origins, np.broadcast_to(-toward, origins.shape)).face
    return face.reshape(rows, columns), toward, width, height

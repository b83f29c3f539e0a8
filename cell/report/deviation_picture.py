"""The picture of the mesh's deviation: seen from two sides, coloured by signed distance, and its histogram.

Drawn by casting one ray per pixel on the mesh, so that a mesh of half a million faces takes no longer than a small one.
"""

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure

from cell.view import rays
from cell.view.palette import SIGNED
from cell.world.embree import EmbreeRayCaster
from planner.geometry.mesh import TriangleMesh
from planner.registration.surface import Deviation
from planner.values import Floats

_PIXELS = 560  # along the longer side
_SIDES = ((-60.0, "from the front right"), (120.0, "from the back left"))


def draw(path: Path, mesh: TriangleMesh, deviation: Deviation, source: str) -> None:
    """Write the picture.

    Args:
        path: PNG to write.
        mesh: the surface, object frame [m].
        deviation: of the same mesh.
        source: where the points come from that it was made of.
    """
    figure = Figure(figsize=(14.0, 4.9), dpi=110, layout="constrained")
    panels = figure.subplots(1, 3, width_ratios=(1.0, 1.0, 0.8))
    limit = max(deviation.quantile_95 * 1000.0, 1e-6) * 1.5
    scale = ScalarMappable(Normalize(-limit, limit), LinearSegmentedColormap.from_list("signed", SIGNED))
    caster = EmbreeRayCaster(mesh.vertices, mesh.faces)
    normals = mesh.normals
    of_face = deviation.at_vertices[mesh.faces].mean(axis=1) * 1000.0
    for axes, (azimuth, title) in zip(panels, _SIDES, strict=False):
        camera = rays.fitted(mesh.vertices, rays.direction(azimuth, 22.0), (_PIXELS, _PIXELS), parallel=True)

        def colour_of(origins: Floats, directions: Floats) -> tuple[Floats, Floats]:
            hits = caster.first_hit(origins, directions)
            picture, seen = np.ones((len(origins), 3)), np.flatnonzero(hits.face >= 0)
            facing = -np.einsum("ij,ij->i", normals[hits.face[seen]], directions[seen])
            picture[seen] = rays.shaded(scale.to_rgba(of_face[hits.face[seen]])[:, :3], facing)
            return picture, hits.distance

        width = 2000 * float(camera.half[0])
        axes.imshow(rays.render(camera, colour_of)[0], extent=(0, width, 0, width))
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
    figure.suptitle(source, fontsize=9, x=0.01, ha="left")
    panels[2].grid(alpha=0.25)
    FigureCanvasAgg(figure)
    figure.savefig(path, format="png", metadata={"Software": "scan-cell"})

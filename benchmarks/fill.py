"""Methods to fill the measurability matrix: seconds and error of the predicted visible coverage.

For every built-in part with its default settings: `rays` at four resolutions and `aimed` with four numbers of samples
per face. Each matrix selects a plan (greedy cover); the share of area that it predicts for the plan is compared with
visible coverage by its definition, on 10^5 samples outside the matrix. The first rows are Mseke at the size of the
paper's second largest experiment: 1858 planning faces x 1858 viewpoints, one roll.

`trimesh s` is the time of the same rays with trimesh's ray interface, viewpoint by viewpoint as in the paper: measured
on 40 evenly spaced viewpoints and scaled to all of them. It gives the same matrix, so it has the same error.
"""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from benchmarks.best_of import best_of
from benchmarks.claimed_coverage import claim
from cell.part.builtin import NAMES
from cell.part.workpiece import load
from cell.scanners.laser_area import LaserArea
from cell.scene.file import load_scene
from cell.scene.settle import settle
from cell.world.embree import EmbreeRayCaster
from planner.geometry.closest import closest_facing_faces
from planner.geometry.decimation import decimate
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples, draw_samples, samples_at_face_centres
from planner.measurability import coverage
from planner.measurability.matrix import Measurability
from planner.measurability.visibility import fill_matrix
from planner.ports import RayCaster
from planner.viewpoints.viewpoints import Viewpoints, optimal_scanning_zone

RESOLUTIONS_DEG = (4.0, 2.0, 1.0, 0.5)
SAMPLES_PER_FACE = (1, 2, 4, 8)
REPEATS = 3
LARGE_FACES = 1858

_COLOURS = {"rays": "#c4622d", "aimed": "#2a6f97"}


def run() -> list[dict[str, Any]]:
    """Return two rows for the large Mseke, then eight for each built-in part."""
    rows = []
    for part in (None, *NAMES):
        rows += _part("mseke", large=True) if part is None else _part(part)
    return rows


def chart(rows: list[dict[str, Any]], folder: Path) -> None:
    """Draw `fill_speed_accuracy.png`: one panel per part, seconds against the error of predicted visible coverage."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 6.6), dpi=120, layout="constrained")
    axes = figure.subplots(2, 3, sharex=True, sharey=True)
    labels: dict[Any, list[tuple[str, float, float, str, bool]]] = {}
    for axis, part in zip(axes.flat, NAMES, strict=True):
        labels[axis] = []
        for method, marker, left in (("rays", "s", False), ("aimed", "o", True)):
            points = [row for row in rows if row["part"] == part and row["fill"].startswith(method)]
            seconds = [row["seconds"] for row in points]
            errors = [max(abs(row["error points"]), 0.02) for row in points]
            axis.plot(seconds, errors, marker=marker, color=_COLOURS[method], linewidth=1.4, markersize=5, label=method)
            for row, x, y in zip(points, seconds, errors, strict=True):
                label = row["fill"].removeprefix(method).strip().removesuffix("/face")
                labels[axis].append((f"{label} ({row['views']})", x, y, _COLOURS[method], left))
        axis.axhline(2.0, color="0.6", linewidth=0.8, linestyle=(0, (4, 3)))
        axis.set_title(part, fontsize=10, loc="left")
        axis.set_xscale("log")
        axis.set_yscale("log")
        axis.set_xlim(0.02, 90)
        axis.set_ylim(0.01, 120)
        axis.grid(color="0.92", linewidth=0.6)
        axis.set_axisbelow(True)
        for side in ("top", "right"):
            axis.spines[side].set_visible(False)
    ticks = (0.02, 0.1, 1, 2, 10, 100)
    axes[0, 0].set_yticks(ticks, ["≤ 0.02", "0.1", "1", "2", "10", "100"])
    figure.supylabel("error of predicted visible coverage [percentage points]", fontsize=10)
    figure.supxlabel("time to fill the measurability matrix [s]", fontsize=10)
    figure.suptitle(
        "Filled by rays (their spacing) or by aimed legs (samples per face); in brackets: views of the greedy plan",
        fontsize=11,
    )
    axes[0, 0].legend(frameon=False, fontsize=9, loc="upper left")
    FigureCanvasAgg(figure).draw()  # fixes the panels, and so the overlaps of labels
    for axis, texts in labels.items():
        _place(axis, texts)
    figure.savefig(folder / "fill_speed_accuracy.png", format="png", metadata={"Software": "scan-cell"})


_AROUND = ((7, -3), (5, 6), (5, -13), (0, 9), (0, -15), (9, 12), (9, -19), (0, 19), (0, -25), (14, 22), (14, -29))


def _place(axis: Any, labels: list[tuple[str, float, float, str, bool]]) -> None:
    """Place each label at the first position around its point without overlap of a marker or label."""
    from matplotlib.patheffects import withStroke
    from matplotlib.transforms import Bbox

    scale = axis.figure.dpi / 72
    points = [axis.transData.transform((x, y)) for _, x, y, *_ in labels]
    obstacles = [Bbox.from_bounds(px - 4, py - 4, 8, 8) for px, py in points]
    for (text, x, y, colour, left), (px, py) in zip(labels, points, strict=True):
        width, height = 4.3 * len(text) * scale, 8 * scale
        choices = []
        for side in (left, not left):
            for dx, dy in _AROUND:
                corner = px - dx * scale - width if side else px + dx * scale
                box = Bbox.from_bounds(corner, py + dy * scale, width, height)
                choices.append((sum(box.overlaps(other) for other in obstacles), len(choices), box, side, dx, dy))
        _, _, box, side, dx, dy = min(choices, key=lambda choice: choice[:2])
        obstacles.append(box)
        axis.annotate(
            text, (x, y), xytext=(-dx if side else dx, dy), textcoords="offset points",
            ha="right" if side else "left", fontsize=7, color=colour, zorder=5,
            path_effects=[withStroke(linewidth=2.0, foreground="white")],
        )  # fmt: skip


def _part(name: str, *, large: bool = False) -> list[dict[str, Any]]:
    """Return the rows of one part."""
    part = load(name)
    options = {"part": {"name": name}}
    settings = settle(load_scene(None, options), part).settings
    reference = part.reference
    planning = decimate(reference, LARGE_FACES if large else settings.faces)
    views = optimal_scanning_zone(planning, settings.standoffs, (0.0,) if large else settings.rolls)
    caster = EmbreeRayCaster(reference.vertices, reference.faces)
    rng = np.random.default_rng(0)
    held_out = draw_samples(reference, planning, coverage.N_SAMPLES, rng)
    row_of_face = closest_facing_faces(reference.centres, reference.normals, planning)
    faces = samples_at_face_centres(reference, planning)

    def rays(step: float) -> Measurability:
        scanner = LaserArea(**{**settings.scanner, "resolution_deg": (step, step)})
        return fill_matrix(views, faces, scanner, caster, method="rays", part=reference, row_of_face=row_of_face)

    scanner = LaserArea(**settings.scanner)

    def aimed(features: SurfaceSamples) -> Measurability:
        return fill_matrix(views, features, scanner, caster)

    mesh = trimesh.Trimesh(reference.vertices, reference.faces, process=False)
    works: list[tuple[str, Callable[[], Measurability]]] = []
    for step in (1.0,) if large else RESOLUTIONS_DEG:
        works.append((f"rays {step:g}°", lambda step=step: rays(step)))  # type: ignore[misc]
    for count in (1,) if large else SAMPLES_PER_FACE:
        features = draw_samples(reference, planning, count * len(planning.faces), rng)
        works.append((f"aimed {count}/face", lambda features=features: aimed(features)))  # type: ignore[misc]
    label = f"{name} {len(planning.faces)} x {len(views)}" if large else name
    rows = [_row(label, method, work, views, held_out, scanner, caster, reference) for method, work in works]
    for row, step in zip(rows, (1.0,) if large else RESOLUTIONS_DEG, strict=False):
        row["trimesh s"] = _with_trimesh(mesh, views, LaserArea(**{**settings.scanner, "resolution_deg": (step, step)}))
    return rows


def _with_trimesh(mesh: trimesh.Trimesh, views: Viewpoints, scanner: LaserArea) -> float:
    """Return the seconds of trimesh's ray interface, extrapolated from some of the viewpoints [s]."""
    directions = scanner.ray_directions()
    every = max(1, len(views) // 40)
    poses = views.T_object_scanner[::every, 0]
    mesh.ray.intersects_location(np.zeros((1, 3)), np.ones((1, 3)), multiple_hits=False)  # builds the tree
    start = time.perf_counter()
    for T in poses:
        source = np.broadcast_to(T[:3, 3], directions.shape)
        points, _, face = mesh.ray.intersects_location(source, directions @ T[:3, :3].T, multiple_hits=False)
        codes = scanner.reject((points - T[:3, 3]) @ T[:3, :3], mesh.face_normals[face] @ T[:3, :3])
        points = points[codes == 0]
        if len(points):
            sensor = T[:3, :3] @ scanner.sensor + T[:3, 3]
            towards = points - sensor
            length = np.linalg.norm(towards, axis=1)
            hits, ray, _ = mesh.ray.intersects_location(
                np.broadcast_to(sensor, towards.shape), towards / length[:, None], multiple_hits=False
            )
            _ = np.linalg.norm(hits - sensor, axis=1) >= length[ray] * (1 - 1e-5)
    return (time.perf_counter() - start) * len(views) / len(poses)


def _row(
    part: str,
    method: str,
    work: Callable[[], Measurability],
    views: Viewpoints,
    held_out: SurfaceSamples,
    scanner: LaserArea,
    caster: RayCaster,
    reference: TriangleMesh,
) -> dict[str, Any]:
    """Fill, select a plan, predict, and evaluate."""
    M, seconds = best_of(work, REPEATS)
    found = claim(M, views, held_out, scanner, caster)
    return {
        "part": part,
        "fill": method,
        "seconds": seconds["work"],
        "reference faces": len(reference.faces),
        "rows": M.shape[0],
        "viewpoints": M.shape[1],
        "views": found.views,
        "predicted %": 100 * found.claimed,
        "visible %": 100 * found.visible,
        "error points": found.error_points,
    }

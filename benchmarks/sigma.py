"""The model of sigma compared with observed scatter: noise of the virtual scan, and simulated light spots.

Each part is scanned from five candidates with its default settings. For each point the scatter along its ray is
observed twice: over `SCANS` repetitions of the scan with `--noise model`, and over as many simulated triangulations:
the photons of a spot (longer and dimmer with incidence) are drawn one by one, their centroid gives the line of sight,
which is intersected with the laser's ray. The second does not use the model's formula. The cost of a layer is listed
too.
"""

import time
from pathlib import Path
from typing import Any

import numpy as np

from cell.part.workpiece import load
from cell.scan.simulated import Disturbance
from cell.scanners.laser_area import LaserArea
from cell.scene.file import load_scene
from cell.scene.settle import settle
from cell.world import virtual_scan
from cell.world.embree import EmbreeRayCaster
from planner.geometry.decimation import decimate
from planner.geometry.sampling import draw_samples
from planner.measurability.quality import sigma_layer
from planner.measurability.visibility import fill_matrix
from planner.values import Floats
from planner.viewpoints.viewpoints import optimal_scanning_zone

PARTS = ("mseke", "mug", "humerus")
VIEWS = 5
POINTS = 120  # points of each view
SCANS = 400
PHOTONS = 400  # photons of a spot on a surface that faces both: enough that their number is never 0

_COLOURS = {"mseke": "#2a6f97", "mug": "#c4622d", "humerus": "#4f7f3b"}


def run() -> list[dict[str, Any]]:
    """Return one row for each part."""
    return [_row(name) for name in PARTS]


def chart(rows: list[dict[str, Any]], folder: Path) -> None:
    """Draw `sigma_model.png`: observed scatter over the model's sigma, and their ratio over incidence."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 4.6), dpi=120, layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    for row in rows:
        model, colour = 1000 * np.array(row["model"]), _COLOURS[row["part"]]
        light = 1000 * np.array(row["light"])
        left.plot(model, 1000 * np.array(row["scan"]), ".", ms=3, color=colour, alpha=0.6, label=row["part"])
        middle.plot(model, light, ".", ms=3, color=colour, alpha=0.6, label=row["part"])
        right.plot(row["incidence"], light / model, ".", ms=3, color=colour, alpha=0.6)
    ends = [0.8e3 * min(min(row["model"]) for row in rows), 1.2e3 * max(max(row["model"]) for row in rows)]
    for axis, title in ((left, "virtual scan, --noise model"), (middle, "light spots, triangulated")):
        axis.plot(ends, ends, color="0.3", linewidth=0.8)
        axis.set(xscale="log", yscale="log", xlabel="sigma of the model [mm]", xlim=ends, ylim=ends)
        axis.set_ylabel(f"observed over {SCANS} repetitions [mm]")
        axis.set_title(title, fontsize=10, loc="left")
        axis.legend(frameon=False, fontsize=8, markerscale=3)
    right.axhline(1, color="0.3", linewidth=0.8)
    expected = 1 / np.sqrt(2 * SCANS)
    right.axhspan(1 - 2 * expected, 1 + 2 * expected, color="0.9", zorder=0)
    right.set(xlabel="incidence of the laser [deg]", ylabel="observed / model", ylim=(0.75, 1.25), xlim=(0, 90))
    right.set_title("ratio (grey: 2 sigma of an estimate)", fontsize=10, loc="left")
    for axis in (left, middle, right):
        axis.grid(color="0.92", linewidth=0.6)
        axis.set_axisbelow(True)
        for side in ("top", "right"):
            axis.spines[side].set_visible(False)
    FigureCanvasAgg(figure).print_png(str(folder / "sigma_model.png"))


def _row(name: str) -> dict[str, Any]:
    """Scan a part and evaluate the scatter."""
    scene = load_scene(None, {"part": {"name": name}})
    part = load(name, None)
    settings = settle(scene, part).settings
    scanner = LaserArea(**{**settings.scanner, "resolution_deg": (1.0, 1.0)})
    caster = EmbreeRayCaster(part.reference.vertices, part.reference.faces)
    planning = decimate(part.reference, settings.faces)
    views = optimal_scanning_zone(planning, settings.standoffs, settings.rolls)
    rng = np.random.default_rng(0)
    normals = part.reference.normals
    found: list[tuple[Floats, ...]] = []
    for view in rng.choice(len(views), VIEWS, replace=False):
        T = views.T_object_scanner[view, 0]
        scan = virtual_scan.scan(scanner, T, caster, part.reference)
        some = rng.choice(len(scan.points), min(POINTS, len(scan.points)), replace=False)
        sigma, points = scan.sigma(scanner, part.reference)[some], scan.points[some]
        local, turned = (points - T[:3, 3]) @ T[:3, :3], normals[scan.face[some]] @ T[:3, :3]
        rays = local / np.linalg.norm(local, axis=1, keepdims=True)
        off = Disturbance(by_model=True)
        deviations = np.stack(
            [off.reported_points(points, T, T, scanner.source, rng, sigma) - points for _ in range(SCANS)]
        )
        noise = np.einsum("rpi,pi->rp", deviations @ T[:3, :3], rays)
        incidence = np.degrees(np.arccos(np.clip(-(turned * rays).sum(axis=1), -1, 1)))
        found.append((sigma, noise.std(axis=0), _light(scanner, local, turned, rng), incidence))
    model, seen, light, incidence = (np.concatenate(column) for column in zip(*found, strict=True))
    features = draw_samples(part.reference, planning, 4 * len(planning.faces), rng)
    start = time.perf_counter()
    M = fill_matrix(views, features, scanner, caster)
    filled = time.perf_counter()
    sigma_layer(M, views, scanner)
    layered = time.perf_counter()
    return {
        "part": name,
        "points": len(model),
        "model 5 % mm": 1000 * float(np.quantile(model, 0.05)),
        "median mm": 1000 * float(np.median(model)),
        "95 % mm": 1000 * float(np.quantile(model, 0.95)),
        "scan / model": float(np.sqrt(np.mean((seen / model) ** 2))),
        "light / model": float(np.sqrt(np.mean((light / model) ** 2))),
        "worst light / model": float((light / model)[np.abs(light / model - 1).argmax()]),
        "fill s": filled - start,
        "layer s": layered - filled,
        "entries": len(M.indices),
        "model": model.tolist(),
        "scan": seen.tolist(),
        "light": light.tolist(),
        "incidence": incidence.tolist(),
    }


def _light(scanner: LaserArea, points: Floats, normals: Floats, rng: np.random.Generator) -> Floats:
    """Return (N,) scatter along the ray of points (N, 3) [m] triangulated from drawn photons, scanner frame."""
    # The centroid of a spot that faces both with PHOTONS photons has the sensor's own sigma.
    width = np.radians(scanner.sigma_angle_mdeg / 1000) * np.sqrt(PHOTONS)
    scatter = np.empty(len(points))
    for k, (point, normal) in enumerate(zip(points, normals, strict=True)):
        ray, sight = point / np.linalg.norm(point), point - scanner.sensor
        sight /= np.linalg.norm(sight)
        across = ray - (ray @ sight) * sight
        across /= np.linalg.norm(across)
        counts = np.maximum(rng.poisson(PHOTONS * float(-normal @ sight), SCANS), 1)
        starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
        photons = width / float(-normal @ ray) * rng.standard_normal(int(counts.sum()))
        angle = np.add.reduceat(photons, starts) / counts
        sensor = np.array([scanner.sensor @ sight, scanner.sensor @ across])
        laser = np.array([ray @ sight, ray @ across])
        met = (sensor[0] * np.sin(angle) - sensor[1] * np.cos(angle)) / (
            laser[0] * np.sin(angle) - laser[1] * np.cos(angle)
        )
        scatter[k] = met.std()
    return scatter

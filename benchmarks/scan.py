"""`cell scan` in separate processes: seconds, memory, achieved and predicted coverage, and the effect of a pose error.

Rows `execution` are the default plan of the built-in Mseke scanned at 0.25 degree, without errors, and with a pose
error of 0.5 mm and 0.1 degree and range noise of 0.03 mm (one sigma each): time and memory of the whole process (`peak
MB` is its own), the clock of the simulated controller over the wall time of the execution (scans and files included),
the merged cloud's rms distance to the reference as reported and registered, and the largest distance of the surface
from the nearest point of the cloud. The row `controller` drives the same segments without scanning, best of 5: the time
of the simulation alone. The row `virtual scan` is one scan of 57,600 rays in this process, best of 20. Rows `coverage`
are all parts of benchmarks/parts.py, planned at their defaults and scanned at 2 degrees, which visible coverage does
not depend on: predicted by the plan, achieved by the report, and measured again from the files on other samples by
other code.
"""

import json
import tempfile
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from benchmarks.cell_process import run_cell
from benchmarks.checks import independent_visible
from benchmarks.parts import parts, place
from cell.errors import CellError
from cell.part.workpiece import load
from cell.runs.cell import read_cell
from cell.runs.run import open_run
from cell.scan import execution as scan_driver
from cell.scan.execution import plan_execution
from cell.scan.execution_folder import EXECUTING
from cell.scan.options import ScanOptions
from cell.scanners.laser_area import LaserArea
from cell.world.embree import EmbreeRayCaster
from cell.world.virtual_scan import scan

RESOLUTION_DEG = "0.25"
POSE_ERROR = "0.5mm,0.1deg"
RANGE_NOISE = "0.03"
COARSE_DEG = "2"
_SAMPLES = 200_000


def run() -> list[dict[str, Any]]:
    """Return two executions, the virtual scan, then one row per part."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        plan = folder / "default"
        run_cell(folder, "plan", "mseke", "--place", place(), "--out", str(plan), cache=folder / "cache")
        rows = [
            _execution(folder, plan, ()),
            _execution(folder, plan, ("--pose-error", POSE_ERROR, "--range-noise", RANGE_NOISE)),
            _controller(plan),
            _virtual_scan(),
        ]
        return rows + [_coverage(folder, name, arguments) for name, arguments in parts(folder)]


def _execution(folder: Path, plan: Path, options: tuple[str, ...]) -> dict[str, Any]:
    _, took = run_cell(folder, "scan", str(plan), "--resolution", RESOLUTION_DEG, *options, cache=folder / "cache")
    execution = max((plan / "executions").iterdir())
    report = json.loads((execution / "report.json").read_text())
    seconds = json.loads((execution / "manifest.json").read_text())["seconds"]
    cloud, model = report["cloud"], report["surface"]
    before, after = cloud["rms_to_reference_as_reported_mm"], cloud["rms_to_reference_mm"]
    return {
        "what": "execution",
        "part": "mseke" + (", " + " ".join(options) if options else ""),
        **took,
        "views": report["n_views"],
        "points": report["n_points"],
        "stages s": " ".join(f"{name} {value:.1f}" for name, value in seconds.items()),
        "faster than real time": report["motion"]["executed_s"] / seconds[EXECUTING],
        "before um": before * 1e3,
        "after um": after * 1e3,
        "gain": before / after if options else "",
        "mesh rms um": report["deviation"]["rms_mm"] * 1e3,
        "farthest surface in spacings": _farthest(execution) / model["spacing_mm"],
    }


def _farthest(execution: Path) -> float:
    """Return the largest distance of the mesh (vertices and area samples) to the nearest point of the cloud [mm]."""
    mesh = trimesh.load(execution / "mesh.ply", process=False)
    samples, _ = trimesh.sample.sample_surface(mesh, _SAMPLES, seed=1)
    tree = cKDTree(trimesh.load(execution / "cloud.ply", process=False).vertices)
    return float(tree.query(np.concatenate([mesh.vertices, samples]))[0].max())


def _controller(plan: Path) -> dict[str, Any]:
    run_record = open_run(plan)
    motion = run_record.motion
    cell = read_cell(run_record)
    legs = plan_execution(motion).segments
    best, simulated = np.inf, 0.0
    for _ in range(5):
        driver, clock = scan_driver.make_driver(ScanOptions(), motion, cell)
        with driver:
            began, start = clock.now(), perf_counter()
            for leg in legs:
                driver.move(leg.set_points, 1.0)
            best, simulated = min(best, perf_counter() - start), clock.now() - began
    return {"what": "controller", "part": "mseke", "ms": 1e3 * best, "faster than real time": simulated / best}


def _virtual_scan() -> dict[str, Any]:
    part = load("mseke")
    caster = EmbreeRayCaster(part.reference.vertices, part.reference.faces)
    scanner = LaserArea(resolution_deg=(0.25, 0.25))
    T = np.eye(4)
    T[:3, :3] = np.stack([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]], axis=1)
    T[:3, 3] = part.centre + np.array([0.3, 0.0, 0.0])
    best, found = np.inf, scan(scanner, T, caster, part.reference)
    for _ in range(20):
        start = perf_counter()
        found = scan(scanner, T, caster, part.reference)
        best = min(best, perf_counter() - start)
    return {
        "what": "virtual scan",
        "part": f"mseke, {len(part.reference.faces)} faces",
        "rays": len(found.codes),
        "points": len(found.points),
        "ms": 1e3 * best,
    }


def _coverage(folder: Path, name: str, arguments: tuple[str, ...]) -> dict[str, Any]:
    out = folder / name
    row: dict[str, Any] = {"what": "coverage", "part": name}
    try:
        run_cell(folder, "plan", *arguments, "--place", place(), "--out", str(out), cache=folder / "cache")
        summary, took = run_cell(folder, "scan", str(out), "--resolution", COARSE_DEG, cache=folder / "cache")
    except CellError as error:
        return row | {"error": str(error)[:100]}
    coverage = summary["coverage"]
    return row | {
        "s": took["s"],
        "cpu s": took["cpu s"],
        "views": summary["n_views"],
        "predicted %": 100 * coverage["predicted_all_views"],
        "achieved %": 100 * coverage["visible"],
        "measured again %": 100 * independent_visible(out, seed=12345),
    }

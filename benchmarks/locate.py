"""`cell locate` from one scan: error of the placement and reported undetermined motions, on every part.

Each part is planned (200 faces, one sample per face, 90 % of the coverable area), then moved by 20 mm in a random
direction and turned by 5 deg about a random axis. Its first view is scanned there, with noise of 0.03 mm along the
rays, and the points are fitted. The error is the largest error of the points of the part, without the motions that are
reported as undetermined (rotation about the axis of a mug). A row is wrong if a motion that is reported as determined
is off by more than 0.1 mm.

SCAN_CELL_LOCATE (default 3) is the number of placements of each part.
"""

import os
import tempfile
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from benchmarks.edits import no_pictures
from benchmarks.parts import parts, place
from cell.api import plan
from cell.errors import CellError
from cell.runs.cell import RunCell, read_cell
from cell.runs.run import Run
from cell.world import virtual_scan
from planner.geometry.closest import ClosestPointQuery
from planner.registration.cloud import ScanCloud
from planner.registration.localisation import SearchRange, fit_surface
from planner.registration.observability import FreeKind, RigidFit, describe
from planner.registration.rigid import motion_from_screw, motion_from_vector, screw_from_motion
from planner.values import Floats

_OFF_M, _OFF_DEG, _NOISE_M, _WITHIN_M = 0.02, 5.0, 3e-5, 1e-4
_POINTS = 2000  # points of the part at which the error is evaluated


def run() -> list[dict[str, Any]]:
    """Return one row for each part."""
    count = int(os.environ.get("SCAN_CELL_LOCATE", "3"))
    rows = []
    with tempfile.TemporaryDirectory() as scratch, no_pictures():
        for name, arguments in parts(Path(scratch)):
            units = {"units": arguments[2]} if len(arguments) > 1 else {}
            where = tuple(float(number) for number in place().split(","))
            out = Path(scratch) / f"run {name}"
            planned = plan(
                arguments[0], place=where, out=out, faces=200, samples=1, coverage=0.9,
                candidates="optimal-scanning-zone", **units,
            )  # fmt: skip
            rows.append({"part": name} | _row(planned, count))
    return rows


def _row(planned: Run, count: int) -> dict[str, Any]:
    cell = read_cell(planned)
    nearest, centre = ClosestPointQuery(cell.reference), cell.scene.T_object_centre[:3, 3]
    vertices = cell.reference.vertices[np.linspace(0, len(cell.reference.vertices) - 1, _POINTS).astype(np.int64)]
    errors, deviations, open_, wrong, seconds, seen = [], [], [], 0, 0.0, []
    for draw in range(count):
        T_moved, cloud = scanned(cell, planned.plan.views[0].T_object_scanner, centre, draw)
        seen.append(len(cloud))
        begin = process_time()
        try:
            found = fit_surface([cloud], nearest, centre, SearchRange(), np.random.default_rng(draw))
        except CellError as error:
            open_.append(str(error).split(";")[0])
            continue
        seconds += process_time() - begin
        error = farthest(found, T_moved, vertices)
        motions = found.undetermined_motions(_WITHIN_M)
        messages = [*([describe(motions)] if motions else []), *found.alternatives, *found.doubts]
        open_ += messages
        if messages and error > _WITHIN_M:  # the fit reported this uncertainty
            continue
        errors.append(1000 * error)
        deviations.append(1000 * (found.worst_point_sd(vertices) or 0.0))
        wrong += error > _WITHIN_M
    return {
        "placements": count,
        "points": int(np.median(seen)),
        "found": len(errors),
        "worst error mm": max(errors, default=float("nan")),
        "sd mm": max(deviations, default=float("nan")),
        "wrong": wrong,
        "not determined": "; ".join(dict.fromkeys(open_)) or "-",
        "cpu s a fit": seconds / count,
    }


def scanned(cell: RunCell, T_object_scanner: Floats, centre: Floats, draw: int) -> tuple[Floats, ScanCloud]:
    """Return the (4, 4) displacement of the part, and its scan from a planned view.

    The scan is in the object frame of the part at its planned place.
    """
    rng = np.random.default_rng([draw, 5])
    shift, axis = (each / np.linalg.norm(each) for each in (rng.standard_normal(3), rng.standard_normal(3)))
    T_moved = motion_from_vector(np.concatenate([_OFF_M * shift, np.radians(_OFF_DEG) * axis]), centre)
    T = np.linalg.inv(T_moved) @ T_object_scanner
    seen = virtual_scan.scan(cell.scanner, T, cell.part_caster, cell.reference)
    rays = seen.points - (T[:3, :3] @ cell.scanner.source + T[:3, 3])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    points = seen.points + rays * rng.normal(0.0, _NOISE_M, (len(rays), 1))
    return T_moved, ScanCloud(points @ T_moved[:3, :3].T + T_moved[:3, 3], T_object_scanner[:3, 3])


def farthest(found: RigidFit, T_moved: Floats, points: Floats) -> float:
    """Return the largest error of the points [m].

    If the rotation about one axis is undetermined, it is removed first.
    """
    T_off = found.T @ T_moved
    motions = [motion for motion in found.undetermined_motions(_WITHIN_M) if motion.kind is FreeKind.ROTATION]
    for motion in motions[:1]:
        turn = float(screw_from_motion(T_off, motion.point)[3:] @ motion.direction)
        T_off = motion_from_screw(np.concatenate([np.zeros(3), -turn * motion.direction]), motion.point) @ T_off
    return float(np.linalg.norm(points @ T_off[:3, :3].T + T_off[:3, 3] - points, axis=1).max())

"""What an execution amounts to: the summary that report.json, page and table are made of. It holds no clock value."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from cell.reconstruction.deviation import Deviation
from cell.reconstruction.reconstruct import REACH, Reconstruction
from cell.run.cell import RunCell
from cell.run.plan_json import PlanFile
from cell.scan.execution_results import Achieved, ExecutedScan, Merged, counts_by_reason
from cell.scan.pose_error import difference


def execution_summary(
    cell: RunCell,
    options: Mapping[str, Any],
    seed: int,
    plan: PlanFile,
    scans: Sequence[ExecutedScan],
    expected: Sequence[int],
    left_out: Sequence[str],
    merged: Merged,
    achieved: Achieved,
    model: Reconstruction,
    deviation: Deviation | None,
    planned_seconds: float,
    executed_seconds: float | None,
) -> dict[str, Any]:
    """Everything that the report says, as JSON types; fractions of area, mm and deg as the names say.

    Args:
        cell: part and scanner.
        options: of the execution, from its manifest.
        seed: of noise and pose error.
        plan: what was predicted.
        scans: that could be read.
        expected: stops that were to be scanned.
        left_out: a sentence for each file that could not be used.
        merged: cloud and registration.
        achieved: coverage.
        model: the surface.
        deviation: of the surface from the reference; None where there is none.
        planned_seconds: the plan's time for these legs [s].
        executed_seconds: the controller's [s]; None where its clock was no simulated one, or it did not come home.
    """
    there = {scan.stop for scan in scans}
    missing = [stop for stop in expected if stop not in there]
    registration, coverable = merged.registration, plan.coverage.coverable
    return {
        "part": {"name": cell.scene.part.name, "faces": len(cell.reference.faces)},
        "complete": not missing and not left_out,
        "missing_views": missing,
        "left_out": list(left_out),
        "settings": {
            **{name: options.get(name) for name in ("driver", "view", "range_noise_mm", "pose_error_mm")},
            **{name: options.get(name) for name in ("pose_error_deg", "register", "close_holes")},
            "noise": options.get("noise", "none"),
            "scanner": cell.scanner_keys.type,
            "resolution_deg": list(cell.scanner_keys.pair("resolution_deg") or ()),
            "rays_per_scan": cell.scanner.grid_shape[0] * cell.scanner.grid_shape[1],
            "seed": seed,
        },
        "n_views": len(scans),
        "n_views_planned": len(plan.views),
        "n_points": len(merged.cloud),
        "coverage": {
            "visible": achieved.visible,
            "predicted": achieved.predicted,
            "predicted_all_views": plan.coverage.visible,
            "coverable": coverable,
            "visible_of_coverable": achieved.visible / coverable if coverable > 0 else 0.0,
            "sampled": achieved.sampled,
            "sampled_radius_mm": _mm(achieved.radius),
        },
        "views": [_view(k, scan, merged, achieved) for k, scan in enumerate(scans)],
        "cloud": {
            "rms_to_reference_mm": _mm(merged.rms_after),
            "rms_to_reference_as_reported_mm": _mm(merged.rms_before),
        },
        "registration": None
        if registration is None
        else {
            "rms_before_mm": _mm(registration.rms_before),
            "rms_after_mm": _mm(registration.rms_after),
            "iterations": registration.iterations,
            "overlapping_pairs": len(registration.overlaps),
            "left_as_reported": sum(not scan.is_corrected for scan in registration.scans),
        },
        "model": {
            "status": model.status.value,
            "vertices": 0 if model.mesh is None else len(model.mesh.vertices),
            "faces": 0 if model.mesh is None else len(model.mesh.faces),
            "closed_faces": int(model.closed.sum()),
            "spacing_mm": _mm(model.spacing),
            "reach_mm": _mm(REACH * model.spacing),
            "diagonal_mm": _mm(cell.reference.diagonal),
            "grid_mm": _mm(model.grid),
            "outliers": model.outliers,
            "holes": model.holes,
        },
        "deviation": None
        if deviation is None
        else {**_numbers(deviation), "closed": None if deviation.closed is None else _numbers(deviation.closed)},
        "motion": {"planned_s": planned_seconds, "executed_s": executed_seconds},
    }


def _view(k: int, scan: ExecutedScan, merged: Merged, achieved: Achieved) -> dict[str, Any]:
    """One scan of the summary."""
    off, turn = difference(scan.T_true, scan.T_reported)
    off_after, turn_after = difference(scan.T_true, merged.poses[k])
    registered = None if merged.registration is None else merged.registration.scans[k]
    return {
        "stop": scan.stop,
        "id": scan.view,
        "points": len(scan.points),
        "rays": counts_by_reason(scan.counts),
        "adds": float(achieved.adds[k]),
        "reported_minus_commanded_deg": float(np.degrees(np.abs(scan.q_reported - scan.q_commanded)).max().round(6)),
        "pose_error_mm": _mm(off),
        "pose_error_deg": _deg(turn),
        "pose_error_after_mm": _mm(off_after),
        "pose_error_after_deg": _deg(turn_after),
        "registration": None if registered is None else registered.sentence,
        "free_directions": 0 if registered is None else len(registered.free),
    }


def _numbers(deviation: Deviation) -> dict[str, Any]:
    return {
        "rms_mm": _mm(deviation.rms),
        "mean_mm": _mm(deviation.mean),
        "quantile_95_mm": _mm(deviation.quantile_95),
        "largest_mm": _mm(deviation.largest),
        "samples": deviation.sample_count,
    }


def _mm(metres: float) -> float | None:
    return round(float(metres) * 1000, 6) if np.isfinite(metres) else None


def _deg(radians: float) -> float:
    return round(float(np.degrees(radians)), 6)

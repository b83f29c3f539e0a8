"""What an execution amounts to, in numbers: the report that report.json, page and table are made of."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cell.metrology.reconstruct import REACH, Reconstruction
from cell.runs.cell import RunCell
from cell.runs.run import ExecutedScan
from cell.runs.schema import (
    ExecutedCloud,
    ExecutedCoverage,
    ExecutedDeviation,
    ExecutedMotion,
    ExecutedPart,
    ExecutedPlace,
    ExecutedRegion,
    ExecutedRegistration,
    ExecutedSettings,
    ExecutedSurface,
    ExecutedView,
    ExecutionReport,
    PlanFile,
    SurfaceDeviation,
)
from cell.scan.achieved import Achieved
from cell.scan.executed_scans import counts_by_reason, source_of
from cell.scan.merging import Merged
from planner.geometry.mesh import TriangleMesh
from planner.geometry.rigid import pose_difference
from planner.registration.observability import describe
from planner.registration.registration import Registration
from planner.registration.surface import Deviation

DETERMINED = 5e-5
"""A direction is determined where two standard deviations move the part by less [m]."""

_LOOKED_AT = 2000  # points of a cloud that stand for all


@dataclass(frozen=True, slots=True, eq=False)
class Results:
    """What was made of an execution.

    Attributes:
        scans: that could be read, in driving order.
        left_out: a sentence for each file that could not be used.
        merged: cloud and registration.
        achieved: coverage.
        model: the surface.
        deviation: of the surface from the reference; None where there is none.
        doubts: what the points contradict, a sentence each.
    """

    scans: Sequence[ExecutedScan]
    left_out: Sequence[str]
    merged: Merged
    achieved: Achieved
    model: Reconstruction
    deviation: Deviation | None
    doubts: Sequence[str] = ()


def execution_report(
    cell: RunCell,
    plan: PlanFile,
    settings: ExecutedSettings,
    results: Results,
    expected: Sequence[int],
    motion: ExecutedMotion,
) -> ExecutionReport:
    """Everything that the report says.

    Args:
        cell: part and scanner.
        plan: what was predicted.
        settings: of the execution.
        results: what was made of it.
        expected: stops that were to be scanned.
        motion: times of these moves.
    """
    scans, merged = results.scans, results.merged
    there = {scan.stop for scan in scans}
    missing = [stop for stop in expected if stop not in there]
    return ExecutionReport(
        part=ExecutedPart(name=cell.scene.part.name, faces=len(cell.reference.faces)),
        complete=not missing and not results.left_out,
        missing_views=tuple(missing),
        left_out=tuple(results.left_out),
        settings=settings,
        n_views=len(scans),
        n_views_planned=len(plan.views),
        n_points=len(merged.cloud),
        source=source_of(scans),
        doubts=tuple(results.doubts),
        coverage=_coverage(plan, results.achieved, simulated=all(scan.T_true is not None for scan in scans)),
        regions=_regions(cell, results.achieved),
        views=tuple(_view(k, scan, results) for k, scan in enumerate(scans)),
        cloud=ExecutedCloud(
            rms_to_reference_mm=_known_mm(merged.rms_after),
            rms_to_reference_as_reported_mm=_known_mm(merged.rms_before),
            outliers=merged.outliers,
        ),
        place=place_of(merged, scans),
        registration=None if merged.registration is None else registration_of(merged.registration),
        model=surface_of(cell.reference, results.model),
        deviation=None if results.deviation is None else deviation_of(results.deviation),
        motion=motion,
    )


def settings_of(cell: RunCell, options: Mapping[str, object], seed: int) -> ExecutedSettings:
    """What was asked for.

    Args:
        cell: the scanner, at the resolution of the execution.
        options: of the manifest; one that it lacks is null.
        seed: of noise and pose error.
    """
    asked = ("driver", "view", "range_noise_mm", "pose_error_mm", "pose_error_deg", "register", "close_holes")
    return ExecutedSettings.model_validate(
        {
            **{name: options.get(name) for name in asked},
            "noise": options.get("noise", "none"),
            "scanner": cell.scanner_keys.type,
            "resolution_deg": cell.scanner_keys.pair("resolution_deg") or (),
            "rays_per_scan": cell.scanner.grid_shape[0] * cell.scanner.grid_shape[1],
            "seed": seed,
        }
    )


def _coverage(plan: PlanFile, achieved: Achieved, *, simulated: bool) -> ExecutedCoverage:
    coverable = plan.coverage.coverable
    return ExecutedCoverage(
        kind="simulated" if simulated else "model",
        visible=achieved.visible,
        predicted=achieved.predicted,
        predicted_all_views=plan.coverage.visible,
        coverable=coverable,
        visible_of_coverable=achieved.visible / coverable if coverable > 0 else 0.0,
        sampled=achieved.sampled,
        dense=achieved.dense,
        sampled_radius_mm=_mm(achieved.radius),
    )


def _regions(cell: RunCell, achieved: Achieved) -> tuple[ExecutedRegion, ...] | None:
    """What is achieved of each region that somebody cares for; None of a part without."""
    of_sample = achieved.surface.samples.region
    if of_sample is None:
        return None
    times, found = achieved.surface.seen.sum(axis=1), []
    for number, region in enumerate(cell.scene.regions or ()):
        own, views = times[of_sample == number], region.views or cell.scene.plan.multiplicity
        if len(own):
            shares = float((own > 0).mean()), float((own >= views).mean())
            found.append(ExecutedRegion(name=region.name, visible=shares[0], views=views, from_enough_views=shares[1]))
    return tuple(found)


def _view(k: int, scan: ExecutedScan, results: Results) -> ExecutedView:
    """One scan of the report."""
    off = None if scan.T_true is None else pose_difference(scan.T_true, scan.T_reported)
    after = None if scan.T_true is None else pose_difference(scan.T_true, results.merged.poses[k])
    registration = results.merged.registration
    registered = None if registration is None else registration.scans[k]
    return ExecutedView(
        stop=scan.stop,
        id=scan.view,
        points=len(scan.points),
        rays=None if scan.counts is None else counts_by_reason(scan.counts),
        adds=float(results.achieved.adds[k]),
        reported_minus_commanded_deg=float(np.degrees(np.abs(scan.q_reported - scan.q_commanded)).max().round(6)),
        pose_error_mm=None if off is None else _mm(off[0]),
        pose_error_deg=None if off is None else _deg(off[1]),
        pose_error_after_mm=None if after is None else _mm(after[0]),
        pose_error_after_deg=None if after is None else _deg(after[1]),
        registration=None if registered is None else registered.sentence,
        free_directions=0 if registered is None else len(registered.free),
    )


def place_of(merged: Merged, scans: Sequence[ExecutedScan]) -> ExecutedPlace | None:
    """Where the part was found to stand; None where it was not looked for."""
    if (fit := merged.fit) is None:
        return None
    centre = fit.centre
    moved = fit.T[:3, :3] @ centre + fit.T[:3, 3] - centre
    truth = [
        fit.determined_part(scan.T_true @ np.linalg.inv(T), DETERMINED)
        for scan, T in zip(scans, merged.poses, strict=True)
        if scan.T_true is not None
    ]
    worst = fit.worst_point_sd(merged.cloud.points[:: max(1, len(merged.cloud) // _LOOKED_AT)])
    return ExecutedPlace(
        moved_mm=_mm(float(np.linalg.norm(moved))),
        turned_deg=_deg(pose_difference(fit.T, np.eye(4))[1]),
        worst_point_mm=None if worst is None else _mm(worst),
        undetermined=(
            *([describe(open_)] if (open_ := fit.undetermined_motions(DETERMINED)) else []),
            *fit.alternatives,
        ),
        off_mm=_mm(max(shift for shift, _ in truth)) if truth else None,
        off_deg=_deg(max(turn for _, turn in truth)) if truth else None,
    )


def registration_of(registration: Registration) -> ExecutedRegistration:
    """How the poses were corrected."""
    return ExecutedRegistration(
        rms_before_mm=_known_mm(registration.rms_before),
        rms_after_mm=_known_mm(registration.rms_after),
        iterations=registration.iterations,
        overlapping_pairs=len(registration.overlaps),
        left_as_reported=sum(not scan.is_corrected for scan in registration.scans),
    )


def surface_of(reference: TriangleMesh, model: Reconstruction) -> ExecutedSurface:
    """The surface in numbers."""
    return ExecutedSurface(
        status=model.status.value,
        vertices=0 if model.mesh is None else len(model.mesh.vertices),
        faces=0 if model.mesh is None else len(model.mesh.faces),
        closed_faces=int(model.closed.sum()),
        spacing_mm=_known_mm(model.spacing),
        reach_mm=_known_mm(REACH * model.spacing),
        diagonal_mm=_mm(reference.diagonal),
        grid_mm=_known_mm(model.grid),
        outliers=model.outliers,
        holes=model.holes,
    )


def deviation_of(deviation: Deviation) -> ExecutedDeviation:
    """The deviation in numbers."""
    closed = None if deviation.closed is None else SurfaceDeviation(**_numbers(deviation.closed))
    return ExecutedDeviation(**_numbers(deviation), closed=closed)


def _numbers(deviation: Deviation) -> dict[str, float]:
    return {
        "rms_mm": _mm(deviation.rms),
        "mean_mm": _mm(deviation.mean),
        "quantile_95_mm": _mm(deviation.quantile_95),
        "largest_mm": _mm(deviation.largest),
        "samples": deviation.sample_count,
    }


def _mm(metres: float) -> float:
    return round(float(metres) * 1000, 6)


def _known_mm(metres: float) -> float | None:
    return _mm(metres) if np.isfinite(metres) else None


def _deg(radians: float) -> float:
    return round(float(np.degrees(radians)), 6)

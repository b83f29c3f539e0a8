"""What a plan gives each region of its part, and why where that is less than was asked. Held-out samples."""

import numpy as np

from cell.plan.connected_plan import ConnectedPlan
from cell.plan.problem import Problem
from cell.runs.schema import RegionResult
from cell.scene.model import RegionTargets
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import pick_samples
from planner.measurability.quality import best_values
from planner.values import Bools, Ints
from planner.viewpoints.lines_of_sight import RayTargets
from planner.why.why import REASON_OF_VERDICT, Reason, diagnose

_ASKED = 300  # samples of a region whose reasons are looked for


def results_of(
    regions: tuple[RegionTargets, ...], reference: TriangleMesh, problem: Problem, chosen: ConnectedPlan
) -> tuple[RegionResult, ...]:
    """A row for each region that somebody cares for and that is there."""
    samples, plan = problem.prediction.samples, problem.request.plan
    assert samples.region is not None
    assert reference.region is not None
    coverable: Bools = problem.prediction.coverable.covered | chosen.visible.covered
    times = chosen.seen.sum(axis=1)
    found = []
    for number, region in enumerate(regions):
        rows = np.flatnonzero(samples.region == number)
        if not region.cared or not len(rows):
            continue
        can, has = float(coverable[rows].mean()), float((times[rows] > 0).mean())
        views = region.views or plan.multiplicity
        asked = plan.coverage if region.coverage is None else region.coverage
        lost = rows[~coverable[rows]]
        found.append(
            RegionResult(
                name=region.name,
                area_mm2=round(1e6 * float(reference.areas[reference.region == number].sum()), 3),
                asked=asked,
                shared=region.coverage is None,
                views=views,
                max_sigma_mm=region.max_sigma_mm,
                max_spacing_mm=region.max_spacing_mm,
                weight=region.weight,
                visible=has,
                coverable=can,
                visible_of_coverable=has / can if can > 0 else 0.0,
                from_enough_views=float((times[rows] >= views).mean()),
                reason=_reason(region, lost, 1 - can, problem) if can < asked else "",
            )
        )
    return tuple(found)


def _reason(region: RegionTargets, lost: Ints, share: float, problem: Problem) -> str:
    """Why no reachable candidate measures most of what is lost of a region, in a sentence."""
    samples, scanner, casters = (getattr(problem.prediction, name) for name in ("samples", "scanner", "casters"))
    asked = lost[np.linspace(0, len(lost) - 1, min(_ASKED, len(lost))).round().astype(np.int64)]
    targets = RayTargets.of(samples.points, samples.normals, samples.region)
    fails = np.array([REASON_OF_VERDICT[verdict] for verdict in REASON_OF_VERDICT], dtype=np.uint8)[
        problem.reached.verdict
    ]
    why = diagnose(targets, asked, problem.candidates, scanner, casters[0], casters[1], fails)
    number = int(np.argmax(np.bincount(why.reason)))
    told = f"{100 * share:.1f} % of it no reachable candidate measures, mostly: {Reason(number).sentence}"
    if number != Reason.TOO_SPARSE or region.max_spacing_mm is None:
        return told
    own = np.flatnonzero(why.reason == Reason.TOO_SPARSE)
    some = pick_samples(samples, asked[own])
    poses = problem.candidates.T_object_scanner.reshape(-1, 1, 4, 4)[why.pose[own]]
    spacing = 1000 * best_values([scanner.spacing], poses, some, np.eye(len(own), dtype=np.bool_), scanner.scanner)[0]
    near, far = 1000 * np.quantile(why.distance[own], [0.1, 0.9])
    return (
        f"{told} ({np.nanmedian(spacing):.3g} mm from {near:.0f} to {far:.0f} mm away, limit "
        f"{region.max_spacing_mm:g} mm); a finer scanner.resolution_deg, or a device with a nearer range, gives them"
    )

"""What an execution measures of the surface, on the samples on which the plan predicted it. Object frame, metres."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cell.runs.cell import RunCell, scanner_of
from cell.runs.run import ExecutedScan
from cell.runs.schema import PlanFile
from cell.scan.merging import Merged, executed_poses
from cell.view.contents import of_views
from cell.view.surface import Surface
from cell.world.prediction import held_out_samples
from planner.measurability import coverage
from planner.measurability.quality import best_spacing
from planner.values import Bools, Floats


@dataclass(frozen=True, slots=True, eq=False)
class Achieved:
    """Coverage of an execution, as fractions of the surface.

    Attributes:
        visible: measured from at least one executed pose: the true one of a simulation, else the registered one.
        predicted: the same from the planned poses of the views that were scanned.
        sampled: within `radius` of a scan point.
        dense: measured, and within 1.5 x the spacing planned there of a scan point; None: not known, or
            a sensor that sweeps, whose lines `cell.scan.sweep_scan` takes farther apart than it does.
        radius: of sampled coverage [m].
        adds: (n,) what each scan adds to visible coverage, in driving order.
        largest_first: (n,) what each adds when the one that adds most comes first.
        surface: what the scans measure of the held-out samples.
    """

    visible: float
    predicted: float
    sampled: float
    dense: float | None
    radius: float
    adds: Floats
    largest_first: Floats
    surface: Surface


def achieved(
    scans: Sequence[ExecutedScan],
    plan: PlanFile,
    merged: Merged,
    cell: RunCell,
    plan_seed: int,
) -> Achieved:
    """Measure coverage on the samples on which the plan predicted it.

    Args:
        scans: of one execution.
        plan: its views, and what was predicted for all of them.
        merged: the same scans.
        cell: part, surroundings and scanner.
        plan_seed: seed of the plan, from which its held-out samples were drawn.
    """
    samples = held_out_samples(cell.reference, cell.planning, plan_seed)
    surface = of_views(cell, samples, executed_poses(scans, merged))
    measured = surface.seen
    predicted = plan.coverage.visible
    poses = [plan.views[scan.stop - 1].T_object_poses for scan in scans]
    if sorted(scan.stop for scan in scans) != list(range(1, len(plan.views) + 1)):
        predicted = coverage.coverage_of_views(of_views(cell, samples, poses).seen, samples).fraction
    radius = coverage.sampling_radius(cell.reference)
    order = _largest_first(measured)
    spacing = None
    if poses and len(poses[0]) == 1:
        # The plan's scanner: its grid counts, whatever the resolution of the scan.
        planned = scanner_of(cell.scene, cell.scene.scanner)
        spacing = best_spacing(np.stack(poses), samples, measured, planned)
    return Achieved(
        visible=coverage.coverage_of_views(measured, samples).fraction,
        predicted=predicted,
        sampled=coverage.sampled_coverage(merged.cloud.points, samples, radius).fraction,
        dense=None if spacing is None else coverage.dense_coverage(merged.cloud.points, samples, spacing).fraction,
        radius=radius,
        adds=coverage.marginal_coverage(measured),
        largest_first=coverage.marginal_coverage(measured[:, order]),
        surface=surface,
    )


def _largest_first(measured: Bools) -> list[int]:
    """Views in the order in which each adds most of what is still open."""
    still_open, order = np.ones(len(measured), dtype=np.bool_), list[int]()
    for _ in range(measured.shape[1]):
        gains = (measured & still_open[:, None]).sum(axis=0)
        gains[order] = -1
        order.append(int(gains.argmax()))
        still_open &= ~measured[:, order[-1]]
    return order

"""Check the reasons that an exploration reports for open surface against the true part, unknown to the planner.

The last planning step is repeated from the stored files; it gives the open samples, their reasons and the candidates. A
reason for which a candidate fails is true if planning among the same candidates on the true mesh, in the cell with the
true part and without unseen space, gives the same sentence for the same sample. The sample is moved to the true surface
if that is within the edge of a voxel, else it stays at its believed place. "Views that might measure it ..." is true if
no candidate that the arm reaches there measures it. "Views ... did not" is true if the executed views measure less than
half of the true surface within the edge of a voxel around the sample, "a rest" if they measure any of it within two
edges.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from cell.explore import state
from cell.explore.belief import (
    MISSED,
    NEAR_MEASURED,
    NOT_SELECTED,
    REMAINDER,
    UncoveredReport,
    closest_causes,
    describe_cause,
)
from cell.explore.explore import explain_remaining
from cell.explore.prepare import ExplorationContext
from cell.runs.cell import RunCell, read_cell, world_of
from cell.runs.run import open_finished
from cell.runs.schema import ExploreFile
from cell.world.collision import MujocoCollisionChecker
from cell.world.prediction import held_out_samples
from planner.geometry.closest import ClosestPointQuery
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples
from planner.kinematics import reach
from planner.measurability.visibility import find_measured
from planner.values import Bools, Floats
from planner.why.why import Reason


def check_causes(work: ExplorationContext, file: ExploreFile, known_model: Path) -> dict[str, tuple[float, float]]:
    """Return the open area [mm2] of each stated sentence, and the area for which the sentence is true.

    Args:
        work: inputs of the exploration, whose folder is finished.
        file: its explore.json.
        known_model: run folder of the plan of the true part.
    """
    reported = explain_remaining(work, file, work.paths.known(len(file.batches), work.unknown))
    if reported is None:
        return {}
    true = _true(work, file, reported, known_model)
    found: dict[str, tuple[float, float]] = {}
    for code in np.unique(reported.reason).tolist():
        here = reported.reason == code
        area, of_it = found.get(describe_cause(code), (0.0, 0.0))
        areas = 1e6 * reported.samples.areas
        found[describe_cause(code)] = area + float(areas[here].sum()), of_it + float(areas[here & true].sum())
    return found


def _true(work: ExplorationContext, file: ExploreFile, reported: UncoveredReport, known_model: Path) -> Bools:
    """Return (N,) for which samples the reason is true."""
    run = open_finished(known_model)
    cell, part = read_cell(run), run.mesh("reference.ply")
    assert work.ground_truth is not None
    to_object = np.asarray(np.linalg.inv(work.ground_truth.T_explored_object), dtype=np.float64)
    samples = _on_part(reported.samples, to_object, part, work.unknown.edge)
    candidates = replace(reported.candidates, T_object_scanner=to_object @ reported.candidates.T_object_scanner)
    world = world_of(run, part)
    reached = reach.solve_reach(
        candidates, world.T_base_object, world.T_flange_scanner, cell.kinematics, MujocoCollisionChecker(world)
    )
    casters = (cell.part_caster, cell.occluder_caster)
    there = closest_causes(samples, candidates, reached, cell.scanner, casters)
    pairs = zip(reported.reason.tolist(), there.tolist(), strict=True)
    same = np.array([code > 0 and describe_cause(code) == describe_cause(true) for code, true in pairs])
    same |= (reported.reason == NOT_SELECTED) & (there == Reason.NOT_SELECTED)
    same |= (reported.reason >= Reason.OUT_OF_REACH) & (there != Reason.NOT_SELECTED)
    edge, poses = work.unknown.edge, _poses(work, file, to_object)
    same |= (reported.reason == MISSED) & (_measured_beside(samples.points, poses, cell, edge) < 0.5)
    same |= (reported.reason == REMAINDER) & (_measured_beside(samples.points, poses, cell, NEAR_MEASURED * edge) > 0)
    return same


def _on_part(belief: SurfaceSamples, to_object: Floats, part: TriangleMesh, edge: float) -> SurfaceSamples:
    """Return samples in the object frame; those within a voxel's edge of the true part are moved to its surface."""
    points = belief.points @ to_object[:3, :3].T + to_object[:3, 3]
    normals = belief.normals @ to_object[:3, :3].T
    found = ClosestPointQuery(part).closest(points)
    there = found.distance <= edge
    points = np.where(there[:, None], found.point, points)
    normals = np.where(there[:, None], part.normals[found.face], normals)
    return SurfaceSamples(points, normals, belief.areas, belief.face, belief.planning_face)


def _poses(work: ExplorationContext, file: ExploreFile, to_object: Floats) -> Floats:
    """Return (V, 4, 4) the poses of all executed views, object frame [m]."""
    scans = state.read_scans(work.paths, file.batches)
    return np.stack([to_object @ (scan.T_reported if scan.T_true is None else scan.T_true) for scan in scans])


def _measured_beside(points: Floats, poses: Floats, cell: RunCell, radius: float) -> Floats:
    """Return (n,) share of the true surface within a radius of points (n, 3) [m] that views (V, 4, 4) measure."""
    truth = held_out_samples(cell.reference, cell.planning, 0)
    seen = find_measured(poses[:, None], truth, cell.scanner, (cell.part_caster, cell.occluder_caster))
    beside = cKDTree(truth.points).query_ball_point(points, radius)
    return np.array([seen[rows].mean() if rows else 0.0 for rows in beside])

"""Whether what an exploration says of its open surface is true: asked again of the true part, which the planner hid.

The last planning step is made again from what is on disk; it gives the open samples, their reasons and the candidates.
A reason that a candidate fails at is true where planning among the same candidates on the true mesh, in the cell with
the true part and without unseen space, comes to the same sentence for the same sample. "Views ... did not" is true
where less than half of the true surface within a voxel's edge of the sample is measured by the executed views.
"""

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from cell.explore import belief, state
from cell.explore.policies import Batch
from cell.explore.prepare import Exploring
from cell.explore.reasons import NOT_TAKEN, TRIED, StillOpen, closest, sentence
from cell.explore.stage import Asked, EnoughError, plan_stage
from cell.narrator import Quiet
from cell.rays.prediction import held_out
from cell.run import reader
from cell.run.cell import RunCell, read_cell, world_of
from cell.run.explore_json import ExploreFile
from cell.run.record import open_finished
from cell.world.collision import MujocoCollisionChecker
from planner.measurability.matrix import measured
from planner.reach import reach
from planner.surface.sample import SurfaceSamples
from planner.values import Bools, Floats
from planner.why.reasons import Reason


def judged(work: Exploring, file: ExploreFile) -> dict[str, tuple[float, float]]:
    """Area [mm2] of what is open by stated sentence, and of it the area for which the sentence is true.

    Args:
        work: what the exploration was begun with, its folder finished.
        file: its explore.json.
    """
    said = _said(work, len(file.stages))
    if said is None:
        return {}
    true = _true(work, file, said)
    found: dict[str, tuple[float, float]] = {}
    for code in np.unique(said.reason).tolist():
        here = said.reason == code
        area, of_it = found.get(sentence(code), (0.0, 0.0))
        areas = 1e6 * said.samples.areas
        found[sentence(code)] = area + float(areas[here].sum()), of_it + float(areas[here & true].sum())
    return found


def _said(work: Exploring, stages: int) -> StillOpen | None:
    """What was open after so many stages, and why."""
    known = work.paths.known(stages, work.unknown)
    believed = belief.part_of(known.believed, work.name)
    with tempfile.TemporaryDirectory() as folder:
        unseen = Path(folder) / "unseen.ply"
        belief.write_unseen(known.space, unseen)
        scene = belief.scene_of(work.scene, work.cylinder, believed, unseen)
        asked = Asked(known.space, known.record, Batch(0), 0.0, "asked again")
        try:
            plan_stage(scene, believed, asked, Path(folder) / "again", Quiet())
        except EnoughError as error:
            return error.open
    raise AssertionError("a batch without views is no plan")


def _true(work: Exploring, file: ExploreFile, said: StillOpen) -> Bools:
    """(N,) for which samples the reason is true."""
    run = open_finished(work.paths.root / "truth")
    cell, part = read_cell(run), reader.mesh(run, "reference.ply")
    assert work.hidden is not None
    to_object = np.linalg.inv(work.hidden.T_explored_object)
    samples = SurfaceSamples(
        said.samples.points @ to_object[:3, :3].T + to_object[:3, 3], said.samples.normals @ to_object[:3, :3].T,
        said.samples.areas, said.samples.face, said.samples.planning_face,
    )  # fmt: skip
    candidates = replace(said.candidates, T_object_scanner=to_object @ said.candidates.T_object_scanner)
    world = world_of(run, part)
    reached = reach.solve(
        candidates, world.T_base_object, world.T_flange_scanner, cell.kinematics, MujocoCollisionChecker(world)
    )
    casters = (cell.part_caster, cell.occluder_caster)
    there = closest(samples, candidates, reached, cell.scanner, casters)
    words = [Reason(code).sentence for code in there.tolist()]
    same = np.array([code > 0 and sentence(code) == word for code, word in zip(said.reason, words, strict=True)])
    same |= (said.reason == NOT_TAKEN) & (there == Reason.NOT_SELECTED)
    tried = said.reason == TRIED
    same[tried] = ~_measured_beside(samples.points[tried], work, file, cell, to_object)
    return same


def _measured_beside(points: Floats, work: Exploring, file: ExploreFile, cell: RunCell, to_object: Floats) -> Bools:
    """(n,) whether half of the true surface beside points (n, 3) is measured by the executed views; object frame."""
    scans = state.scans_of(work.paths, file.stages)
    poses = np.stack([to_object @ (scan.T_reported if scan.T_true is None else scan.T_true) for scan in scans])
    truth = held_out(cell.reference, cell.planning, file.seed)
    seen = measured(poses[:, None], truth, cell.scanner, (cell.part_caster, cell.occluder_caster))
    beside = cKDTree(truth.points).query_ball_point(points, work.unknown.edge)
    return np.array([bool(rows) and seen[rows].mean() >= 0.5 for rows in beside], dtype=np.bool_)

"""The stepwise policy of `cell explore`, one view at a time from the common first view, for a scanner without an arm.

Belief, gain and candidates are those of a stage (`cell.explore.stage`), without the terms of the arm.
"""

from dataclasses import replace

import numpy as np
from numpy.random import Generator
from scipy.sparse import csr_array

from benchmarks.exploring.lab import Knowledge, Lab, NextView
from cell.explore import belief
from cell.explore.frustum import MinRangeOccluder, area_below_min_range, should_keep_min_range
from cell.explore.policy import Batch, BatchRequest, expected_samples
from cell.explore.refinement import improve_views
from cell.explore.stage import BELIEF_SCHEDULE, MAX_ROWS, MAX_SCOUTS, N_DRAWN, N_STARTS
from cell.world.embree import EmbreeRayCaster
from planner.explore.gain import GainRecord, select_by_gain_per_second
from planner.explore.space import VoxelSpace
from planner.geometry.decimation import decimate
from planner.geometry.sampling import SurfaceSamples, draw_samples
from planner.measurability.visibility import find_measured
from planner.ports import RayCaster
from planner.values import Floats
from planner.viewpoints.lines_of_sight import RayTargets


class _Ours:
    """State between views in addition to the voxels: the record of expected and measured results."""

    def __init__(self, lab: Lab, rng: Generator) -> None:
        self._lab, self._rng = lab, rng
        self._record, self._before = GainRecord.empty(), lab.unknown
        self._expected: tuple[SurfaceSamples, float] | None = None
        self._near = list[tuple[float, float]]()

    def __call__(self, known: Knowledge) -> Floats | None:
        lab, space = self._lab, self._learned(known)
        mesh = belief.surface_about(space, space.belief_voxels())
        planning = decimate(belief.coarse_surface(space), lab.settings.faces)
        request = BatchRequest(space, self._record, Batch(1), 0.0)
        rows, scouts = (
            expected_samples(draw_samples(mesh, planning, N_DRAWN, self._rng), request, limit)
            for limit in (MAX_ROWS, MAX_SCOUTS)
        )
        if not len(rows) or not len(scouts):
            return None
        casters: tuple[RayCaster, ...] = (EmbreeRayCaster(mesh.vertices, mesh.faces),)
        if should_keep_min_range(self._near):
            casters = (*casters, MinRangeOccluder(None, space, lab.frustum.near))
        free = lab.free(space)
        poses, distance = lab.candidates(planning, scouts, casters, free, BELIEF_SCHEDULE)
        M = find_measured(poses[:, None], rows, lab.scanner, casters, each=True)
        if not M.any():
            return None
        starts = select_by_gain_per_second(
            csr_array(M), rows.areas, np.ones(len(M.T)), np.ones(len(M.T), np.bool_), N_STARTS
        )
        targets, arm = RayTargets.of(scouts.points, scouts.normals), lab.holder(casters, free)
        T, moved = improve_views(poses[starts], distance[starts], targets, scouts.areas, arm)
        poses = np.concatenate([poses, T[moved]])
        M = np.concatenate([M, find_measured(T[moved, None], rows, lab.scanner, casters, each=True)], axis=1)
        best = int(np.argmax(rows.areas @ M))
        self._expected, self._before = (rows.pick(M[:, best]), float(mesh.areas.sum())), space
        return poses[best]

    def _learned(self, known: Knowledge) -> VoxelSpace:
        """Return the voxels with the tries of all views.

        The record is updated with the last view as in `cell.explore.explore`.
        """
        space = replace(known.space, tries=self._before.tries)
        if self._expected is None:
            return space
        (rows, surface), before = self._expected, self._before
        new = known.points[-1][before.is_new(known.points[-1])]
        found = self._lab.frustum.answered(rows.points, new, known.poses[-1]).astype(np.float64)
        of = before.open_samples_at(rows.points, rows.normals)
        self._record = self._record.with_batch(of, rows.areas / self._record.weights(of) / surface, found)
        last = [(known.points[-1], known.poses[-1])]
        near = area_below_min_range(rows, np.ones((len(rows), 1), np.bool_), last, before, self._lab.frustum)
        self._near.append((near, float(rows.areas.sum())))
        return space.with_tries(rows.points[space.is_still_open(rows.points, rows.normals)])


def stepwise(lab: Lab, rng: Generator) -> NextView:
    """Return the stepwise policy."""
    return _Ours(lab, rng)

"""The stepwise policy of `cell explore`, a view at a time from the equal first view on, for a scanner without an arm.

Belief, gain and candidates are those of a stage (`cell.explore.stage`); of what an arm adds nothing is left.
"""

from dataclasses import replace

import numpy as np
from numpy.random import Generator

from benchmarks.exploring.lab import Known, Lab, NextView
from cell.explore import belief
from cell.explore.policies import Batch
from cell.explore.stage import _DRAWN, Asked, _open
from cell.rays.embree import EmbreeRayCaster
from planner.explore.gain import Record
from planner.measurability.matrix import measured
from planner.surface.decimate import decimate
from planner.surface.sample import SurfaceSamples, pick_samples, sample
from planner.values import Floats


class _Ours:
    """What is kept from view to view beside the voxels: what became of what was expected."""

    def __init__(self, lab: Lab, rng: Generator) -> None:
        self._lab, self._rng = lab, rng
        self._record, self._tries = Record.empty(), lab.unknown.tries
        self._expected: tuple[SurfaceSamples, Floats] | None = None

    def __call__(self, known: Known) -> Floats | None:
        lab, space = self._lab, replace(known.space, tries=self._tries)
        if self._expected is not None:
            rows, shares = self._expected
            seen = space.seen(rows.points).astype(np.float64)
            self._record = self._record.with_stage(space.tries_at(rows.points), shares, seen)
            space = space.tried(rows.points[space.open_still(rows.points, rows.normals)])
            self._tries = space.tries
        mesh = belief.surface_of(space)
        planning = decimate(mesh, min(lab.settings.faces, len(mesh.faces)))
        asked = Asked(space, self._record, Batch(1), 0.0)
        rows, scouts = (_open(sample(mesh, planning, _DRAWN, self._rng), asked) for _ in range(2))
        if not len(rows) or not len(scouts):
            return None
        casters = (EmbreeRayCaster(mesh.vertices, mesh.faces),)
        poses = lab.candidates(planning, scouts, casters, lab.free(space))
        M = measured(poses[:, None], rows, lab.scanner, casters, each=True)
        if not M.any():
            return None
        best = int(np.argmax(rows.areas @ M))
        expected = pick_samples(rows, M[:, best])
        weights = self._record.weights(space.tries_at(expected.points))
        self._expected = expected, expected.areas / weights / float(mesh.areas.sum())
        return poses[best]


def stepwise(lab: Lab, rng: Generator) -> NextView:
    """The policy."""
    return _Ours(lab, rng)

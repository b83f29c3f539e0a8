"""What a stage is planned for: which samples of the surface are wanted, and how much of each.

There are two surfaces. The **believed** one is about all that was not seen free; of it is wanted what has no measured
point beside it, each area times the probability that a view which should measure it finds something
(`planner.explore.gain`). The **measured** one is that of all points so far, which is finer than voxels, and where it
leads (`cell.explore.measured_surface`); of it is wanted what no executed view measures by the scanner's law: strips
between points, too steep for the views that there were, and walls beyond the last points. Voxels hide both.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from cell.explore.policies import Batch
from planner.explore.gain import GainRecord, gain_ratio
from planner.explore.space import VoxelSpace
from planner.geometry.sampling import SurfaceSamples, pick_samples
from planner.measurability.visibility import find_measured
from planner.ports import RayCaster, Scanner
from planner.values import Floats, Value


@dataclass(frozen=True, slots=True, eq=False)
class Asked(Value):
    """What a stage is planned for.

    Attributes:
        space: what is known.
        record: what became of what was open before.
        batch: what is asked for; no views: why what is open stays open, of all that the part may be.
        min_gain: share of what was measured that each view must be expected to add, `Batch.worth` times.
        measured_area: of the believed surface, with a measured point beside it [m^2].
        came: how many times as much as expected came so far.
        cautious: whether views keep so far off that the part, where nobody looked, begins no nearer than the range.
        poses: (V, 4, 4) executed views, explored frame [m], where the measured surface is planned on; None: the
            believed one is.
        latest: of the last batches, in the order of `poses`, views and the area that they were to measure of the
            measured surface [m^2]; 0 where a batch was planned on the believed one.
    """

    space: VoxelSpace
    record: GainRecord
    batch: Batch
    min_gain: float
    measured_area: float = 0.0
    came: float = 1.0
    cautious: bool = False
    poses: Annotated[Floats, "V 4 4"] | None = None
    latest: Sequence[tuple[int, float]] = ()

    @property
    def least_area(self) -> float:
        """What each view must be expected to add [m^2]."""
        return self.batch.worth * self.min_gain * self.measured_area


def wanted(samples: SurfaceSamples, asked: Asked, most: int, scanner: Scanner, caster: RayCaster) -> SurfaceSamples:
    """What is asked for of the samples, at most so many.

    Args:
        samples: of the surface that is planned on.
        asked: what for.
        most: samples that are kept.
        scanner: its law, limits of sigma and spacing included.
        caster: the surface's.
    """
    if asked.poses is None:
        return probable(samples, asked, most)
    missed = ~find_measured(asked.poses[:, None], samples, scanner, (caster,))
    return _kept(samples, missed * samples.areas, most)


def came_of(samples: SurfaceSamples, asked: Asked, scanner: Scanner, caster: RayCaster) -> float:
    """How many times as much as expected the latest batches measured of the measured surface, as it is known now.

    By the law and what the surface itself hides, without occluders; below 1 where less came.

    Args:
        samples: of it.
        asked: what for.
        scanner: its law.
        caster: the surface's.
    """
    if asked.poses is None or not any(expected for _, expected in asked.latest):
        return asked.came
    views = [views for views, _ in asked.latest]
    before = len(asked.poses) - sum(views)
    casters, poses = (caster,), asked.poses[:, None]
    seen = find_measured(poses[before:], samples, scanner, casters, each=True)
    new = np.flatnonzero(seen.any(axis=1))
    new = new[asked.space.is_near_measured(samples.points[new])]
    if before:
        new = new[~find_measured(poses[:before], pick_samples(samples, new), scanner, casters)]
    first = seen[new] & (np.cumsum(seen[new], axis=1) == 1)
    brought = [float(areas.sum()) for areas in np.split(samples.areas[new] @ first, np.cumsum(views)[:-1])]
    return gain_ratio([(expected, area) for (_, expected), area in zip(asked.latest, brought, strict=True)])


def probable(samples: SurfaceSamples, asked: Asked, most: int) -> SurfaceSamples:
    """What is asked for of a believed surface's samples, areas times probabilities."""
    space = asked.space
    unseen = ~space.is_measured(samples.points, samples.normals)
    likely = asked.record.weights(space.open_samples_at(samples.points, samples.normals))
    weights = np.where(unseen, likely, float(asked.batch.whole))
    return _kept(samples, weights * samples.areas, most)


def _kept(samples: SurfaceSamples, areas: Floats, most: int) -> SurfaceSamples:
    """The samples that count, with these areas; of more than `most`, so many of the same area."""
    kept = np.flatnonzero(areas)
    if len(kept) > most:
        until = np.cumsum(areas)
        kept, times = np.unique(np.searchsorted(until, until[-1] * (np.arange(most) + 0.5) / most), return_counts=True)
        areas[kept] = until[-1] / most * times
    return SurfaceSamples(
        samples.points[kept], samples.normals[kept], areas[kept], samples.face[kept], samples.planning_face[kept]
    )

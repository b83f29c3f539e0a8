"""Policies that select the batches of an exploration, and the samples that a batch is planned for.

There are two surfaces. On the **belief** surface, uncovered samples count, each area times the probability that a view
finds something new (`planner.explore.gain`). On the **measured** surface, samples count that no executed view measures
by the scanner's conditions: strips between points, steep surface, and walls beyond the last points.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Annotated

import numpy as np

from cell.explore.options import ExploreOptions
from cell.runs.schema import BELIEVED, MEASURED, SurfaceName
from planner.explore.gain import GainRecord, gain_ratio
from planner.explore.space import VoxelSpace
from planner.geometry.sampling import SurfaceSamples
from planner.measurability.visibility import find_measured
from planner.ports import RayCaster, Scanner
from planner.values import Floats, Value


@dataclass(frozen=True, slots=True)
class ExplorationState:
    """Progress of an exploration.

    Attributes:
        stages: executed batches.
        n_left: views left in the budget; None without limit.
        limited: whether sigma or spacing is limited.
        on: surface of the last batch.
    """

    stages: int
    n_left: int | None
    limited: bool = False
    on: SurfaceName = BELIEVED


@dataclass(frozen=True, slots=True)
class Batch:
    """Request for the next batch.

    Attributes:
        views: largest number of views; None means all with enough gain.
        include_covered: whether covered surface counts as well.
        rough: whether points only serve for planning, so that sigma and spacing limits do not apply.
        per_second: whether the gain per second of dwell and motion time is maximised; else the gain.
        on: surface to plan on.
        min_gain_factor: factor of the minimum gain of each view.
    """

    views: int | None
    include_covered: bool = False
    rough: bool = False
    per_second: bool = False
    on: SurfaceName = BELIEVED
    min_gain_factor: float = 1.0


_FIRST_STEPWISE, _FIRST_TWO_STAGE = 1, 6
"""Number of first views: few for stepwise, whose later views are selected better; more for the rough model."""

_GAIN_FACTORS: Mapping[SurfaceName, float] = MappingProxyType({BELIEVED: 2.0, MEASURED: 0.6})
"""Factor of the minimum gain on each surface once little is uncovered: the belief promises too much late, the measured
surface too little, and no later plan measures what it leaves."""

_FINE_GAIN_FACTORS = (3.0, 3.0, 1.5, 1.0)
"""Factor of the minimum gain of each fine plan. Later plans know more of the surface and may use smaller gains."""

Policy = Callable[[ExploreOptions, ExplorationState], Sequence[Batch]]
"""Function that returns batches by priority. The first one with the minimum gain is executed; without such a batch the
exploration ends."""


def stepwise(options: ExploreOptions, state: ExplorationState) -> Sequence[Batch]:
    """Return a first view, then the few with the largest expected gain per second, planned after each batch.

    The surface of the last batch comes first, the other one if no view there has enough gain.
    """
    if state.stages == 0:
        return (Batch(_limit_views(state, options.ring or _FIRST_STEPWISE)),)
    surfaces = (MEASURED, BELIEVED) if state.on == MEASURED else (BELIEVED, MEASURED)
    return tuple(
        Batch(_limit_views(state, options.batch), per_second=True, on=on, min_gain_factor=_GAIN_FACTORS[on])
        for on in surfaces
    )


def two_stage(options: ExploreOptions, state: ExplorationState) -> Sequence[Batch]:
    """Return first views for a rough model, a set cover on it, and a few more for the remaining surface.

    W. R. Scott, "Model-based view planning", Machine Vision and Applications 20 (2009), doi:10.1007/s00138-007-0110-2.
    With limits of sigma or spacing the second stage measures the whole part, since rough points need not satisfy them.
    The last batches are planned on the measured surface.
    """
    if state.stages == 0:
        return (Batch(_limit_views(state, options.ring or _FIRST_TWO_STAGE), rough=True),)
    if state.limited and state.stages == 1:
        return (Batch(state.n_left, include_covered=True),)
    last = Batch(state.n_left, on=MEASURED, min_gain_factor=_GAIN_FACTORS[MEASURED])
    if state.on == MEASURED:  # the continued surface follows the walls of tubes
        return (last,)
    factors = dict.fromkeys(_FINE_GAIN_FACTORS[state.stages - 1 :])  # a factor without a view is not tried again
    return (*(Batch(state.n_left, min_gain_factor=factor) for factor in factors), last)


POLICIES: Mapping[str, Policy] = MappingProxyType({"stepwise": stepwise, "two-stage": two_stage})


def _limit_views(state: ExplorationState, count: int) -> int:
    return count if state.n_left is None else min(count, state.n_left)


@dataclass(frozen=True, slots=True, eq=False)
class BatchRequest(Value):
    """Data that a batch is planned with.

    Attributes:
        space: voxels.
        record: realised gains of earlier batches.
        batch: request; 0 views ask for an explanation of the uncovered surface only.
        min_gain: share of the measured surface that each view must be expected to add, times `Batch.min_gain_factor`.
        measured_area: area of the belief surface with a measured point nearby [m^2].
        gain_ratio: realised / expected gain so far.
        keep_min_range: whether unseen space that may belong to the part must be beyond the minimum range.
        poses: (V, 4, 4) executed views, explored frame [m], for a batch on the measured surface; None for the belief.
        latest: views and expected area [m^2] of the last batches in the order of `poses`; 0 on the belief.
    """

    space: VoxelSpace
    record: GainRecord
    batch: Batch
    min_gain: float
    measured_area: float = 0.0
    gain_ratio: float = 1.0
    keep_min_range: bool = False
    poses: Annotated[Floats, "V 4 4"] | None = None
    latest: Sequence[tuple[int, float]] = ()

    @property
    def min_area(self) -> float:
        """Smallest expected gain of a view [m^2]."""
        return self.batch.min_gain_factor * self.min_gain * self.measured_area


def select_samples(
    samples: SurfaceSamples, request: BatchRequest, most: int, scanner: Scanner, caster: RayCaster
) -> SurfaceSamples:
    """Return at most `most` samples that count, with their weighted areas.

    Args:
        samples: of the surface to plan on.
        request: the request.
        most: largest number of samples.
        scanner: the scanner with sigma and spacing limits.
        caster: ray caster of the surface.
    """
    if request.poses is None:
        return expected_samples(samples, request, most)
    missed = ~find_measured(request.poses[:, None], samples, scanner, (caster,))
    return _resample(samples, missed * samples.areas, most)


def realised_gain_ratio(samples: SurfaceSamples, request: BatchRequest, scanner: Scanner, caster: RayCaster) -> float:
    """Return realised / expected gain of the latest batches on the current measured surface.

    Computed by the scanner's conditions and occlusion by the surface itself, without occluders.
    """
    if request.poses is None or not any(expected for _, expected in request.latest):
        return request.gain_ratio
    views = [views for views, _ in request.latest]
    before = len(request.poses) - sum(views)
    casters, poses = (caster,), request.poses[:, None]
    seen = find_measured(poses[before:], samples, scanner, casters, each=True)
    new = np.flatnonzero(seen.any(axis=1))
    new = new[request.space.is_near_measured(samples.points[new])]
    if before:
        new = new[~find_measured(poses[:before], samples.pick(new), scanner, casters)]
    first = seen[new] & (np.cumsum(seen[new], axis=1) == 1)
    brought = [float(areas.sum()) for areas in np.split(samples.areas[new] @ first, np.cumsum(views)[:-1])]
    return gain_ratio([(expected, area) for (_, expected), area in zip(request.latest, brought, strict=True)])


def expected_samples(samples: SurfaceSamples, request: BatchRequest, most: int) -> SurfaceSamples:
    """Return the samples of a belief surface, areas times probabilities."""
    space = request.space
    unseen = ~space.is_measured(samples.points, samples.normals)
    likely = request.record.weights(space.open_samples_at(samples.points, samples.normals))
    weights = np.where(unseen, likely, float(request.batch.include_covered))
    return _resample(samples, weights * samples.areas, most)


def _resample(samples: SurfaceSamples, areas: Floats, most: int) -> SurfaceSamples:
    """Return the samples with positive areas; more than `most` are drawn to equal areas."""
    rows = np.flatnonzero(areas)
    if len(rows) > most:
        until = np.cumsum(areas)
        rows, times = np.unique(np.searchsorted(until, until[-1] * (np.arange(most) + 0.5) / most), return_counts=True)
        areas[rows] = until[-1] / most * times
    return replace(samples.pick(rows), areas=areas[rows])

"""Coverage: the measured share of the part's surface. The definitions are a contract; other programs rely on them.

visible     share of the area of samples that at least one view measures: both lines of sight free, in FOV, in range,
            grazing limits kept. The samples are area-weighted samples of the reference that the optimiser did not use.
sampled     share of the same samples with a scan point within 1 % of the diagonal of the part's bounding box.
dense       share of them that a view measures *and* with a scan point within 1.5 times the planned spacing there.
coverable   share that at least one *reachable* candidate measures.

Coverage is never computed from a reconstructed mesh. Object frame, metres.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from planner.errors import PlannerError
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples
from planner.measurability.visibility import find_measured
from planner.ports import Progress, RayCaster, Scanner, no_progress
from planner.values import Bools, Floats, Value

N_SAMPLES = 100_000
"""Number of samples in the definition of coverage."""

DENSE = 1.5
"""Largest distance of a scan point in dense coverage, in spacings."""

RADIUS_SHARE = 0.01
"""Radius of sampled coverage as a share of the bounding box's diagonal."""


@dataclass(frozen=True, slots=True, eq=False)
class Coverage(Value):
    """Covered samples and their area.

    Attributes:
        covered: (S,) whether each sample is covered.
        area: area of the covered samples [m^2].
        total_area: area of all samples [m^2].
    """

    covered: Annotated[Bools, "S"]
    area: float
    total_area: float

    @property
    def fraction(self) -> float:
        """Covered area over total area, 0 to 1."""
        return self.area / self.total_area


def visible_coverage(
    T_object_scanner: Floats,
    samples: SurfaceSamples,
    scanner: Scanner,
    casters: Sequence[RayCaster],
    *,
    progress: Progress = no_progress,
) -> Coverage:
    """Compute visible coverage of planned or executed views; the arguments are those of `find_measured`."""
    return _coverage(find_measured(T_object_scanner, samples, scanner, casters, progress=progress), samples)


def coverage_of_views(seen: Bools, samples: SurfaceSamples) -> Coverage:
    """Compute visible coverage of views from (S, n) whether each view measures each sample."""
    return _coverage(np.logical_or.reduce(seen, axis=1), samples)


def sampling_radius(reference: TriangleMesh) -> float:
    """Return the radius of sampled coverage [m]: 1 % of the diagonal of the part's bounding box."""
    return RADIUS_SHARE * reference.diagonal


def sampled_coverage(scan_points: Floats, samples: SurfaceSamples, radius: float) -> Coverage:
    """Compute sampled coverage: samples with a scan point within the radius (inclusive).

    Args:
        scan_points: (P, 3) points of all scans [m].
        samples: of the reference, the same as for visible coverage.
        radius: [m], from `sampling_radius`.
    """
    return _coverage(_nearest_distance(scan_points, samples, radius) <= radius, samples)


def dense_coverage(scan_points: Floats, samples: SurfaceSamples, spacing: Floats) -> Coverage:
    """Compute dense coverage: samples that a view measures, with a scan point within `DENSE` spacings (inclusive).

    Args:
        scan_points: (P, 3) points of all scans [m].
        samples: of the reference, the same as for visible coverage.
        spacing: (S,) planned at each sample [m]; NaN if no view measures it.
    """
    radius = DENSE * np.where(np.isfinite(spacing), spacing, -1.0)
    return _coverage(_nearest_distance(scan_points, samples, float(radius.max(initial=1e-9))) <= radius, samples)


def _nearest_distance(scan_points: Floats, samples: SurfaceSamples, radius: float) -> Floats:
    """Return (S,) distance of the nearest scan point [m]; inf beyond the radius."""
    from scipy.spatial import cKDTree  # not loaded by commands that scan nothing

    points = np.asarray(scan_points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise PlannerError(f"scan_points has shape {points.shape}; it must be (P, 3) finite coordinates")
    if not radius > 0:
        raise PlannerError(f"the radius of sampled coverage is {radius:g} m; it must be above 0")
    if not len(points):
        return np.full(len(samples), np.inf)
    tree = cKDTree(points, balanced_tree=False, compact_nodes=False)  # three times faster to build, as fast to query
    # The bound of the tree excludes the radius itself; the next number includes it.
    distance, _ = tree.query(samples.points, distance_upper_bound=np.nextafter(radius, np.inf), workers=-1)
    return np.asarray(distance)


def marginal_coverage(seen: Bools) -> Floats:
    """Return (n,) share of the surface that each view adds to the earlier views.

    Args:
        seen: (S, n) whether a view measures a sample; the samples have equal areas, as those of `draw_samples` do.
    """
    accumulated = np.logical_or.accumulate(seen, axis=1)
    shares: Floats = np.diff(accumulated.sum(axis=0), prepend=0) / len(seen)
    return shares


def _coverage(covered: Bools, samples: SurfaceSamples) -> Coverage:
    if not len(samples):
        raise PlannerError("there are no samples; coverage is a share of at least one")
    return Coverage(covered, float(samples.areas[covered].sum()), float(samples.areas.sum()))

"""Coverage: how much of the part's surface is measured. The definitions are a contract; other programs rely on them.

visible     share of the area of samples that at least one view measures: both legs free, in FOV, in range, grazing
            limits kept. The samples are area-weighted samples of the reference that the optimiser did not see.
sampled     share of the same samples that have a scan point within 1 % of the diagonal of the part's bounding box.
dense       share of them that a view measures *and* that have a scan point within 1.5 times the spacing planned there.
coverable   share that at least one *reachable* candidate measures.

Coverage is never calculated from a reconstructed mesh. Object frame, metres.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from planner.errors import PlannerError
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples
from planner.measurability.visibility import find_measured
from planner.ports import Progress, RayCaster, Scanner
from planner.values import Bools, Floats, Value

N_SAMPLES = 100_000
"""How many samples coverage is defined with."""

DENSE = 1.5
"""Dense coverage asks for a scan point within so many spacings."""

RADIUS_SHARE = 0.01
"""Radius of sampled coverage as a share of the bounding box's diagonal."""


@dataclass(frozen=True, slots=True, eq=False)
class Coverage(Value):
    """Which samples are covered, and how much area they stand for.

    Attributes:
        covered: (S,) bool.
        area: area that the covered samples stand for [m^2].
        total_area: area that all samples stand for [m^2].
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
    progress: Progress | None = None,
) -> Coverage:
    """Visible coverage of the given views: planned, or executed.

    Args:
        T_object_scanner: (n, K, 4, 4) views of K poses [m].
        samples: of the reference, not those that the optimiser saw.
        scanner: the sensor's law.
        casters: the reference's caster and those of occluders, object frame.
        progress: called with (poses done, poses in all).
    """
    return _coverage(find_measured(T_object_scanner, samples, scanner, casters, progress=progress), samples)


def coverage_of_views(seen: Bools, samples: SurfaceSamples) -> Coverage:
    """Visible coverage of views of which is known what they measure.

    Args:
        seen: (S, n) whether a view measures a sample.
        samples: of the reference.
    """
    return _coverage(np.logical_or.reduce(seen, axis=1), samples)


def sampling_radius(reference: TriangleMesh) -> float:
    """Radius of sampled coverage [m]: 1 % of the diagonal of the part's bounding box."""
    return RADIUS_SHARE * reference.diagonal


def sampled_coverage(scan_points: Floats, samples: SurfaceSamples, radius: float) -> Coverage:
    """Sampled coverage: samples with a scan point within the radius (inclusive).

    Args:
        scan_points: (P, 3) points of all scans [m], object frame.
        samples: of the reference, the same as for visible coverage.
        radius: [m], from `sampling_radius`.
    """
    return _coverage(_distance(scan_points, samples, radius) <= radius, samples)


def dense_coverage(scan_points: Floats, samples: SurfaceSamples, spacing: Floats) -> Coverage:
    """Dense coverage: samples that a view measures, with a scan point within `DENSE` spacings of theirs (inclusive).

    Args:
        scan_points: (P, 3) points of all scans [m], object frame.
        samples: of the reference, the same as for visible coverage.
        spacing: (S,) planned at each of them [m]; NaN where no view measures it.
    """
    radius = DENSE * np.where(np.isfinite(spacing), spacing, -1.0)
    return _coverage(_distance(scan_points, samples, float(radius.max(initial=1e-9))) <= radius, samples)


def _distance(scan_points: Floats, samples: SurfaceSamples, radius: float) -> Floats:
    """(S,) distance of the nearest scan point [m]; inf beyond the radius."""
    from scipy.spatial import cKDTree  # kept out of the start-up of commands that scan nothing

    points = np.asarray(scan_points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise PlannerError(f"scan_points has shape {points.shape}; it must be (P, 3) finite coordinates")
    if not radius > 0:
        raise PlannerError(f"the radius of sampled coverage is {radius:g} m; it must be above 0")
    if not len(points):
        return np.full(len(samples), np.inf)
    tree = cKDTree(points, balanced_tree=False, compact_nodes=False)  # three times faster to build, as fast to ask
    # The tree's own bound excludes the radius itself; its next number includes it.
    distance, _ = tree.query(samples.points, distance_upper_bound=np.nextafter(radius, np.inf), workers=-1)
    return np.asarray(distance)


def marginal_coverage(seen: Bools) -> Floats:
    """(n,) share of the surface that each view adds to those before it.

    Args:
        seen: (S, n) whether a view measures a sample; the samples stand for equal areas, as those of `sample` do.
    """
    before = np.logical_or.accumulate(seen, axis=1)
    shares: Floats = np.diff(before.sum(axis=0), prepend=0) / len(seen)
    return shares


def _coverage(covered: Bools, samples: SurfaceSamples) -> Coverage:
    if not len(samples):
        raise PlannerError("there are no samples; coverage is a share of at least one")
    return Coverage(covered, float(samples.areas[covered].sum()), float(samples.areas.sum()))

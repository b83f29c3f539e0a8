"""Predicted coverage of a plan on samples that the optimiser does not use (`planner.measurability.coverage`)."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from cell.session import Stream, default_effort, random_stream
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples, draw_samples
from planner.measurability import coverage
from planner.measurability.coverage import Coverage
from planner.measurability.visibility import VisibilityMemo, find_measured
from planner.ports import Progress, RayCaster, Scanner, no_progress
from planner.values import Bools, Floats


def held_out_samples(
    reference: TriangleMesh, planning: TriangleMesh, seed: int, count: int | None = None
) -> SurfaceSamples:
    """Draw the samples on which coverage is predicted and measured; the optimiser uses others.

    Args:
        reference: the part [m], object frame.
        planning: its decimated copy.
        seed: of the plan.
        count: number of samples; None: that of the default effort. The definition of coverage has 100,000.
    """
    count = default_effort().held_out_samples if count is None else count
    return draw_samples(reference, planning, count, random_stream(seed, Stream.HELD_OUT_SAMPLES))


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Held-out samples, and their coverage by the reachable candidates.

    Attributes:
        samples: of the reference, not those of the matrix.
        scanner: sensor model.
        casters: of the part and of the occluders, object frame.
        coverable: coverage by all reachable candidates.
        memo: visibility of earlier views, at most one item.
    """

    samples: SurfaceSamples
    scanner: Scanner
    casters: Sequence[RayCaster]
    coverable: Coverage
    memo: list[VisibilityMemo] = field(default_factory=list)

    @classmethod
    def of(
        cls,
        samples: SurfaceSamples,
        scanner: Scanner,
        casters: Sequence[RayCaster],
        T_object_scanner: Floats,
        progress: Progress = no_progress,
    ) -> "Prediction":
        """Compute the coverage by the reachable candidates (n, K, 4, 4) [m]."""
        # Neighbours measure similar samples. An order by the golden ratio puts views far apart one after the other, so
        # that soon few samples are left to test.
        order = np.argsort(np.arange(len(T_object_scanner)) * ((np.sqrt(5) - 1) / 2) % 1)
        coverable = coverage.visible_coverage(T_object_scanner[order], samples, scanner, casters, progress=progress)
        return cls(samples, scanner, casters, coverable)

    def with_more(self, T_object_scanner: Floats) -> "Prediction":
        """Return the prediction with further reachable candidates (n, K, 4, 4) [m]."""
        covered = self.coverable.covered
        is_measured = find_measured(T_object_scanner, self.samples, self.scanner, self.casters, among=~covered)
        return replace(
            self, coverable=coverage.coverage_of_views(np.stack([covered, is_measured], axis=1), self.samples)
        )

    def visible(self, T_object_scanner: Floats) -> Coverage:
        """Compute the visible coverage of views (n, K, 4, 4) [m]."""
        if not self.memo:
            self.memo.append(VisibilityMemo(self.samples, self.scanner, self.casters))
        return coverage.coverage_of_views(self.memo[0].measured(T_object_scanner)[:, None], self.samples)

    def share_of_coverable(self, T_object_scanner: Floats) -> float:
        """Return the coverage of views (n, K, 4, 4) [m] as a share of the coverable area; 1 if nothing is coverable.

        Samples measured by the views count as coverable: the views need not be candidates.
        """
        visible = self.visible(T_object_scanner)
        area = float(self.samples.areas[self.coverable.covered | visible.covered].sum())
        return visible.area / area if area > 0 else 1.0

    def seen(self, T_object_scanner: Floats, among: Bools | None = None) -> NDArray[np.bool_]:
        """Return which samples each of the views (n, K, 4, 4) [m] measures, as (S, n); `among` selects samples."""
        samples = self.samples if among is None else self.samples.pick(among)
        return find_measured(T_object_scanner, samples, self.scanner, self.casters, each=True)

    def coverable_with(self, visible: Coverage) -> float:
        """Return the coverable share of the surface, with the plan's own poses, which differ by micrometres."""
        either: NDArray[np.bool_] = self.coverable.covered | visible.covered
        return float(self.samples.areas[either].sum() / self.samples.areas.sum())

"""Predicted coverage of a plan on samples that the optimiser has not seen (planner/measurability/coverage.py)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from cell.session import Stream, default_effort, random_stream
from planner.geometry.mesh import TriangleMesh
from planner.geometry.sampling import SurfaceSamples, draw_samples, pick_samples
from planner.measurability import coverage
from planner.measurability.coverage import Coverage
from planner.measurability.visibility import VisibilityMemo, find_measured
from planner.ports import Progress, RayCaster, Scanner
from planner.values import Bools, Floats


def held_out_samples(
    reference: TriangleMesh, planning: TriangleMesh, seed: int, count: int | None = None
) -> SurfaceSamples:
    """The samples on which coverage is predicted and achieved, not those that the optimiser sees.

    Args:
        reference: the part [m], object frame.
        planning: its decimated copy.
        seed: the plan's.
        count: how many; None: that of the default effort. The definition of coverage has 100,000.
    """
    count = default_effort().held_out_samples if count is None else count
    return draw_samples(reference, planning, count, random_stream(seed, Stream.HELD_OUT_SAMPLES))


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """The held-out samples with what reachable candidates measure of them.

    Attributes:
        samples: of the reference, not those of the matrix.
        scanner: the sensor's law.
        casters: the part's and the occluders', object frame.
        coverable: what at least one reachable candidate measures.
        asked: (S,) samples on which a coverage is kept; None: all.
        asks: the same of any samples.
        remembered: what is known so far of views that were asked about.
    """

    samples: SurfaceSamples
    scanner: Scanner
    casters: Sequence[RayCaster]
    coverable: Coverage
    required: Bools | None = None
    is_required: Callable[[SurfaceSamples], Bools] | None = None
    remembered: list[VisibilityMemo] = field(default_factory=list)

    @classmethod
    def of(
        cls,
        samples: SurfaceSamples,
        scanner: Scanner,
        casters: Sequence[RayCaster],
        T_object_scanner: Floats,
        progress: Progress | None = None,
    ) -> "Prediction":
        """Ask the reachable candidates.

        Args:
            samples: held-out samples of the reference.
            scanner: the sensor's law.
            casters: the part's and the occluders', object frame.
            T_object_scanner: (n, K, 4, 4) poses of the reachable candidates [m].
            progress: called with (poses done, poses in all).
        """
        # Neighbours measure much the same: views far apart in turn (by the golden ratio) soon leave few samples to ask.
        order = np.argsort(np.arange(len(T_object_scanner)) * ((np.sqrt(5) - 1) / 2) % 1)
        found = coverage.visible_coverage(T_object_scanner[order], samples, scanner, casters, progress=progress)
        return cls(samples, scanner, casters, found)

    def with_more(self, T_object_scanner: Floats) -> "Prediction":
        """With further reachable candidates (n, K, 4, 4) [m]."""
        open_ = ~self.coverable.covered
        found = find_measured(T_object_scanner, self.samples, self.scanner, self.casters, among=open_)
        return replace(self, coverable=coverage.coverage_of_views(np.stack([~open_, found], axis=1), self.samples))

    def visible(self, T_object_scanner: Floats) -> Coverage:
        """Visible coverage of views (n, K, 4, 4) [m]."""
        if not self.remembered:
            self.remembered.append(VisibilityMemo(self.samples, self.scanner, self.casters))
        return coverage.coverage_of_views(self.remembered[0].measured(T_object_scanner)[:, None], self.samples)

    def share_of_coverable(self, T_object_scanner: Floats) -> float:
        """Visible area of views (n, K, 4, 4) [m] over coverable area, 0 to 1; 1 where nothing is coverable.

        Of the samples that are asked about. What the views measure counts as coverable: they need not be candidates.
        """
        visible, areas = self.visible(T_object_scanner), self.samples.areas
        can = self.coverable.covered | visible.covered
        if self.required is not None:
            can = can & self.required
            return float(areas[can & visible.covered].sum() / areas[can].sum()) if can.any() else 1.0
        whole = float(areas[can].sum())
        return visible.area / whole if whole > 0 else 1.0

    def seen(self, T_object_scanner: Floats, among: Bools | None = None) -> NDArray[np.bool_]:
        """(S, n) which samples, of all or among some, each of the views (n, K, 4, 4) [m] measures."""
        samples = self.samples if among is None else pick_samples(self.samples, among)
        return find_measured(T_object_scanner, samples, self.scanner, self.casters, each=True)

    def coverable_with(self, visible: Coverage) -> float:
        """Coverable share of the surface, what a plan's own poses measure included (they differ by micrometres)."""
        either: NDArray[np.bool_] = self.coverable.covered | visible.covered
        return float(self.samples.areas[either].sum() / self.samples.areas.sum())
